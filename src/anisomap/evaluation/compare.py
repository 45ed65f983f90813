"""Several methods on one recording with known positions, scored on the same sensors.

Stock methods of scikit-learn and UMAP, a self-organising map and PHATE are baselines, not methods
of anisomap: they are not tuned. To add one, write a function of the correlations and add one line
to `RIVALS`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.special import entr
from threadpoolctl import threadpool_limits

from anisomap.base.defaults import DEFAULT_METHOD, MIN_TOUCHES
from anisomap.base.immutable import Immutable
from anisomap.errors import AnisomapWarning, InputError, MissingExtraError
from anisomap.evaluation import score
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.method.named import METHODS, PAPER_METHODS
from anisomap.method.reconstruction import reconstruct
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

ISOMAP_NEIGHBOURS = 8
"""Neighbours per sensor of Isomap; scikit-learn's default, 5, leaves skins in several pieces."""

_PERPLEXITY = 30.0  # scikit-learn's default; it must be less than the number of points
_UMAP_NEIGHBOURS = 15  # UMAP's default; it must be less than the number of points
_BARNES_HUT_DIMENSIONS = 3  # maximum of scikit-learn's fast t-SNE
_SOM_NODES = 5  # x the square root of the number of points, by Vesanto & Alhoniemi (2000)
_SOM_LAST_WIDTH = 0.5  # of the neighbourhood, in distances between nodes
_SOM_EPOCHS = 50
_PHATE_NEIGHBOURS, _PHATE_DECAY, _PHATE_TIMES = 5, 40, 100  # defaults of the authors' library
_PHATE_FLOOR = 1e-7  # the same library's; keeps the logarithm finite

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


def _fitted(module: str, kind: str, values: Array, dimensions: int, **settings: Any) -> Array:
    method = getattr(import_module(module), kind)(n_components=dimensions, **settings)
    return np.asarray(method.fit_transform(values), dtype=np.float64)


def _on_distances(module: str, kind: str, r: Array, dimensions: int, **settings: Any) -> Array:
    distances = correlation_distances(r)
    return _fitted(module, kind, distances, dimensions, metric="precomputed", **settings)


def _isomap(r: Array, dimensions: int, _: int) -> Array:
    # The dense solver is deterministic; ARPACK would start at a random vector.
    settings = {"n_neighbors": min(ISOMAP_NEIGHBOURS, len(r) - 1), "eigen_solver": "dense"}
    return _on_distances("sklearn.manifold", "Isomap", r, dimensions, **settings)


def _umap(r: Array, dimensions: int, seed: int) -> Array:
    settings = {"n_neighbors": min(_UMAP_NEIGHBOURS, len(r) - 1), "random_state": seed}
    return _on_distances("umap", "UMAP", r, dimensions, n_jobs=1, **settings)


def _tsne(r: Array, dimensions: int, seed: int) -> Array:
    settings = {
        "perplexity": _PERPLEXITY if len(r) > _PERPLEXITY else (len(r) - 1) / 3,
        "init": "random",
        "method": "barnes_hut" if dimensions <= _BARNES_HUT_DIMENSIONS else "exact",
        "random_state": seed,
    }
    return _on_distances("sklearn.manifold", "TSNE", r, dimensions, n_jobs=1, **settings)


def _pca(r: Array, dimensions: int, _: int) -> Array:
    # Kernel PCA on r is PCA of the standardised readings with sensors as observations.
    settings = {"kernel": "precomputed", "eigen_solver": "dense"}
    return _fitted("sklearn.decomposition", "KernelPCA", r, dimensions, **settings)


def _laplacian(r: Array, dimensions: int, seed: int) -> Array:
    settings = {"affinity": "precomputed", "random_state": seed}
    kind = "SpectralEmbedding"
    return _fitted("sklearn.manifold", kind, np.maximum(r, 0), dimensions, **settings)


