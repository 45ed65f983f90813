"""Maps of more frames than memory holds: from a file that is mapped, from many files, in chunks."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import SensorHealth, assess, weaknesses
from anisomap.large.checkpoints import Checkpoint
from anisomap.large.chunked_similarity import CHUNKED
from anisomap.large.chunks import SEGMENT_FRAMES, Chunks, Excerpt, complete_chunks, split_array
from anisomap.large.map_reduce import SERIAL, WorkerPool, map_reduce
from anisomap.memory import check_pair_memory, check_worker_memory
from anisomap.methods import DEFAULT_METHOD, MethodOptions, check_priors, find_method
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.similarity.correlation import MAX_SQUARED, squares_overflow
from anisomap.numerics.similarity.value_counts import ValueCounts
from anisomap.reconstruction import reconstruct
from anisomap.recording import MissingPolicy, Recording
from anisomap.refinement import notes_on_squeezing
from anisomap.sensor_map import SensorMap

logger = logging.getLogger(__name__)

_MOST_TO_LOOK_AT = 2000  # sensors, for neighbours among them


@dataclass(frozen=True, eq=False)
class Gathered:
    """What a map is made from, once all frames were gone through.

    Attributes
    ----------
    similarity : ndarray of shape (N, N)
    varying : ndarray of bool, shape (N,)
        Which sensors ever varied.
    n_frames : int
        How many frames there were.
    excerpt : Recording
        Pieces from all over them; all frames, if they are few.
    health : tuple of SensorHealth
        Judged from the excerpt; contacts are projected from it to all frames.
    notes : tuple of str
        What was not done as with one array.
    """

    similarity: Reals
    varying: NDArray[np.bool_]
    n_frames: int
    excerpt: Recording
    health: tuple[SensorHealth, ...]
    notes: tuple[str, ...] = ()


def reconstruct_chunks(
    readings: NDArray[Any] | Chunks,
    method: str = DEFAULT_METHOD,
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    names: Sequence[str] = (),
    missing: MissingPolicy = "error",
    exclude: Iterable[str | int] = (),
    drop: Iterable[str | int] = (),
    pool: WorkerPool = SERIAL,
    checkpoint: Path | None = None,
) -> SensorMap:
    """Make a map of a recording that is never in memory as a whole.

    Parameters
    ----------
    readings : ndarray of shape (T, N), or callable
        A memory-mapped array (``np.load(path, mmap_mode="r")``), or a function that opens the
        recording anew each time and gives its chunks, arrays of shape (t, N).
    method, dimensions, options, exclude, drop
        As for `anisomap.reconstruct`.
    names : sequence of str, optional
        Names of the sensors.
    missing : {"error", "drop-frames", "interpolate"}
        What to do about NaN: see `complete_chunks`.
    pool : WorkerPool
        Who does the work.
    checkpoint : pathlib.Path, optional
        File to note down what was counted, and to go on from if it is there; one of other readings
        or another method is refused.

    Returns
    -------
    SensorMap
        The map that `anisomap.reconstruct` makes of all frames as one array (from 512 sensors on,
        with a Pearson r that is more exact; the covariogram method takes r alone). Where a sensor
        read very many different values, these are rounded for bins, ranks and rests, and a note
        says so.

    Raises
    ------
    InputError
        As `anisomap.reconstruct`, and if chunks are not all of the same sensors.

    Warns
    -----
    AnisomapWarning
        Once for each of the notes.
    """
    chunks = readings if callable(readings) else split_array(np.asanyarray(readings))
    chosen = options or MethodOptions()
    found = gather_similarity(
        chunks,
        method,
        chosen,
        like=names,
        missing=missing,
        pool=pool,
        checkpoint=checkpoint,
    )
    return map_of(found, method, dimensions, options=chosen, exclude=exclude, drop=drop)


def gather_similarity(
    chunks: Chunks,
    method: str,
    options: MethodOptions,
    *,
    like: Recording | Sequence[str] = (),
    missing: MissingPolicy = "error",
    pool: WorkerPool = SERIAL,
    checkpoint: Path | None = None,
    source: str = "",
) -> Gathered:
    """Go through all frames, twice if need be, for a method's similarity.

    Parameters
    ----------
    chunks, method, options, missing, pool, checkpoint
        As for `reconstruct_chunks`.
    like : Recording or sequence of str
        One with the sensors' names, positions and whatever else is known, or just the names.
    source : str
        What the frames are of, so that no checkpoint is taken for that of others.

    Returns
    -------
    Gathered
    """
    check_priors(method, options, readings=False)
    made_by = find_method(method)
    name, refined = made_by.similarity, made_by.refine is not None
    recipe, pieces, whole = CHUNKED[name], Excerpt(), complete_chunks(chunks, missing)
    of = f"{name} of {source or 'frames'}, {options.bins} bins"
    held = Checkpoint(checkpoint, of) if checkpoint else None

    def watched() -> Iterator[NDArray[Any]]:
        """Take the excerpt in passing; the second time, there is one."""
        watching = not pieces.complete
        if watching:
            pieces.reset()
        for chunk in whole():
            check_pair_memory(chunk.shape[1], refined=refined)
            check_worker_memory(chunk.shape[1], pool.n_workers)
            _check_unit(chunk)
            if watching:
                pieces.add(chunk)
            yield chunk
        pieces.complete = True

    values: ValueCounts | None = None
    if recipe.needs_values:
        logger.info("finding the values that occur")
        values = map_reduce(watched, ValueCounts.of, pool=pool, checkpoint=held, stage="values")
    logger.info("comparing all pairs of sensors (%s)", name)
    take = recipe.prepare(values, options.bins)
    before = "" if values is None else "values"
    total = map_reduce(watched, take, pool=pool, checkpoint=held, stage="pairs", after=before)
    varying = total.varying() if values is None else values.varying()
    excerpt = pieces.recording(like)
    notes = [] if values is None else list(_rounding(values, excerpt.names))
    if excerpt.n_frames < total.n_frames:
        notes.append(f"sensor health was judged from {excerpt.n_frames} of {total.n_frames} frames")
    return Gathered(
        similarity=recipe.finish(total),
        varying=varying,
        n_frames=total.n_frames,
        excerpt=excerpt,
        health=tuple(
            _revised(sensor, bool(varies), total.n_frames / excerpt.n_frames)
            for sensor, varies in zip(assess(excerpt), varying, strict=True)
        ),
        notes=tuple(notes),
    )


def map_of(
    found: Gathered,
    method: str = DEFAULT_METHOD,
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    exclude: Iterable[str | int] = (),
    drop: Iterable[str | int] = (),
) -> SensorMap:
    """Make a map of what was gathered.

    Parameters
    ----------
    found : Gathered
    method, dimensions, options, exclude, drop
        As for `anisomap.reconstruct`; the method must have the similarity that was gathered.

    Returns
    -------
    SensorMap
    """
    dropped = set(found.excerpt.indices(drop).tolist())
    noise = None
    if find_method(method).refine is not None:
        # The more frames, the less noise; how soon readings change, pieces tell as well.
        share = found.excerpt.n_frames / found.n_frames
        noise = share * sampling_variance(found.excerpt.readings)
    made = reconstruct(
        method=method,
        dimensions=dimensions,
        options=options,
        similarity=found.similarity,
        noise=noise,
        names=found.excerpt.names,
        exclude=exclude,
        drop=sorted(dropped | set(np.flatnonzero(~found.varying).tolist())),
        health=found.health,
    )
    kept = [sensor for i, sensor in enumerate(found.health) if i not in dropped]
    notes = (*weaknesses(found.excerpt, kept), *found.notes, *_on_squeezing(found, made))
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    provenance = {"source": found.excerpt.source, "frames": found.n_frames, **made.provenance}
    del provenance["precomputed"]
    if provenance["similarity"] == "blended-correlation":
        provenance["similarity"] = "pearson"  # see `anisomap.large.chunked_similarity`
    return replace(made, notes=(*notes, *made.notes), provenance=provenance)


def _on_squeezing(found: Gathered, made: SensorMap) -> tuple[str, ...]:
    largest = np.flatnonzero(made.component == 0)
    refined = find_method(made.method).refine is not None
    if not refined or largest.size > _MOST_TO_LOOK_AT or found.excerpt.n_frames < SEGMENT_FRAMES:
        return ()
    return notes_on_squeezing(
        found.excerpt.readings[:, largest],
        made.positions[largest],
        found.similarity[np.ix_(largest, largest)],
    )


def _check_unit(chunk: NDArray[Any]) -> None:
    """Refuse readings whose squares float64 does not hold: a unit is chosen for all frames."""
    if chunk.dtype != np.float64:
        return
    reach = np.abs(chunk).max(axis=0)
    beyond = np.flatnonzero(squares_overflow(reach))
    if beyond.size:
        raise InputError(
            f"sensor {beyond[0]} reads up to {reach[beyond[0]]:g}; readings that come in chunks "
            f"must be 0 or between {1 / MAX_SQUARED:g} and {MAX_SQUARED:g}: "
            "use another unit"
        )


def _rounding(values: ValueCounts, names: Sequence[str]) -> Iterator[str]:
    rounded = np.flatnonzero(values.grains)
    if rounded.size:
        yield (
            f"{rounded.size} of {len(names)} sensors read more than {values.most} different "
            "values, which were rounded to so many to find their bins, ranks or rests"
        )


def _revised(sensor: SensorHealth, varies: bool, whole: float) -> SensorHealth:
    """Make of a judgement of the excerpt one of all frames, which are so many times as many."""
    judged = replace(sensor, contacts=round(sensor.contacts * whole))
    if varies and sensor.status in ("dead", "stuck"):
        return replace(judged, status="ok", reason="")
    return judged
