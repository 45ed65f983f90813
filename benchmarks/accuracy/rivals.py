"""Rivals of anisomap that scikit-learn does not have: a self-organising map, and PHATE."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.special import entr
from sklearn.base import BaseEstimator

from anisomap.evaluation import compare
from anisomap.evaluation.rivals import RIVALS as STOCK
from anisomap.evaluation.rivals import Method, name_of
from anisomap.numerics.scaling.multidimensional_scaling import smacof

_NODES = 5  # x the square root of the number of points, by Vesanto & Alhoniemi (2000)
_LAST_WIDTH = 0.5  # of the neighbourhood, in distances between nodes
_EPOCHS = 50
_NEIGHBOURS, _DECAY, _TIMES = 5, 40, 100  # defaults of the library of PHATE's authors
_FLOOR = 1e-7  # the same library's; keeps the logarithm finite

Array = NDArray[np.float64]


class SelfOrganisingMap(BaseEstimator):  # type: ignore[misc]
    """Self-organising map of standardised sensors, given their inner products r.

    Kohonen (1990), doi:10.1109/5.58325, with the number of nodes of Vesanto & Alhoniemi (2000),
    doi:10.1109/72.846731. Batch training from the principal components, which is deterministic.
    """

    def __init__(self, n_components: int = 2, kernel: str = "precomputed") -> None:
        self.n_components = n_components
        self.kernel = kernel

    def fit_transform(self, r: Array) -> Array:
        """Return the node of each sensor, (N, n_components)."""
        k = self.n_components
        variances, axes = np.linalg.eigh(r)
        inputs = (axes * np.sqrt(np.maximum(variances, 0)))[:, ::-1]
        spread = inputs[:, :k].std(axis=0)
        n_nodes = _NODES * math.sqrt(len(r))
        per_axis = (n_nodes / np.prod(spread / spread.max())) ** (1 / k) * spread
        shape = np.maximum(np.rint(per_axis / spread.max()), 2).astype(int)
        grid = np.meshgrid(*map(np.arange, shape), indexing="ij")
        nodes = np.stack(grid, -1).reshape(-1, k).astype(np.float64)
        prototypes = np.zeros((len(nodes), len(r)))
        prototypes[:, :k] = 2 * spread * (2 * nodes / (shape - 1) - 1)
        squares = cdist(nodes, nodes, "sqeuclidean")
        for width in np.geomspace(max(shape) / 2, _LAST_WIDTH, _EPOCHS):
            nearest = cdist(prototypes, inputs).argmin(axis=0)
            pull = np.exp(-squares[:, nearest] / (2 * width**2))
            prototypes = pull @ inputs / pull.sum(axis=1, keepdims=True)
        return np.asarray(nodes[cdist(prototypes, inputs).argmin(axis=0)])


class Phate(BaseEstimator):  # type: ignore[misc]
    """PHATE on distances: Moon et al. (2019), doi:10.1038/s41587-019-0336-3.

    With the parameters of the authors' library.
    """

    def __init__(self, n_components: int = 2, metric: str = "precomputed") -> None:
        self.n_components = n_components
        self.metric = metric

    def fit_transform(self, distances: Array) -> Array:
        """Return positions, (N, n_components)."""
        neighbour = min(_NEIGHBOURS, len(distances) - 1)
        widths = np.maximum(np.sort(distances, axis=1)[:, neighbour], np.finfo(float).tiny)
        with np.errstate(over="ignore"):
            kernel = np.exp(-((distances / widths[:, np.newaxis]) ** _DECAY))
        kernel = (kernel + kernel.T) / 2
        sums = kernel.sum(axis=1)
        # P^t = D^-1/2 V L^t V' D^1/2, with the eigenvalues L of the symmetric D^-1/2 K D^-1/2.
        values, vectors = np.linalg.eigh(kernel / np.sqrt(np.outer(sums, sums)))
        times = np.arange(1, _TIMES + 1)
        shares = np.abs(values) ** times[:, np.newaxis]
        shares /= shares.sum(axis=1, keepdims=True)
        time = times[_knee(entr(shares).sum(axis=1))]
        diffused = (vectors * values**time) @ vectors.T * np.sqrt(sums / sums[:, np.newaxis])
        potential = -np.log(np.maximum(diffused, 0) + _FLOOR)
        return smacof(cdist(potential, potential), dimensions=self.n_components).positions


def _knee(values: Array) -> int:
    """Return where two lines, one on each side, fit a curve best."""
    x = np.arange(len(values))
    errors = [
        sum(
            np.polyfit(x[part], values[part], 1, full=True)[1].sum()
            for part in (slice(k + 1), slice(k, None))
        )
        for k in range(1, len(values) - 1)
    ]
    return 1 + int(np.argmin(errors))


MORE: tuple[Method, ...] = (("som-on-r", SelfOrganisingMap()), ("phate-on-r", Phate()))
RIVALS: tuple[Method, ...] = (*STOCK, *MORE)
COMPARED: tuple[Method, ...] = (*compare.COMPARED, *MORE)
BY_NAME: Mapping[str, Method] = {name_of(method): method for method in RIVALS}
"""`RIVALS` by name."""
