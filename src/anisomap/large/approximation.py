"""Approximate maps of very many sensors, from a small share of all pairs, by landmark MDS."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from anisomap._version import __version__
from anisomap.errors import InputError
from anisomap.health import SensorHealth, assess
from anisomap.large.chunks import (
    CHUNK_READINGS,
    Chunks,
    Excerpt,
    ReadInChunks,
    complete_chunks,
    split_array,
)
from anisomap.large.sensor_graph import (
    ApproximateOptions,
    SensorPairs,
    Sketch,
    adjacency_matrix,
    bridge_components,
    build_graph,
    compute_sketch,
    correlations,
    edge_lengths,
    pairs_of,
)
from anisomap.method.dimensions import AUTO, Dimensions, check_dimensions, given_dimensions
from anisomap.method.options import MethodOptions
from anisomap.method.reconstruction import caveats, check_unlike
from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.graph.neighbour_graphs import most_similar
from anisomap.numerics.precision import Floats
from anisomap.numerics.scaling.multidimensional_scaling import (
    SmacofOptions,
    SolverResult,
    minimise_lbfgs,
    smacof,
)
from anisomap.recording import MissingPolicy, Recording, sensor_mask
from anisomap.sensor_map import UNPLACED, SensorMap

logger = logging.getLogger(__name__)

APPROXIMATED = "r-anisomap"
"""The method of approximate maps."""

EXCERPT_READINGS = 1 << 27  # from which sensor health is assessed; many sensors require many

_UNEXAMINED = (
    "approximate maps do not show whether the skin is flat, so the map has 3 dimensions: for a "
    "flat skin, choose 2 (-d 2)"
)
_MIN_CONTACTS = 20  # in the excerpt, for its assessment to count; chosen by hand


@dataclass(frozen=True, eq=False)
class SimilarityGraph(ReadInChunks):
    """Graph of the most similar sensors, and other data of an approximate map.

    links: All pairs for which r was computed.
    edges: Those that link sensors.
    component: Connected component of each sensor, by decreasing size, (N,).
    dropped: Mask of the dropped sensors, which do not vary.
    """

    links: SensorPairs
    edges: SensorPairs
    component: NDArray[np.intp]
    dropped: NDArray[np.bool_]
    options: ApproximateOptions


def reconstruct_approximately(
    readings: NDArray[Any] | Chunks,
    dimensions: Dimensions = AUTO,
    *,
    options: MethodOptions | None = None,
    approximate: ApproximateOptions | None = None,
    names: Sequence[str] = (),
    missing: MissingPolicy = "error",
    drop: Iterable[str | int] = (),
) -> SensorMap:
    """Reconstruct an approximate r-ANISOMAP map, for too many sensors to compare all pairs.

    Parameters
    ----------
    readings : ndarray of shape (T, N), or callable
        A memory-mapped array, or a function that opens the recording at each call and returns its
        chunks, arrays of shape (t, N). It is read twice or more.
    dimensions : int or "auto"
        Number of coordinates; ``"auto"`` means 3, with a note.
    options : MethodOptions, optional
        Only `regularisation`, `smacof` and `min_sensors` are used.
    approximate : ApproximateOptions, optional
        Sizes of the approximation, and the seed.
    names : sequence of str, optional
        Names of the sensors.
    missing : {"error", "drop-frames", "interpolate"}
        As for `reconstruct_chunks`.
    drop : iterable of str or int
        As for `anisomap.reconstruct`.

    Returns
    -------
    SensorMap
        With `SensorMap.approximate` set, and a note. The same seed gives the same map for any
        number of threads. Stress-1 covers pairs with landmarks only.

    Raises
    ------
    InputError
        If a reading is missing, too few sensors vary or are related, all read the same, chunks
        differ in their number of sensors, or a sensor is unknown.

    Warns
    -----
    AnisomapWarning
        Once for each note of the map.

    Notes
    -----
    ``docs/explanation/large-recordings.md`` gives the steps and the accuracy. Components without
    statistically significant links are mapped separately, for any `regularisation`.
    """
    chunks = readings if callable(readings) else split_array(np.asanyarray(readings))
    graph = build_similarity_graph(
        chunks, like=names, missing=missing, drop=drop, options=approximate
    )
    return map_similarity_graph(graph, dimensions, options=options)


def build_similarity_graph(
    chunks: Chunks,
    *,
    like: Recording | Sequence[str] = (),
    missing: MissingPolicy = "error",
    drop: Iterable[str | int] = (),
    options: ApproximateOptions | None = None,
) -> SimilarityGraph:
    """Link each sensor to the most similar sensors, reading all frames twice or more."""
    chosen = options or ApproximateOptions()
    segments, complete = Excerpt(EXCERPT_READINGS), complete_chunks(chunks, missing)

    def small_chunks() -> Iterator[NDArray[Any]]:
        for chunk in complete():
            n_frames = max(1, CHUNK_READINGS // chunk.shape[1])
            yield from (chunk[i : i + n_frames] for i in range(0, len(chunk), n_frames))

    def sampled_chunks() -> Iterator[NDArray[Any]]:
        for chunk in small_chunks():
            segments.add(chunk)
            yield chunk

    logger.info("computing sketches of all sensors")
    sketch = compute_sketch(
        sampled_chunks(), chosen.sketch_size, np.random.default_rng(chosen.seed)
    )
    excerpt = segments.recording(like)
    dropped = sensor_mask(excerpt.names, drop)
    projections = np.where(dropped[:, None], np.float32(0), sketch.projections)
    sketch = replace(sketch, varying=sketch.varying & ~dropped, projections=projections)
    logger.info("searching for the most similar sensors")
    links = correlations(small_chunks(), sketch, _candidates(sketch, chosen))
    edges, component, bridging = bridge_components(
        build_graph(links, sketch, chosen.n_neighbours), sketch, small_chunks
    )
    links = links.concatenate(bridging)
    best = links.best(len(sketch.mean))
    health = assess(excerpt, best_match=np.where(np.isfinite(best), best, np.nan))
    return SimilarityGraph(
        n_frames=sketch.n_frames,
        varying=sketch.varying,
        links=links,
        edges=edges,
        component=component,
        excerpt=excerpt,
        health=tuple(_extrapolated(health, sketch, component, excerpt.n_frames)),
        dropped=dropped,
        options=chosen,
    )


def map_similarity_graph(
    found: SimilarityGraph,
    dimensions: Dimensions = AUTO,
    *,
    options: MethodOptions | None = None,
) -> SensorMap:
    """Reconstruct an approximate map from a graph of similar sensors."""
    chosen = options or MethodOptions()
    check_dimensions(dimensions)
    n_dimensions = given_dimensions(dimensions)
    n_sensors = len(found.varying)
    component = np.full(n_sensors, UNPLACED)
    _, numbers = np.unique(found.component[found.varying], return_inverse=True)
    component[found.varying] = numbers
    if np.count_nonzero(component == 0) < chosen.min_sensors:
        raise InputError(
            f"a map requires at least {chosen.min_sensors} sensors with statistically significant "
            f"links, but the largest group has {np.count_nonzero(component == 0)}; check that the "
            "skin was touched during the recording"
        )
    lengths = edge_lengths(found.links, found.edges, chosen.regularisation)
    graph = adjacency_matrix(found.edges, lengths, n_sensors)
    positions = np.full((n_sensors, n_dimensions), np.nan)
    rng = np.random.default_rng(found.options.seed)
    placed: list[PlacedComponent] = []
    for members in _members(component):
        edges = graph[members][:, members]
        placed.append(
            place_component(edges, n_dimensions, found.options.n_landmarks, chosen.smacof, rng)
        )
        positions[members] = placed[-1].positions
    _, raw_stress, spread, converged, iterations = zip(*placed, strict=True)
    n_iterations = max(iterations)
    made = SensorMap(
        positions,
        names=found.excerpt.names,
        component=component,
        method=APPROXIMATED,
        similarity="pearson",
        approximate=True,
        n_iterations=n_iterations,
        stress=np.sqrt(sum(raw_stress) / sum(spread)) if sum(spread) > 0 else 0.0,
        notes=(_UNEXAMINED,) if dimensions == AUTO else (),
        provenance={
            "anisomap": __version__,
            "similarity": "pearson",
            "regularisation": chosen.regularisation,
            **{f"approximate_{name}": value for name, value in asdict(found.options).items()},
            **asdict(chosen.smacof),
            "iterations": n_iterations,
        },
    )
    sizes = found.options
    approximate = (
        f"this map is approximate: r was computed for each sensor with {sizes.n_candidates} "
        f"candidates only, found by a sketch of {sizes.sketch_size} numbers; shortest paths use "
        f"the best {sizes.n_neighbours} of them and lead to {sizes.n_landmarks} landmarks only"
    )
    notes = caveats(component, found.excerpt.names, converged=all(converged))
    return found.complete(made, (approximate, *notes), found.dropped)


def _candidates(
    sketch: Sketch, options: ApproximateOptions
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of sensors with the most similar sketches."""
    sensors = np.flatnonzero(sketch.varying)
    if sensors.size < 2:
        raise InputError(
            "an approximate map requires at least 2 sensors that vary and are not dropped, got "
            f"{sensors.size} of {len(sketch.mean)}"
        )
    projections = sketch.projections[sensors]
    check_unlike(projections.T, rows_of=np.transpose)
    count = min(options.n_candidates, len(sensors) - 1)
    found, _ = most_similar(projections, count)
    firsts, seconds = pairs_of(found)
    return sensors[firsts], sensors[seconds]


