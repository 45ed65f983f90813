"""Maps of recordings that do not fit in memory: frames are read in chunks.

Statistics that depend on the distribution of all readings take two passes over the frames: one to
count distinct values, one to compute the statistic.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.errors import InputError
from anisomap.health import SensorHealth, assess
from anisomap.large.chunks import (
    SEGMENT_FRAMES,
    Chunks,
    Excerpt,
    ReadInChunks,
    complete_chunks,
    split_array,
)
from anisomap.large.map_reduce import SERIAL, Checkpoint, Mapper, WorkerPool, map_reduce
from anisomap.method.dimensions import AUTO, Dimensions
from anisomap.method.named import check_even_spacing, find_method
from anisomap.method.options import MethodOptions
from anisomap.method.reconstruction import reconstruct_from
from anisomap.method.refinements import MIN_SENSORS
from anisomap.numerics.columns import ranks_from_counts
from anisomap.numerics.geodesic.adjacency import MAX_UNEVENNESS, adjacency_graph, unevenness
from anisomap.numerics.precision import (
    MAX_SQUARED,
    Floats,
    Reals,
    check_memory,
    check_pair_memory,
    check_worker_memory,
)
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.similarity.binning import Recoding, ValueCounts, maximum_entropy_bins
from anisomap.numerics.similarity.co_occurrence import Layout, joint_logarithms_of_counts
from anisomap.numerics.similarity.correlation import (
    CoOccurrences,
    Moments,
    StoredCodes,
    phi_from_counts,
    squares_overflow,
)
from anisomap.numerics.similarity.information import (
    information_from_codes,
    information_from_logarithms,
)
from anisomap.numerics.similarity.rest import rest_from_counts
from anisomap.recording import MissingPolicy, Recording, sensor_mask
from anisomap.sensor_map import SILENT, SensorMap

logger = logging.getLogger(__name__)

_BYTES_PER_COUNT = 3 * 4  # uint32: the total, the next result, and their sum
_MAX_COUNT_BYTES = 1 << 28  # of counts; above, codes are stored if smaller. Chosen by hand


def _recoded(values: ValueCounts, outcomes: Sequence[NDArray[Any]], make: Mapper) -> Mapper:
    """Make accumulators of what the readings count as, given the outcome of each distinct value."""
    recode = Recoding.of(values.values, outcomes, outcomes[0].dtype.type)
    return partial(_of_recoded, recode, make)


def _of_recoded(recode: Recoding, make: Mapper, chunk: NDArray[Any]) -> Any:
    return make(recode(chunk))


def _ranks(values: ValueCounts, _: int) -> Mapper:
    """Return moments of mean ranks, from 1 to T."""
    return _recoded(values, [ranks_from_counts(counts) for counts in values.counts], Moments.of)


def _activity(values: ValueCounts, _: int) -> Mapper:
    """Count frames in which both sensors of a pair exceed rest."""
    rest = rest_from_counts(zip(values.values, values.counts, strict=True))
    active = [
        rest.side[i] * (levels - rest.value[i]) - rest.threshold[i] > 0
        for i, levels in enumerate(values.values)
    ]
    layout = Layout.of_switches(values.n_sensors)
    return _recoded(values, active, partial(CoOccurrences.of, layout=layout))


def _bins(values: ValueCounts, bins: int) -> Mapper:
    """Count pairs of maximum-entropy bins, or store the bins if that takes less memory."""
    codes = [maximum_entropy_bins(counts, bins).astype(np.uint16) for counts in values.counts]
    full = [
        np.bincount(code, weights=counts, minlength=bins)
        for code, counts in zip(codes, values.counts, strict=True)
    ]
    layout = Layout.of(np.array(full).astype(np.int64))
    stored = values.n_frames * values.n_sensors
    counted = _BYTES_PER_COUNT * layout.n_series**2
    check_memory(
        min(stored, counted),
        f"counting all pairs of {bins} bins of {values.n_sensors} sensors",
        "use fewer bins, or a method based on Pearson's r",
    )
    if stored <= counted and counted > _MAX_COUNT_BYTES:
        return _recoded(values, codes, StoredCodes.of)
    return _recoded(values, codes, partial(CoOccurrences.of, layout=layout))


def _information(found: CoOccurrences | StoredCodes) -> Reals:
    if isinstance(found, StoredCodes):
        return information_from_codes(found.whole())
    joint = joint_logarithms_of_counts(found.counts, found.first, found.n_frames)
    return information_from_logarithms(joint, found.n_frames)


@dataclass(frozen=True)
class Chunked:
    """A similarity as a map-reduce.

    finish: Converts the accumulator of all chunks to the (N, N) similarity.
    prepare: ``prepare(values, bins)`` returns the mapper, given the distinct values of all frames
        with their counts; None for the moments of the readings as they are.
    """

    finish: Callable[[Any], Reals]
    prepare: Callable[[ValueCounts, int], Mapper] | None = None


CHUNKED: Mapping[str, Chunked] = MappingProxyType(
    {
        "pearson": Chunked(Moments.correlation),
        "spearman": Chunked(Moments.correlation, _ranks),
        "co-activation": Chunked(lambda it: phi_from_counts(it.counts, it.n_frames), _activity),
        "mutual-information": Chunked(_information, _bins),
        # Blending weights r by its reliability, which is nearly 1 in long recordings.
        "blended-correlation": Chunked(Moments.correlation),
    }
)
"""Chunked computation of each similarity, by its name."""


def computed_similarity(name: str) -> str:
    """Return the name of the similarity that is computed from chunks in place of the named one."""
    return "pearson" if name == "blended-correlation" else name


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
    subject = f"{name} of {source or 'frames'}, {options.entropy_bins} bins"
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
    mapper: Mapper = Moments.of
    if chunked.prepare is not None:
        logger.info("counting distinct values")
        values = map_reduce(
            checked_chunks, ValueCounts.of, pool=pool, checkpoint=saved, stage="values"
        )
        mapper = chunked.prepare(values, options.entropy_bins)
    logger.info("comparing all pairs of sensors (%s)", name)
    total = map_reduce(checked_chunks, mapper, pool=pool, checkpoint=saved, stage="pairs")
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


def _is_uneven(found: StreamedSimilarity, sensors: NDArray[np.intp], positions: Floats) -> bool:
    """Return whether neighbours on a map lie at very unequal distances."""
    if len(positions) < MIN_SENSORS or positions.shape[1] < 2:
        return False
    similarity = found.similarity[np.ix_(sensors, sensors)]
    graph = adjacency_graph(found.excerpt.readings[:, sensors], positions, similarity=similarity)
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
