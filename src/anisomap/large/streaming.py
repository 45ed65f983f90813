"""Maps of recordings that do not fit in memory: frames are read in chunks."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.defaults import DEFAULT_METHOD
from anisomap.dimensions import AUTO, Dimensions
from anisomap.errors import InputError
from anisomap.health import SensorHealth, assess
from anisomap.large.checkpoints import Checkpoint
from anisomap.large.chunked_similarity import CHUNKED, computed_similarity
from anisomap.large.chunks import (
    SEGMENT_FRAMES,
    Chunks,
    Excerpt,
    ReadInChunks,
    complete_chunks,
    split_array,
)
from anisomap.large.map_reduce import SERIAL, WorkerPool, map_reduce
from anisomap.memory import check_pair_memory, check_worker_memory
from anisomap.methods import check_even_spacing, find_method
from anisomap.numerics.geodesic.neighbours import neighbour_graph, unevenness
from anisomap.numerics.geodesic.path_lengths import MAX_UNEVENNESS
from anisomap.numerics.precision import MAX_SQUARED, Reals
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.similarity.binning import ValueCounts
from anisomap.numerics.similarity.correlation import squares_overflow
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct_from
from anisomap.recording import MissingPolicy, Recording, sensor_mask
from anisomap.refinements.chain import MIN_SENSORS
from anisomap.sensor_map import SILENT, SensorMap

logger = logging.getLogger(__name__)

_NOT_EXAMINED = (
    "distances between neighbours on the map are very unequal, and may be wrong: to correct them "
    "by the heights of contacts, map a part of the recording that fits in memory"
)

_MAX_EXAMINED = 2000  # sensors; finding the neighbours of more takes longer than the map


@dataclass(frozen=True, eq=False)
class StreamedSimilarity(ReadInChunks):
    """Similarity of all pairs of sensors over all frames, and other data of a map.

    similarity (N, N): Symmetric.
    notes: Differences from a map of one array.
    """

    similarity: Reals
    notes: tuple[str, ...] = ()


def reconstruct_chunks(
    readings: NDArray[Any] | Chunks,
    method: str = DEFAULT_METHOD,
    dimensions: Dimensions = AUTO,
    *,
    options: MethodOptions | None = None,
    names: Sequence[str] = (),
    missing: MissingPolicy = "error",
    drop: Iterable[str | int] = (),
    pool: WorkerPool = SERIAL,
    checkpoint: Path | None = None,
) -> SensorMap:
    """Reconstruct positions from a recording that does not fit in memory.

    Parameters
    ----------
    readings : ndarray of shape (T, N), or callable
        A memory-mapped array (``np.load(path, mmap_mode="r")``), or a function that opens the
        recording at each call and returns its chunks, arrays of shape (t, N).
    method, dimensions, options, drop
        As for `anisomap.reconstruct`.
    names : sequence of str, optional
        Names of the sensors.
    missing : {"error", "drop-frames", "interpolate"}
        How to handle missing readings: see `complete_chunks`.
    pool : WorkerPool
        Workers that share the computation.
    checkpoint : pathlib.Path, optional
        File for intermediate results; if it exists, the computation resumes from it. Checkpoints of
        other readings or another method are refused.

    Returns
    -------
    SensorMap
        With sensor health, without a verdict. The map equals that of `anisomap.reconstruct`
        with these exceptions, each with a note: "covariogram" and "contact-fit" use Pearson's r
        alone and do not examine contacts; very many distinct values of a sensor are rounded for
        bins, ranks and rest values.

    Raises
    ------
    InputError
        See `anisomap.reconstruct`; or if chunks differ in their number of sensors.
    FileError
        If the checkpoint is damaged, or was made from other readings or by another method.

    Warns
    -----
    AnisomapWarning
        Once for each note of the map.
    """
    chunks = readings if callable(readings) else split_array(np.asanyarray(readings))
    chosen = options or MethodOptions()
    settings: dict[str, Any] = {"missing": missing, "pool": pool, "checkpoint": checkpoint}
    found = stream_similarity(chunks, method, chosen, like=names, **settings)
    return map_streamed_similarity(found, method, dimensions, options=chosen, drop=drop)


def stream_similarity(
    chunks: Chunks,
    method: str,
    options: MethodOptions,
    *,
    like: Recording | Sequence[str] = (),
    missing: MissingPolicy = "error",
    pool: WorkerPool = SERIAL,
    checkpoint: Path | None = None,
    source: str = "",
) -> StreamedSimilarity:
    """Compute the similarity that a method uses over all frames, in one or two passes."""
    check_even_spacing(method, options, readings=False)
    recipe = find_method(method)
    name, refined = recipe.similarity, bool(recipe.refinements)
    chunked, complete = CHUNKED[name], complete_chunks(chunks, missing)
    segments = Excerpt()
    subject = f"{name} of {source or 'frames'}, {options.bins} bins"
    saved = Checkpoint(checkpoint, subject) if checkpoint else None

    def checked_chunks() -> Iterator[NDArray[Any]]:
        segments.reset()
        for chunk in complete():
            check_pair_memory(chunk.shape[1], refined=refined)
            check_worker_memory(chunk.shape[1], pool.n_workers)
            _check_unit(chunk)
            segments.add(chunk)
            yield chunk

    values: ValueCounts | None = None
    if chunked.needs_values:
        logger.info("counting distinct values")
        values = map_reduce(
            checked_chunks, ValueCounts.of, pool=pool, checkpoint=saved, stage="values"
        )
    logger.info("comparing all pairs of sensors (%s)", name)
    total = map_reduce(
        checked_chunks,
        chunked.prepare(values, options.bins),
        pool=pool,
        checkpoint=saved,
        stage="pairs",
        after="" if values is None else "values",
    )
    varying = total.varying() if values is None else values.varying()
    notes: tuple[str, ...] = ()
    if values is not None and not values.exact:
        notes = (
            f"{np.count_nonzero(values.n_rounded_bits)} of {values.n_sensors} sensors have more "
            f"than {values.max_values} distinct values, which were rounded for bins, ranks and "
            "rest values",
        )
    excerpt = segments.recording(like)
    return StreamedSimilarity(
        similarity=chunked.finish(total),
        varying=varying,
        n_frames=total.n_frames,
        excerpt=excerpt,
        health=tuple(
            _extrapolated(sensor, bool(varies), total.n_frames / excerpt.n_frames)
            for sensor, varies in zip(assess(excerpt), varying, strict=True)
        ),
        notes=notes,
    )


def map_streamed_similarity(
    found: StreamedSimilarity,
    method: str = DEFAULT_METHOD,
    dimensions: Dimensions = AUTO,
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
) -> SensorMap:
    """Reconstruct positions from the similarity of a recording that was read in chunks."""
    dropped = sensor_mask(found.excerpt.names, drop)
    noise = None
    if find_method(method).refinements:
        # The variance is inversely proportional to the number of frames; the autocorrelation can
        # be estimated from the excerpt.
        share = found.excerpt.n_frames / found.n_frames
        noise = share * sampling_variance(found.excerpt.readings)
    made = reconstruct_from(
        method=method,
        dimensions=dimensions,
        options=options,
        similarity=found.similarity,
        noise=noise,
        names=found.excerpt.names,
        drop=np.flatnonzero(dropped | ~found.varying).tolist(),
        statistic=computed_similarity(find_method(method).similarity),
    )
    return found.complete(made, (*found.notes, *_limitations(found, made)), dropped)


def _limitations(found: StreamedSimilarity, made: SensorMap) -> Iterator[str]:
    """Describe differences from the same method on a recording in memory."""
    recipe = find_method(made.method)
    if computed_similarity(recipe.similarity) != recipe.similarity:
        yield (
            "the recording was read in blocks, so the map rests on Pearson's r alone, without rank "
            "correlation and contacts, and has no verdict"
        )
    largest = np.flatnonzero(made.component == 0)
    if (
        bool(recipe.refinements)
        and largest.size <= _MAX_EXAMINED
        and found.excerpt.n_frames >= SEGMENT_FRAMES
        and _is_uneven(found, largest, made.positions[largest])
    ):
        yield _NOT_EXAMINED


def _is_uneven(
    found: StreamedSimilarity, sensors: NDArray[np.intp], positions: NDArray[np.float64]
) -> bool:
    """Return whether neighbours on a map lie at very unequal distances."""
    if len(positions) < MIN_SENSORS or positions.shape[1] < 2:
        return False
    similarity = found.similarity[np.ix_(sensors, sensors)]
    graph = neighbour_graph(found.excerpt.readings[:, sensors], positions, similarity=similarity)
    return unevenness(positions, graph) > MAX_UNEVENNESS


def _check_unit(chunk: NDArray[Any]) -> None:
    """Check that the squares of readings fit in float64; chunks cannot be rescaled."""
    if chunk.dtype != np.float64:
        return
    magnitude = np.abs(chunk).max(axis=0)
    beyond = np.flatnonzero(squares_overflow(magnitude))
    if beyond.size:
        raise InputError(
            f"readings in chunks must be 0 or between {1 / MAX_SQUARED:g} and {MAX_SQUARED:g} in "
            f"magnitude, but sensor {beyond[0]} reads {magnitude[beyond[0]]:g}; use another unit"
        )


def _extrapolated(sensor: SensorHealth, varies: bool, ratio: float) -> SensorHealth:
    """Extend an assessment of the excerpt to all frames, `ratio` times as many."""
    revised = replace(sensor, contacts=round(sensor.contacts * ratio))
    if varies and sensor.status in (SILENT, "stuck"):
        return replace(revised, status="ok", reason="")
    return revised
