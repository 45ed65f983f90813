"""Where the sensors are, given contacts that move along: bundle adjustment's reduced system."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg

from anisomap.numerics.contacts.detection import Contacts
from anisomap.numerics.contacts.localisation import Fitted

Matrix = NDArray[np.float64]

_DAMPING = 0.01  # of the curvature's diagonal
_TOLERANCE = 1e-8
_MOST_STEPS = 1000


class ReducedSystem:
    """How the score of all contacts changes with the places of the sensors, contacts following.

    Parameters
    ----------
    contacts : Contacts
    fitted : Fitted
    kept : ndarray of bool, shape (E,)
        The contacts that count.
    n_sensors : int

    Notes
    -----
    Let row m of P hold the derivative of u_m by all places and row m of Q that by all contacts,
    h the curvatures, g the slopes, C the contacts' precisions and c their pulls. Second
    derivatives are taken without the bend of u (Gauss-Newton). Eliminating the contacts leaves
    (Schur complement; Triggs et al. 2000, Bundle Adjustment - A Modern Synthesis, section 6.1) ::

        gradient   P' (g - h Q C^-1 c)
        curvature  P' (h - h Q C^-1 Q' h) P
    """

    def __init__(
        self, contacts: Contacts, fitted: Fitted, kept: NDArray[np.bool_], n_sensors: int
    ) -> None:
        self._fitted = fitted
        counts = kept[contacts.contact_index]
        self._h, self._g = fitted.curvatures * counts, fitted.slopes * counts
        k = fitted.states.shape[1] - 1
        self._n_sensors, self._k = n_sensors, k
        self._by_place = _spread(-fitted.directions[:, :k], contacts.sensors, n_sensors)
        self._by_contact = _spread(fitted.directions, contacts.contact_index, len(kept))

    @cached_property
    def _inverse(self) -> Matrix:
        return np.asarray(np.linalg.inv(self._fitted.precisions))

    def _followed(self, contact_pulls: Matrix) -> Matrix:
        """``h Q C^-1 c`` for any c of shape (E, k + 1)."""
        moves = np.einsum("eij,ej->ei", self._inverse, contact_pulls)
        return np.asarray(self._h * (self._by_contact @ moves.ravel()))

    @property
    def gradient(self) -> Matrix:
        """Of the score by the places, shape (N k,)."""
        return np.asarray(self._by_place.T @ (self._g - self._followed(self._fitted.pulls)))

    def curvature(self, moves: Matrix) -> Matrix:
        """Multiply the curvature by moves of all places, shape (N k,)."""
        along = self._h * (self._by_place @ moves.ravel())
        pulls = (self._by_contact.T @ along).reshape(self._fitted.pulls.shape)
        return np.asarray(self._by_place.T @ (along - self._followed(pulls)))

    def step(self, strays: Matrix, *, share: float, prior_sd: float) -> Matrix:
        """Give the step that the score and a pull back towards the start agree on.

        Parameters
        ----------
        strays : ndarray of shape (N, k)
            How far the places are from where they set out.
        share : float
            How much of the score counts: frames that follow each other are not independent.
        prior_sd : float
            Standard deviation, above 0, of how far a sensor strays.

        Returns
        -------
        ndarray of shape (N, k)
        """
        back = prior_sd**-2
        blocks = self._diagonal_blocks * share
        damping = _DAMPING * (np.einsum("nii->ni", blocks) + back).ravel()
        stiff = blocks + np.eye(self._k) * back
        conditioner = np.linalg.inv(stiff)

        def precondition(moves: Matrix) -> Matrix:
            parts = moves.reshape(self._n_sensors, self._k)
            return np.asarray(np.einsum("nij,nj->ni", conditioner, parts).ravel())

        def stiffness(moves: Matrix) -> Matrix:
            flat = moves.ravel()
            return np.asarray(share * self.curvature(flat) + (back + damping) * flat)

        size = self._n_sensors * self._k
        wanted = share * self.gradient - back * strays.ravel()
        found, _ = cg(
            LinearOperator((size, size), stiffness, dtype=np.float64),
            wanted,
            rtol=_TOLERANCE,
            maxiter=_MOST_STEPS,
            M=LinearOperator((size, size), precondition, dtype=np.float64),
        )
        return np.asarray(found.reshape(self._n_sensors, self._k))

    @cached_property
    def _diagonal_blocks(self) -> Matrix:
        """Curvature by each place alone, contacts held still, shape (N, k, k)."""
        weighted = self._by_place.multiply(self._h[:, None])
        whole = csr_array(self._by_place.T @ weighted).tocoo()
        blocks = np.zeros((self._n_sensors, self._k, self._k))
        rows, columns = whole.coords
        blocks[rows // self._k, rows % self._k, columns % self._k] = whole.data
        return blocks


def _spread(values: Matrix, owners: NDArray[np.intp], n_owners: int) -> csr_array:
    """Put row m's values into the columns of its owner: (M, q) to (M, n_owners q)."""
    n_rows, width = values.shape
    columns = owners[:, None] * width + np.arange(width)
    ends = np.arange(n_rows + 1) * width
    return csr_array((values.ravel(), columns.ravel(), ends), shape=(n_rows, n_owners * width))