def _extrapolated(
    health: Sequence[SensorHealth],
    sketch: Sketch,
    component: NDArray[np.intp],
    n_assessed: int,
) -> Iterator[SensorHealth]:
    """Extend the assessment of the excerpt to all frames."""
    alone = np.bincount(component)[component] == 1
    for i, sensor in enumerate(health):
        revised = sensor
        if n_assessed < sketch.n_frames:
            revised = replace(sensor, contacts=int(sketch.contacts[i]))
            if sketch.varying[i] and sensor.contacts < _MIN_CONTACTS:
                revised = replace(revised, status="ok", reason="")
        if sketch.varying[i] and alone[i] and revised.status == "ok":
            reason = "no significant correlation with another sensor"
            revised = replace(revised, status="isolated", reason=reason)
        yield revised


def _members(component: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """List the sensors of each component, the largest component first."""
    order = np.argsort(component, kind="stable")
    order = order[component[order] != UNPLACED]
    return np.split(order, np.flatnonzero(np.diff(component[order])) + 1)


_MIN_TOLERANCE = 1e-7  # of the refinement: path lengths are stored in float32
_SOURCES_PER_TASK = 64  # landmarks from which paths are computed together; chosen by hand
_ROWS_PER_BLOCK = 4096  # sensors that are triangulated together; bounds memory
_N_TASKS = 32  # parallel; fixed, so that sums are the same on every machine


class Targets(NamedTuple):
    """Landmarks, distance of each sensor from each, and distances of adjacent sensors, (N, N)."""

    landmarks: NDArray[np.int64]
    rows: NDArray[np.float32]
    edges: csr_array[Any, tuple[int, int]]

    @property
    def share(self) -> float:
        """Share of a sensor's pairs that involve landmarks: the weight of an edge."""
        return len(self.landmarks) / len(self.rows)


def refine(targets: Targets, start: Floats, tolerance: float, max_iterations: int) -> SolverResult:
    """Minimise the raw stress of the pairs with landmarks and of the edges. start (N, k).

    The L pairs of each sensor with landmarks represent its N - 1 pairs, so their weight is N / L,
    and that of an edge is 1 (both times L / N).
    """
    n_points, n_landmarks = targets.rows.shape
    weight = n_landmarks + targets.share * np.diff(targets.edges.indptr)
    weight[targets.landmarks] += n_points
    cuts = np.linspace(0, n_points, _N_TASKS + 1).astype(int).tolist()
    edges = targets.edges.indptr.astype(np.int64), targets.edges.indices, targets.edges.data
    loops = load_loops("stress")
    with parallel_map(n_points) as map_tasks:

        def stress(positions: Floats) -> tuple[float, Floats]:
            exact = np.ascontiguousarray((positions - positions.mean(axis=0)).T)
            points = exact.astype(np.float32)
            anchors = np.ascontiguousarray(points[:, targets.landmarks])
            slopes, anchor_slopes = np.zeros_like(exact), np.zeros((_N_TASKS, *anchors.shape))

            def add(task: int) -> float:
                rows = cuts[task], cuts[task + 1]
                near = loops.add_edges_stress(exact, edges, targets.share, slopes, rows)
                both = slopes, anchor_slopes[task]
                far = loops.add_rows_stress(points, anchors, targets.rows, rows, both)
                return float(near + far)

            raw = sum(map_tasks(add, range(_N_TASKS)))
            slopes[:, targets.landmarks] += anchor_slopes.sum(axis=0)
            return raw, np.ascontiguousarray(2 * slopes.T)

        blocks = np.array_split(targets.rows, _N_TASKS)
        squares = sum(float(np.square(rows, dtype=np.float64).sum()) for rows in blocks)
        return minimise_lbfgs(
            stress,
            start,
            2 * weight[:, None],
            squares=squares,
            tolerance=tolerance,
            max_iterations=max_iterations,
        )


def stress_of(targets: Targets, positions: Floats) -> tuple[float, float]:
    """Return the raw stress of the pairs with landmarks, and the sum of their squared distances."""
    raw = squared_sum = 0.0
    anchors = positions[targets.landmarks]
    for begin in range(0, len(positions), 1024):
        part = positions[begin : begin + 1024]
        squares = ((part[:, None] - anchors) ** 2).sum(axis=2)
        squared_sum += float(squares.sum())
        raw += float(((np.sqrt(squares) - targets.rows[begin : begin + 1024]) ** 2).sum())
    return raw, squared_sum


class PlacedComponent(NamedTuple):
    """Positions (n, k) of a component, and sums of (d - D)^2 and d^2 over pairs with landmarks."""

    positions: Floats
    raw_stress: float
    spread: float
    converged: bool
    iterations: int


def place_component(
    graph: csr_array[Any, tuple[int, int]],
    dimensions: int,
    n_landmarks: int,
    options: SmacofOptions,
    rng: np.random.Generator,
) -> PlacedComponent:
    """Compute the positions of the sensors of a connected graph. graph (n, n).

    Random landmarks are about as dense as the sensors; de Silva & Tenenbaum (2004) found them as
    good as optimised ones if they are many more than the dimensions.
    """
    n_sensors = graph.shape[0]
    if n_sensors == 1:
        return PlacedComponent(np.zeros((1, dimensions)), 0.0, 0.0, converged=True, iterations=0)
    chosen = np.sort(rng.choice(n_sensors, min(n_landmarks, n_sensors), replace=False))
    logger.info("finding shortest paths from %d landmarks", len(chosen))
    rows = paths_from(chosen, graph)
    lengths = rows[chosen].astype(np.float64)
    anchors = smacof(np.minimum(lengths, lengths.T), dimensions=dimensions, options=options)
    positions = triangulate(rows, anchors.positions)
    positions[chosen] = anchors.positions
    targets = Targets(chosen, rows, graph)
    logger.info("refining %d sensors in %d dimensions", n_sensors, dimensions)
    tolerance = max(options.tolerance, _MIN_TOLERANCE)
    found = refine(targets, positions, tolerance, options.max_iterations)
    return PlacedComponent(
        found.positions - found.positions.mean(axis=0),
        *stress_of(targets, found.positions),
        converged=found.converged and anchors.converged,
        iterations=len(found.trace) - 1,
    )


def paths_from(landmarks: ArrayLike, graph: csr_array[Any, tuple[int, int]]) -> NDArray[np.float32]:
    """Compute the lengths of the shortest paths from landmarks to all sensors. graph (N, N)."""
    sources = np.asarray(landmarks, dtype=np.int64)
    # Neighbours follow one another, so that a sweep extends paths far. The result is the same in
    # any order.
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    edges = (
        graph.indptr.astype(np.int64),
        graph.indices.astype(np.int64),
        graph.data.astype(np.float32),
    )
    found = np.empty((graph.shape[0], len(sources)), dtype=np.float32)
    # Landmarks that are adjacent in this order are close, so their sweeps converge together.
    ranked = np.argsort(np.argsort(order)[sources], kind="stable")

    def relax(begin: int) -> None:
        chosen = ranked[begin : begin + _SOURCES_PER_TASK]
        tile = np.empty((len(found), len(chosen)), dtype=np.float32)
        load_loops("graphs").relax_from(tile, sources[chosen], order, edges)
        found[:, chosen] = tile

    with parallel_map(len(found)) as map_tasks:
        map_tasks(relax, range(0, len(sources), _SOURCES_PER_TASK))
    return found


def triangulate(rows: NDArray[np.float32], landmarks: Floats) -> Floats:
    """Compute positions from distances to landmarks. rows (N, L), landmarks (L, k) -> (N, k).

    De Silva & Tenenbaum (2004), "Sparse multidimensional scaling using landmark points", section
    3.2: ``y = -1/2 X^+ (d^2 - |x|^2)`` with centred landmarks X.
    """
    centre = landmarks.mean(axis=0)
    centred = landmarks - centre
    inverse = np.linalg.pinv(centred, rcond=1e-7)
    squares = (centred**2).sum(axis=1)
    positions = np.empty((len(rows), landmarks.shape[1]))
    for begin in range(0, len(rows), _ROWS_PER_BLOCK):
        part = rows[begin : begin + _ROWS_PER_BLOCK].astype(np.float64)
        positions[begin : begin + _ROWS_PER_BLOCK] = (squares - part**2) @ inverse.T / 2
    return np.asarray(positions + centre)
