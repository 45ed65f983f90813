"""Stock methods of scikit-learn and UMAP on correlations: baselines for comparison.

They are no methods of anisomap: they are not tuned, and used by comparisons only. To add one, write
a function of the correlations and add one line to `RIVALS`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError, MissingExtraError
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

ISOMAP_NEIGHBOURS = 8
"""Neighbours per sensor of Isomap; scikit-learn's default, 5, leaves skins in several pieces."""

_PERPLEXITY = 30.0  # scikit-learn's default; it must be less than the number of points
_UMAP_NEIGHBOURS = 15  # UMAP's default; it must be less than the number of points
_BARNES_HUT_DIMENSIONS = 3  # maximum of scikit-learn's fast t-SNE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rival:
    """A stock method.

    Attributes
    ----------
    summary : str
        Description in one line.
    place : callable
        ``place(r, dimensions, seed)`` takes Pearson correlations, shape (N, N), and returns
        positions, shape (N, dimensions).
    module : str
        Optional library that it needs; empty if none.
    extra : str
        Extra of anisomap that installs the library.
    """

    summary: str
    place: Callable[[Array, int, int], Array]
    module: str = ""
    extra: str = ""

    @property
    def installed(self) -> bool:
        """Whether the library that it needs is installed."""
        return not self.module or find_spec(self.module) is not None

    @property
    def command(self) -> str:
        """Command that installs the library; empty if none is needed."""
        return f"pip install 'anisomap[{self.extra}]'" if self.extra else ""


def correlation_distances(r: Array) -> Array:
    """Distance of sensors whose standardised readings are points on a sphere: sqrt(2 (1 - r))."""
    distances = np.sqrt(np.maximum(2 * (1 - r), 0))
    np.fill_diagonal(distances, 0)
    return distances


def _isomap(r: Array, dimensions: int, _: int) -> Array:
    # The dense solver is deterministic; ARPACK would start at a random vector.
    method = import_module("sklearn.manifold").Isomap(
        n_neighbors=min(ISOMAP_NEIGHBOURS, len(r) - 1),
        n_components=dimensions,
        metric="precomputed",
        eigen_solver="dense",
    )
    return np.asarray(method.fit_transform(correlation_distances(r)))


def _umap(r: Array, dimensions: int, seed: int) -> Array:
    method = import_module("umap").UMAP(
        n_neighbors=min(_UMAP_NEIGHBOURS, len(r) - 1),
        n_components=dimensions,
        metric="precomputed",
        random_state=seed,
        n_jobs=1,
    )
    return np.asarray(method.fit_transform(correlation_distances(r)), dtype=np.float64)


def _tsne(r: Array, dimensions: int, seed: int) -> Array:
    method = import_module("sklearn.manifold").TSNE(
        dimensions,
        perplexity=_PERPLEXITY if len(r) > _PERPLEXITY else (len(r) - 1) / 3,
        metric="precomputed",
        init="random",
        method="barnes_hut" if dimensions <= _BARNES_HUT_DIMENSIONS else "exact",
        random_state=seed,
        n_jobs=1,
    )
    return np.asarray(method.fit_transform(correlation_distances(r)), dtype=np.float64)


def _pca(r: Array, dimensions: int, _: int) -> Array:
    # Kernel PCA on r is PCA of the standardised readings with sensors as observations.
    method = import_module("sklearn.decomposition").KernelPCA(
        dimensions, kernel="precomputed", eigen_solver="dense"
    )
    return np.asarray(method.fit_transform(r))


def _laplacian(r: Array, dimensions: int, seed: int) -> Array:
    method = import_module("sklearn.manifold").SpectralEmbedding(
        dimensions, affinity="precomputed", random_state=seed
    )
    return np.asarray(method.fit_transform(np.maximum(r, 0)))


RIVALS: Mapping[str, Rival] = MappingProxyType(
    {
        "isomap-on-r": Rival("Isomap on sqrt(2 (1 - r)), 8 neighbours (scikit-learn)", _isomap),
        "umap-on-r": Rival("UMAP on sqrt(2 (1 - r)) (umap-learn)", _umap, "umap", "umap"),
        "tsne-on-r": Rival("t-SNE on sqrt(2 (1 - r)) (scikit-learn)", _tsne),
        "pca-on-r": Rival("principal components of standardised sensors (scikit-learn)", _pca),
        "laplacian-on-r": Rival("Laplacian eigenmaps on max(r, 0) (scikit-learn)", _laplacian),
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
        Seed of methods that are random: t-SNE, UMAP and the eigensolver of Laplacian eigenmaps.

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
    rival = RIVALS[name]
    if not rival.installed:
        raise MissingExtraError(f"the method {name}", rival.extra)
    varying = np.flatnonzero(recording.varying())
    positions = np.full((recording.n_sensors, dimensions), np.nan)
    # Warnings concern the libraries: an optional dependency, a graph that they have joined.
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore")
        try:
            r = np.corrcoef(recording.readings[:, varying].astype(np.float64).T)
            positions[varying] = rival.place(np.clip((r + r.T) / 2, -1, 1), dimensions, seed)
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            raise InputError(
                f"{name} cannot map {len(varying)} sensors in {dimensions} dimensions"
            ) from error
    return SensorMap(positions, names=recording.names, method=name, similarity="pearson")
