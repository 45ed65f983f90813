"""Stock methods, estimators of scikit-learn that see the correlations of sensors alone.

They are baselines, not methods of anisomap: they are not tuned. To add one, add one line to
`RIVALS`; others are passed with a name.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, clone
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError, MissingExtraError
from anisomap.method.named import METHODS
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

Method: TypeAlias = str | tuple[str, BaseEstimator]
"""A name, or a name and an estimator, as the steps of a pipeline of scikit-learn."""


class Rival(NamedTuple):
    """A stock method: module and class of the estimator, its settings, and the extra it needs."""

    summary: str
    kind: str
    settings: Mapping[str, Any]
    extra: str = ""

    @property
    def installed(self) -> bool:
        """Whether its library is installed."""
        return find_spec(self.kind.partition(".")[0]) is not None

    @property
    def estimator(self) -> BaseEstimator:
        """The estimator, without a number of components and a seed."""
        module, _, name = self.kind.rpartition(".")
        return getattr(import_module(module), name)(**self.settings)


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
            "umap",
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
    }
)
"""Name of each stock method; ``-on-r`` tells them from the methods of anisomap."""


def map_by_rival(
    recording: Recording, method: Method, dimensions: int, *, seed: int = 0
) -> SensorMap:
    """Map a recording by a stock method or an estimator, with one thread.

    Parameters
    ----------
    recording : Recording
        Complete readings.
    method : str, or tuple of str and estimator
        A key of `RIVALS`, or a name and an estimator with ``fit_transform`` that places the rows of
        a matrix: standardised sensors, a row each. If its `metric`, `affinity` or `kernel` is
        ``"precomputed"``, it is given sqrt(2 (1 - r)), max(r, 0) or r of all pairs of sensors.
    dimensions : int
        Number of coordinates: `n_components` of the estimator.
    seed : int
        `random_state` of estimators that have one: t-SNE, UMAP, Laplacian eigenmaps.

    Returns
    -------
    SensorMap
        One component; constant sensors have no position.

    Raises
    ------
    InputError
        If the method cannot place these sensors in as many dimensions.
    MissingExtraError
        If its library is not installed.

    Notes
    -----
    Isomap: Tenenbaum et al. (2000), doi:10.1126/science.290.5500.2319. UMAP: McInnes et al. (2018),
    arXiv:1802.03426. t-SNE: van der Maaten & Hinton (2008), JMLR 9: 2579-2605. Laplacian eigenmaps:
    Belkin & Niyogi (2003), doi:10.1162/089976603321780317. Where a graph of neighbours is not
    connected, scikit-learn joins its pieces.
    """
    check_methods([method])
    varying = recording.varying()
    readings = recording.readings[:, varying].astype(np.float64)
    positions = np.full((recording.n_sensors, dimensions), np.nan)
    # Warnings concern the libraries: an optional dependency, a graph that they have joined.
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore")
        try:
            estimator = RIVALS[method].estimator if isinstance(method, str) else clone(method[1])
            known = estimator.get_params()
            wanted: dict[str, float] = {"n_components": dimensions, "random_state": seed}
            if known.get("perplexity", 0) >= len(readings.T):
                wanted["perplexity"] = (len(readings.T) - 1) / 3  # its maximum
            estimator.set_params(**{key: wanted[key] for key in wanted.keys() & known.keys()})
            positions[varying] = estimator.fit_transform(_input(readings, known))
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            raise InputError(
                f"{name_of(method)} cannot map {len(readings.T)} sensors in {dimensions} dimensions"
            ) from error
    return SensorMap(positions, names=recording.names, method=name_of(method), similarity="pearson")


def _input(readings: NDArray[np.float64], settings: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return what an estimator with some settings is given. readings (T, N) -> (N, N or T)."""
    r = np.corrcoef(readings.T)
    r = np.clip((r + r.T) / 2, -1, 1)
    if settings.get("metric") == "precomputed":
        distances = np.sqrt(np.maximum(2 * (1 - r), 0))
        np.fill_diagonal(distances, 0)
        return distances
    if settings.get("affinity") == "precomputed":
        return np.maximum(r, 0)
    if settings.get("kernel") == "precomputed":
        return r
    rows = (readings - readings.mean(axis=0)).T
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def name_of(method: Method) -> str:
    """Return the name of a method."""
    return method if isinstance(method, str) else method[0]


def check_methods(methods: Sequence[Method]) -> None:
    """Check that methods exist and are installed."""
    for method in methods:
        name = name_of(method)
        if (name in METHODS or name in RIVALS) is not isinstance(method, str):
            raise InputError(
                f"there is no method {name!r}; choose from {', '.join((*METHODS, *RIVALS))}"
                if isinstance(method, str)
                else f"{name!r} is a method of anisomap: give the estimator another name"
            )
        if name in RIVALS and not RIVALS[name].installed:
            raise MissingExtraError(f"the method {name}", RIVALS[name].extra)
