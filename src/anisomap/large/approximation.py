"""Approximate maps of very many sensors, from a small share of all pairs."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap._version import __version__
from anisomap.dimensions import AUTO, Dimensions, check_dimensions, given_dimensions
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
from anisomap.large.landmark_mds import PlacedComponent, place_component
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
from anisomap.numerics.graph.neighbour_graphs import most_similar
from anisomap.options import MethodOptions
from anisomap.reconstruction import caveats, check_unlike
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
