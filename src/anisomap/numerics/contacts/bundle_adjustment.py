"""Gauss-Newton steps of the sensors with contacts eliminated, as in bundle adjustment."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg

from anisomap.numerics.contacts.detection import Contacts
from anisomap.numerics.contacts.localisation import LocatedContacts

Matrix = NDArray[np.float64]

_DAMPING = 0.01  # of the curvature's diagonal; chosen by hand
_TOLERANCE = 1e-3  # relative, of conjugate gradients: a step is corrected by the next one
_MAX_ITERATIONS = 1000  # of conjugate gradients


class ReducedSystem:
    """Gradient and curvature of the total score by the positions, with contacts re-optimised.

    Parameters
    ----------
    contacts : Contacts
    located : LocatedContacts
    weights : ndarray of shape (E,)
        Weight of each contact, at least 0; those of weight 0 are excluded.
    n_sensors : int

    Notes
    -----
    Row m of P is the gradient of u_m by all positions, and row m of Q that by all contacts; h are
    the curvatures, g the slopes, C the contacts' precisions and c their gradients. Second
    derivatives of u are neglected (Gauss-Newton). Eliminating the contacts, with the weight w of
    the contact of each reading, leaves the Schur complement (Triggs et al. 2000, Bundle Adjustment
    - A Modern Synthesis, section 6.1) ::

        gradient   P' w (g - h Q C^-1 c)
        curvature  P' w (h - h Q C^-1 Q' h) P
    """

    def __init__(
        self, contacts: Contacts, located: LocatedContacts, weights: ArrayLike, n_sensors: int
    ) -> None:
        self._located = located
        by_contact = np.asarray(weights, dtype=np.float64)
        self._w = by_contact[contacts.contact_index]
        k = located.states.shape[1] - 1
        self._n_sensors, self._k = n_sensors, k
        self._by_position = _block_rows(-located.directions[:, :k], contacts.sensors, n_sensors)
        self._by_contact = _block_rows(located.directions, contacts.contact_index, len(by_contact))

    @cached_property
    def _inverse(self) -> Matrix:
        return np.asarray(np.linalg.inv(self._located.precisions))

    def _contact_response(self, contact_gradients: Matrix) -> Matrix:
        """``h Q C^-1 c`` for any c of shape (E, k + 1)."""
        steps = np.einsum("eij,ej->ei", self._inverse, contact_gradients)
        return np.asarray(self._located.curvatures * (self._by_contact @ steps.ravel()))

    @property
    def gradient(self) -> Matrix:
        """Gradient of the score by the positions, shape (N k,)."""
        response = self._contact_response(self._located.gradients)
        return np.asarray(self._by_position.T @ (self._w * (self._located.slopes - response)))

    def curvature(self, steps: Matrix) -> Matrix:
        """Multiply the curvature by displacements of all sensors; both of shape (N k,)."""
        along = self._located.curvatures * (self._by_position @ steps.ravel())
        gradients = (self._by_contact.T @ along).reshape(self._located.gradients.shape)
        response = self._contact_response(gradients)
        return np.asarray(self._by_position.T @ (self._w * (along - response)))

    def step(self, deviations: Matrix, *, contact_weight: float, prior_sd: float) -> Matrix:
        """Return the damped Gauss-Newton step of the score plus the prior around the start.

        Parameters
        ----------
        deviations : ndarray of shape (N, k)
            Displacements of the positions from the start.
        contact_weight : float
            Factor of the score, since consecutive frames are not independent.
        prior_sd : float
            Standard deviation, above 0, of the displacement of a sensor under the prior.

        Returns
        -------
        ndarray of shape (N, k)
        """
        prior_precision = prior_sd**-2
        blocks = self._diagonal_blocks * contact_weight
        damping = _DAMPING * (np.einsum("nii->ni", blocks) + prior_precision).ravel()
        regularised = blocks + np.eye(self._k) * prior_precision
        conditioner = np.linalg.inv(regularised)

        def precondition(steps: Matrix) -> Matrix:
            parts = steps.reshape(self._n_sensors, self._k)
            return np.asarray(np.einsum("nij,nj->ni", conditioner, parts).ravel())

        def multiply(steps: Matrix) -> Matrix:
            flat = steps.ravel()
            return np.asarray(
                contact_weight * self.curvature(flat) + (prior_precision + damping) * flat
            )

        size = self._n_sensors * self._k
        target = contact_weight * self.gradient - prior_precision * deviations.ravel()
        found, _ = cg(
            LinearOperator((size, size), multiply, dtype=np.float64),
            target,
            rtol=_TOLERANCE,
            maxiter=_MAX_ITERATIONS,
            M=LinearOperator((size, size), precondition, dtype=np.float64),
        )
        return np.asarray(found.reshape(self._n_sensors, self._k))

    @cached_property
    def _diagonal_blocks(self) -> Matrix:
        """Curvature by each position with contacts fixed, shape (N, k, k)."""
        weighted = self._by_position.multiply((self._w * self._located.curvatures)[:, None])
        whole = csr_array(self._by_position.T @ weighted).tocoo()
        blocks = np.zeros((self._n_sensors, self._k, self._k))
        rows, columns = whole.coords
        blocks[rows // self._k, rows % self._k, columns % self._k] = whole.data
        return blocks


def _block_rows(values: Matrix, owners: NDArray[np.intp], n_owners: int) -> csr_array:
    """Place the values of row m in the columns of its owner: (M, q) to (M, n_owners q)."""
    n_rows, width = values.shape
    columns = owners[:, None] * width + np.arange(width)
    ends = np.arange(n_rows + 1) * width
    return csr_array((values.ravel(), columns.ravel(), ends), shape=(n_rows, n_owners * width))