def _som(r: Array, dimensions: int, _: int) -> Array:
    # Batch training from the principal components, which is deterministic. The inputs have the
    # inner products r, as the standardised readings of the sensors have.
    variances, axes = np.linalg.eigh(r)
    inputs = (axes * np.sqrt(np.maximum(variances, 0)))[:, ::-1]
    spread = inputs[:, :dimensions].std(axis=0)
    n_nodes = _SOM_NODES * math.sqrt(len(r))
    per_axis = (n_nodes / np.prod(spread / spread.max())) ** (1 / dimensions) * spread
    shape = np.maximum(np.rint(per_axis / spread.max()), 2).astype(int)
    nodes = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, dimensions)
    nodes = nodes.astype(np.float64)
    prototypes = np.zeros((len(nodes), len(r)))
    prototypes[:, :dimensions] = 2 * spread * (2 * nodes / (shape - 1) - 1)
    squares = cdist(nodes, nodes, "sqeuclidean")
    for width in np.geomspace(max(shape) / 2, _SOM_LAST_WIDTH, _SOM_EPOCHS):
        nearest = cdist(prototypes, inputs).argmin(axis=0)
        pull = np.exp(-squares[:, nearest] / (2 * width**2))
        prototypes = pull @ inputs / pull.sum(axis=1, keepdims=True)
    return np.asarray(nodes[cdist(prototypes, inputs).argmin(axis=0)])


def _phate(r: Array, dimensions: int, _: int) -> Array:
    distances = correlation_distances(r)
    neighbour = min(_PHATE_NEIGHBOURS, len(r) - 1)
    widths = np.maximum(np.sort(distances, axis=1)[:, neighbour], np.finfo(float).tiny)
    with np.errstate(over="ignore"):
        kernel = np.exp(-((distances / widths[:, np.newaxis]) ** _PHATE_DECAY))
    kernel = (kernel + kernel.T) / 2
    sums = kernel.sum(axis=1)
    # P^t = D^-1/2 V L^t V' D^1/2, with the eigenvalues L of the symmetric D^-1/2 K D^-1/2.
    values, vectors = np.linalg.eigh(kernel / np.sqrt(np.outer(sums, sums)))
    times = np.arange(1, _PHATE_TIMES + 1)
    shares = np.abs(values) ** times[:, np.newaxis]
    shares /= shares.sum(axis=1, keepdims=True)
    time = times[_knee(entr(shares).sum(axis=1))]
    diffused = (vectors * values**time) @ vectors.T * np.sqrt(sums / sums[:, np.newaxis])
    potential = -np.log(np.maximum(diffused, 0) + _PHATE_FLOOR)
    return smacof(cdist(potential, potential), dimensions=dimensions).positions


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


