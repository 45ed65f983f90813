"""Stock methods, which see the correlations of sensors alone: rivals of anisomap.

They are estimators of scikit-learn and umap-learn, and two that neither has: a self-organising map,
and PHATE. They are not tuned. To add one, add one line to `RIVALS`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.special import entr
from sklearn.base import BaseEstimator
from threadpoolctl import threadpool_limits

from anisomap import Recording, SensorMap
from anisomap.errors import InputError
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


class Rival(NamedTuple):
    """A stock method: module and class of the estimator, and its settings."""

    summary: str
    kind: str
    settings: Mapping[str, Any]


_DISTANCES = {"metric": "precomputed"}

RIVALS: Mapping[str, Rival] = MappingProxyType(
    {
        "isomap-on-r": Rival(
            "Isomap on sqrt(2 (1 - r)), 8 neighbours (scikit-learn)",
            "sklearn.manifold.Isomap",
            # Five neighbours, the default, leave skins in several pieces. The dense solver is
            # deterministic; ARPACK would start at a random vector.
            _DISTANCES | {"n_neighbors": 8, "eigen_solver": "dense"},
        ),
        "umap-on-r": Rival(
            "UMAP on sqrt(2 (1 - r)) (umap-learn)",
            "umap.UMAP",
            _DISTANCES | {"n_neighbors": 15, "n_jobs": 1},
        ),
        "tsne-on-r": Rival(
            "t-SNE on sqrt(2 (1 - r)) (scikit-learn)",
            "sklearn.manifold.TSNE",
            _DISTANCES | {"perplexity": 30.0, "init": "random", "n_jobs": 1},
        ),
        "pca-on-r": Rival(
            "principal components of standardised sensors (scikit-learn)",
            "sklearn.decomposition.KernelPCA",
            {"kernel": "precomputed", "eigen_solver": "dense"},
        ),
        "laplacian-on-r": Rival(
            "Laplacian eigenmaps on max(r, 0) (scikit-learn)",
            "sklearn.manifold.SpectralEmbedding",
            {"affinity": "precomputed"},
        ),
        "som-on-r": Rival("self-organising map", f"{__name__}.SelfOrganisingMap", {}),
        "phate-on-r": Rival("PHATE on sqrt(2 (1 - r))", f"{__name__}.Phate", {}),
    }
)
"""Name of each stock method; ``-on-r`` tells them from the methods of anisomap."""


def map_by_rival(recording: Recording, name: str, dimensions: int, *, seed: int = 0) -> SensorMap:
    """Map a recording by a stock method, with one thread.

    Parameters
    ----------
    recording : Recording
        Complete readings.
    name : str
        A key of `RIVALS`.
    dimensions : int
        Number of coordinates.
    seed : int
        Seed of t-SNE, UMAP and Laplacian eigenmaps.

    Returns
    -------
    SensorMap
        One component; constant sensors have no position.

    Raises
    ------
    InputError
        If the method cannot place these sensors in as many dimensions.
    ImportError
        If its library is not installed.

    Notes
    -----
    Isomap: Tenenbaum et al. (2000), doi:10.1126/science.290.5500.2319. UMAP: McInnes et al. (2018),
    arXiv:1802.03426. t-SNE: van der Maaten & Hinton (2008), JMLR 9: 2579-2605. Laplacian eigenmaps:
    Belkin & Niyogi (2003), doi:10.1162/089976603321780317. Where a graph of neighbours is not
    connected, scikit-learn joins its pieces.
    """
    rival = RIVALS[name]
    varying = recording.varying()
    readings = recording.readings[:, varying].astype(np.float64)
    positions = np.full((recording.n_sensors, dimensions), np.nan)
    # Warnings concern the libraries: an optional dependency, a graph that they have joined.
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore")
        module, _, kind = rival.kind.rpartition(".")
        estimator = getattr(import_module(module), kind)(**rival.settings)
        known = estimator.get_params()
        wanted: dict[str, float] = {"n_components": dimensions, "random_state": seed}
        if known.get("perplexity", 0) >= len(readings.T):
            wanted["perplexity"] = (len(readings.T) - 1) / 3  # its maximum
        estimator.set_params(**{key: wanted[key] for key in wanted.keys() & known.keys()})
        try:
            positions[varying] = estimator.fit_transform(_input(readings, known))
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            raise InputError(
                f"{name} cannot map {len(readings.T)} sensors in {dimensions} dimensions"
            ) from error
    return SensorMap(positions, names=recording.names, method=name, similarity="pearson")


def _input(readings: NDArray[np.float64], settings: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return what an estimator with some settings is given. readings (T, N) -> (N, N)."""
    r = np.corrcoef(readings.T)
    r = np.clip((r + r.T) / 2, -1, 1)
    if settings.get("metric") == "precomputed":
        distances = np.sqrt(np.maximum(2 * (1 - r), 0))
        np.fill_diagonal(distances, 0)
        return distances
    return np.maximum(r, 0) if settings.get("affinity") == "precomputed" else r