RIVALS: Mapping[str, Rival] = MappingProxyType(
    {
        "isomap-on-r": Rival("Isomap on sqrt(2 (1 - r)), 8 neighbours (scikit-learn)", _isomap),
        "umap-on-r": Rival("UMAP on sqrt(2 (1 - r)) (umap-learn)", _umap, "umap", "umap"),
        "tsne-on-r": Rival("t-SNE on sqrt(2 (1 - r)) (scikit-learn)", _tsne),
        "pca-on-r": Rival("principal components of standardised sensors (scikit-learn)", _pca),
        "laplacian-on-r": Rival("Laplacian eigenmaps on max(r, 0) (scikit-learn)", _laplacian),
        "som-on-r": Rival("self-organising map of standardised sensors, batch training", _som),
        "phate-on-r": Rival("PHATE on sqrt(2 (1 - r)), 5 neighbours, decay 40", _phate),
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
    Belkin & Niyogi (2003), doi:10.1162/089976603321780317. Self-organising map: Kohonen (1990),
    doi:10.1109/5.58325, with the number of nodes of Vesanto & Alhoniemi (2000),
    doi:10.1109/72.846731. PHATE: Moon et al. (2019), doi:10.1038/s41587-019-0336-3, with the
    parameters of the authors' library. Where a graph of neighbours is not connected, scikit-learn
    joins its pieces.
    """
    check_methods([name])
    varying = np.flatnonzero(recording.varying())
    positions = np.full((recording.n_sensors, dimensions), np.nan)
    # Warnings concern the libraries: an optional dependency, a graph that they have joined.
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore")
        try:
            r = np.corrcoef(recording.readings[:, varying].astype(np.float64).T)
            positions[varying] = RIVALS[name].place(np.clip((r + r.T) / 2, -1, 1), dimensions, seed)
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            raise InputError(
                f"{name} cannot map {len(varying)} sensors in {dimensions} dimensions"
            ) from error
    return SensorMap(positions, names=recording.names, method=name, similarity="pearson")


COMPARED = (DEFAULT_METHOD, "contact-fit", *PAPER_METHODS, *RIVALS)
"""Methods that are compared by default: the default method, its refinement by contacts, the paper's
methods, and the stock methods."""

_FLAT = 0.02  # relative singular value of positions below which a direction is not spanned
_MIN_SHARE = 0.5  # two maps that both place more than half of the sensors share some of them


@dataclass(frozen=True, eq=False)
class MethodScore:
    """Score of one method.

    Attributes
    ----------
    method : str
        A key of `anisomap.METHODS` or `anisomap.evaluation.compare.RIVALS`.
    mantel_r, rms_in_spacings : float
        Mantel r, and RMS error in median spacings, over the sensors of the `Comparison`; NaN
        without a score.
    sensor_map : SensorMap or None
        None if the method made no map.
    n_placed : int
        Sensors in the largest component of its map.
    reason : str
        Why there is no score; empty if there is one.
    """

    method: str
    mantel_r: float = math.nan
    rms_in_spacings: float = math.nan
    sensor_map: SensorMap | None = None
    n_placed: int = 0
    reason: str = ""

    @property
    def is_stock(self) -> bool:
        """Whether it is a stock method, not one of anisomap."""
        return self.method in RIVALS


@dataclass(frozen=True, eq=False)
class Comparison(Immutable):
    """Scores of several methods on one recording.

    Attributes
    ----------
    name : str
        Of the recording.
    n_sensors, n_frames, dimensions : int
        Sensors and frames of the recording; coordinates of the maps.
    sensors : ndarray of int
        Indices of the sensors that were scored, the same for all methods.
    scores : tuple of MethodScore
        In the order of the methods.
    """

    name: str
    n_sensors: int
    n_frames: int
    dimensions: int
    sensors: NDArray[np.intp]
    scores: tuple[MethodScore, ...]

    def best(self, *, stock: bool) -> MethodScore | None:
        """Return the stock method, or the method of anisomap, with the largest Mantel r, if any."""
        scored = [s for s in self.scores if s.is_stock is stock and not math.isnan(s.mantel_r)]
        return max(scored, key=lambda s: s.mantel_r, default=None)

    @property
    def judged(self) -> MethodScore | None:
        """The first method of anisomap: the default method, unless others were chosen."""
        return next((s for s in self.scores if not s.is_stock), None)

    @property
    def margin(self) -> float:
        """Mantel r of `judged` minus that of the best stock method; negative is a loss.

        NaN without a stock method or a method of anisomap; one without a score counts as 0.
        """
        own, stock = self.judged, self.best(stock=True)
        return float(np.nan_to_num(own.mantel_r)) - stock.mantel_r if own and stock else math.nan


def check_methods(methods: Sequence[str]) -> None:
    """Check that methods exist and are installed."""
    for name in methods:
        if name not in METHODS and name not in RIVALS:
            raise InputError(
                f"there is no method {name!r}; choose from {', '.join((*METHODS, *RIVALS))}"
            )
        if name in RIVALS and not RIVALS[name].installed:
            raise MissingExtraError(f"the method {name}", RIVALS[name].extra)


def compare_methods(
    recording: Recording,
    methods: Sequence[str] = COMPARED,
    dimensions: int | None = None,
    *,
    name: str = "",
    min_touches: int = MIN_TOUCHES,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Map a recording by several methods, and score all maps on the same sensors.

    Parameters
    ----------
    recording : Recording
        Complete readings, with true positions.
    methods : sequence of str
        Keys of `anisomap.METHODS` and `anisomap.evaluation.compare.RIVALS`. A stock method whose
        library is not installed has no score, but a reason.
    dimensions : int, optional
        Number of coordinates; by default as many as the true positions span.
    name : str
        Name of the recording; its source by default.
    min_touches : int
        Sensors that differ from their median reading in fewer frames are left out of all maps.
    seed : int
        Seed of stock methods that are random.
    progress : callable, optional
        Called with the completed share, from 0 to 1.

    Returns
    -------
    Comparison
        The sensors scored are those in the largest component of every map. A map whose largest
        component holds at most half of the sensors has no score, so that the failure of one method
        does not decide on which sensors the others are scored.

    Raises
    ------
    InputError
        If the recording has no true positions, a method is unknown, or fewer than 4 sensors were
        touched.
    """
    check_methods([m for m in methods if m not in RIVALS or RIVALS[m].installed])
    truth = recording.positions
    if truth is None:
        raise InputError("a comparison of methods requires true positions in the recording")
    kept = np.flatnonzero(touched(recording, min_touches))
    if len(kept) < MIN_SENSORS_COMPARED:
        raise InputError(
            f"a comparison requires at least 4 sensors that differ from rest in {min_touches} "
            f"frames, got {len(kept)}"
        )
    dimensions = dimensions or spanned_dimensions(truth)
    chosen = recording.select(kept)
    made = []
    for number, method in enumerate(methods):
        made.append(_made(chosen, method, dimensions, seed))
        if progress is not None:
            progress((number + 1) / len(methods))
    common = np.asarray(np.isfinite(truth[kept]).all(axis=1))
    for one in made:
        if one.sensor_map is not None and not one.reason:
            common &= one.sensor_map.component == 0
    scores = tuple(_scored(one, truth[kept], common) for one in made)
    shape = recording.n_sensors, recording.n_frames
    return Comparison(name or recording.source, *shape, dimensions, kept[common], scores)


def touched(recording: Recording, min_touches: int) -> NDArray[np.bool_]:
    """Select sensors that differ from their median reading in at least `min_touches` frames."""
    readings = recording.readings
    beyond = np.count_nonzero(readings != np.median(readings, axis=0), axis=0)
    return np.asarray(beyond >= min_touches)


def spanned_dimensions(positions: NDArray[np.float64]) -> int:
    """Count the dimensions that positions span: 2 for a flat skin with coordinates in space."""
    known = positions[np.isfinite(positions).all(axis=1)]
    extents = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
    return max(1, int(np.count_nonzero(extents > _FLAT * extents[0])))


def _made(recording: Recording, method: str, dimensions: int, seed: int) -> MethodScore:
    """Make the map of one method; there is no score yet, but a reason if there will be none."""
    try:
        if method in RIVALS:
            sensor_map = map_by_rival(recording, method, dimensions, seed=seed)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)  # the notes remain on the map
                sensor_map = reconstruct(recording, method, dimensions)
    except MissingExtraError:
        return MethodScore(method, reason=f"not installed: {RIVALS[method].command}")
    except InputError as error:
        return MethodScore(method, reason=str(error))
    n_placed, n_sensors = int(np.count_nonzero(sensor_map.component == 0)), recording.n_sensors
    reason = f"its largest component holds {n_placed} of {n_sensors} sensors"
    if n_placed > _MIN_SHARE * n_sensors:
        reason = ""
    return MethodScore(method, sensor_map=sensor_map, n_placed=n_placed, reason=reason)


def _scored(
    made: MethodScore, truth: NDArray[np.float64], common: NDArray[np.bool_]
) -> MethodScore:
    """Score a map on the sensors that all maps place. truth (N, k), common (N,)."""
    if made.sensor_map is None or made.reason:
        return made
    try:
        found = score(SensorMap(made.sensor_map.positions[common]), truth[common], permutations=0)
    except InputError as error:
        return replace(made, reason=str(error))
    return replace(made, mantel_r=found.mantel.r, rms_in_spacings=found.rms_in_spacings)
