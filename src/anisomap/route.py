"""The route from files to a judged map: recordings are read, at once or in blocks, and mapped."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.base.wording import as_text
from anisomap.errors import InputError
from anisomap.files.budget import size_on_disk
from anisomap.health import (
    Finding,
    RecordingSummary,
    SensorHealth,
    assess,
    find_faults,
    repair,
    summarise,
)
from anisomap.io.presets import with_grid
from anisomap.io.stream import assemble
from anisomap.large.chunks import chunk_frames, complete_chunks
from anisomap.method.dimensions import Dimensions
from anisomap.method.named import check_even_spacing
from anisomap.method.options import MethodOptions
from anisomap.method.reconstruction import reconstruct_with_stages
from anisomap.numerics.precision import check_pair_memory
from anisomap.recording import MissingPolicy, Recording, Scalar, as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.verdict.diagnosis import diagnose

# Packages for recordings that are too large for memory are imported only for them.
if TYPE_CHECKING:
    from anisomap.large.approximation import SimilarityGraph
    from anisomap.large.map_reduce import WorkerPool
    from anisomap.large.streaming import StreamedSimilarity

LARGE_BYTES = 1 << 29
"""Size of the readings, as float32, above which a recording is read in blocks: 512 MiB."""

PROBED_BYTES = 1 << 24
"""Total size of files below which the size of the readings is not estimated."""

Source: TypeAlias = "Sequence[Recording] | StreamedSimilarity | SimilarityGraph"
"""Recordings of one skin, or what their frames were reduced to if they were read in blocks."""

Judge: TypeAlias = Callable[..., SensorMap]
"""A function that adds its verdict to a map."""

Progress: TypeAlias = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Shows that a task runs; gives a function of the share that is done."""


def silent(_: str) -> AbstractContextManager[Callable[[float], None]]:
    """Show no progress."""
    return nullcontext(lambda _: None)


@dataclass(frozen=True)
class Examined:
    """What a map is made from, with its sensor health, summary and faults.

    recording: All runs as one, or segments of those that were read in blocks.
    """

    source: Source
    recording: Recording
    health: Sequence[SensorHealth]
    summary: RecordingSummary
    findings: Sequence[Finding] = ()

    @property
    def runs(self) -> Sequence[Recording]:
        """The recordings, if they are in memory."""
        return self.source if isinstance(self.source, Sequence) else ()


def read(
    path: Path, how: io.ReadOptions | None = None, *, progress: Progress = silent
) -> Recording:
    """Read a recording; the default of its source is the file name."""
    with progress(f"reading {path.name}") as report_progress:
        recording = io.read(path, options=how, progress=report_progress)
    return replace(recording, source=recording.source or as_text(path.name))


def read_runs(
    paths: Sequence[Path],
    how: io.ReadOptions,
    missing: MissingPolicy = "error",
    *,
    progress: Progress = silent,
) -> list[Recording]:
    """Read one recording, or several of one skin, without missing readings.

    A preset leaves out channels that are constant in all runs, so it is applied to the joined runs.
    """
    joined = len(paths) > 1 and bool(how.preset)
    each = replace(how, preset="", positions=None) if joined else how
    runs = [_complete(read(path, each, progress=progress), missing) for path in paths]
    if not joined:
        return runs
    return [io.attach_positions(io.apply_preset(join_runs(runs), how.preset), how.positions)]


def read_mended(
    paths: Sequence[Path],
    how: io.ReadOptions,
    missing: MissingPolicy | None = None,
    *,
    progress: Progress = silent,
) -> tuple[list[Recording], tuple[Finding, ...]]:
    """Read recordings of one skin, and mend their faults; None leaves readings missing."""
    runs = [read(path, how, progress=progress) for path in paths]
    with progress("repairing the recording"):
        mended = [repair(run) for run in as_runs(runs)]
    findings = tuple(finding for one in mended for finding in one.findings)
    found = [one.recording for one in mended]
    return found if missing is None else [_complete(one, missing) for one in found], findings


def _complete(recording: Recording, missing: MissingPolicy) -> Recording:
    """Handle missing readings; an error names the option that does."""
    try:
        return recording.complete(missing)
    except InputError as error:
        if missing != "error":
            raise
        hint = "use --missing drop-frames or --missing interpolate"
        raise InputError(f"{str(error).partition(';')[0]}; {hint}") from error


def are_large(paths: Sequence[Path], how: io.ReadOptions) -> bool:
    """Estimate from their first blocks whether recordings are too large for memory."""
    if sum(map(size_on_disk, paths)) < PROBED_BYTES:
        return False
    total = 0.0
    with warnings.catch_warnings(action="ignore"):  # the same warnings follow when the file is read
        for path in paths:
            with io.open_stream(path, options=how) as stream:
                for block in stream.blocks:
                    total += 4 * block.readings.size / max(block.fraction, 1e-9)
                    break
    return total > LARGE_BYTES


def read_in_blocks(
    paths: Sequence[Path],
    how: io.ReadOptions,
    missing: MissingPolicy = "error",
    *,
    method: str = DEFAULT_METHOD,
    options: MethodOptions | None = None,
    approximate: bool = False,
    pool: WorkerPool | None = None,
    checkpoint: Path | None = None,
    drop: Sequence[str] = (),
    seed: int = 0,
    progress: Progress = silent,
) -> StreamedSimilarity | SimilarityGraph:
    """Read recordings of the same sensors in blocks, and reduce them to what a map is made from.

    Dropped sensors and the seed affect approximate maps only.
    """
    from anisomap.large import ApproximateOptions  # noqa: PLC0415
    from anisomap.large.approximation import build_similarity_graph  # noqa: PLC0415
    from anisomap.large.map_reduce import WorkerPool  # noqa: PLC0415
    from anisomap.large.streaming import stream_similarity  # noqa: PLC0415

    chosen = options or MethodOptions()
    check_even_spacing(method, chosen, readings=False)
    with progress("inspecting the files"):
        like = _first_frame_of_all(paths, how)
    with progress("reading all frames") as report_progress:
        files = _Files(tuple(paths), how, like.names, missing, report_progress)
        if how.preset:
            probe = replace(like, readings=files.extremes())
            files = replace(files, kept=np.array(list(io.numbering(probe, how.preset))))
            like = io.attach_positions(io.apply_preset(probe, how.preset), how.positions)
        if approximate:
            sketch = ApproximateOptions(seed=seed)
            dropped = split_names(drop, like.names)
            return build_similarity_graph(files, like=like, drop=dropped, options=sketch)
        return stream_similarity(
            files,
            method,
            chosen,
            like=like,
            pool=pool or WorkerPool(),
            checkpoint=checkpoint,
            source=files.describe(),
        )


def _first_frame_of_all(paths: Sequence[Path], how: io.ReadOptions) -> Recording:
    """Return the first frame of the first recording, with the metadata of all recordings."""
    known = [_first_frame(path, how) for path in paths]
    first = known[0]
    for path, other in zip(paths, known, strict=True):
        if set(other.names) != set(first.names):
            raise InputError(
                f"{path} and {paths[0]} have different sensors; recordings of this size can be "
                "joined only if all have the same sensors"
            )
    return replace(first, source=" + ".join(recording.source for recording in known))


def _first_frame(path: Path, how: io.ReadOptions) -> Recording:
    quiet = warnings.catch_warnings(action="ignore")
    with quiet, io.open_stream(path, frames=1, options=how) as stream:
        frame = assemble(replace(stream, blocks=islice(stream.blocks, 1)))
    return with_grid(replace(frame, times=None, source=frame.source or path.name), how.grid)


@dataclass(frozen=True, eq=False)
class _Files:
    """Recordings of the same sensors; calling it yields their complete readings in chunks.

    kept: Sensors that a preset keeps; the others are removed as in recordings that fit in memory:
        before gaps are filled if there is one recording, afterwards if there are several.
    """

    paths: tuple[Path, ...]
    how: io.ReadOptions
    names: tuple[str, ...]
    missing: MissingPolicy
    report_progress: Callable[[float], None]
    kept: NDArray[np.intp] | None = None

    def __call__(self) -> Iterator[NDArray[Any]]:
        if len(self.paths) == 1:
            return complete_chunks(partial(self.raw, 0, self.kept), self.missing)()
        every = (
            complete_chunks(partial(self.raw, i), self.missing)() for i in range(len(self.paths))
        )
        chunks = chain.from_iterable(every)
        return chunks if self.kept is None else (chunk[:, self.kept] for chunk in chunks)

    def raw(self, number: int, kept: NDArray[np.intp] | None = None) -> Iterator[NDArray[Any]]:
        """Yield the readings of a file, sensors in the order of `names`."""
        path, n_frames = self.paths[number], chunk_frames(len(self.names))
        with io.open_stream(path, frames=n_frames, options=self.how) as stream:
            own = {name: i for i, name in enumerate(stream.names or self.names)}
            order = np.array([own[name] for name in self.names])
            order = order if kept is None else order[kept]
            in_order = np.array_equal(order, np.arange(stream.n_sensors))
            for block in stream.blocks:
                yield block.readings if in_order else block.readings[:, order]
                self.report_progress((number + block.fraction) / len(self.paths))

    def extremes(self) -> NDArray[Any]:
        """Return the first, the lowest and the highest reading of each sensor, NaN if missing."""
        found = np.empty((0, len(self.names)))
        for chunk in self.raw(0) if len(self.paths) == 1 else self():
            rows = np.concatenate([found, np.where(np.isfinite(chunk), chunk, np.nan)])
            found = np.stack([rows[0], np.fmin.reduce(rows), np.fmax.reduce(rows)])
        return found

    def describe(self) -> str:
        """Describe files and options; checkpoints with another description are refused."""
        how = self.how
        files = " + ".join(f"{path.name} ({size_on_disk(path)} bytes)" for path in self.paths)
        settings = {
            "select": how.select,
            "preset": how.preset,
            "bin": "" if how.bin_s is None else f"{how.bin_s:g} s",
            "missing": "" if self.missing == "error" else self.missing,
        }
        return ", ".join([files, *(f"{name} {value}" for name, value in settings.items() if value)])


def split_names(
    chosen: Sequence[str] | None, names: Sequence[str], metadata: Mapping[str, Scalar] | None = None
) -> list[str]:
    """Split a list of sensors at commas, unless a sensor name contains the comma.

    Columns of text that the reader has skipped, according to the metadata, are left out.
    """
    skipped = str((metadata or {}).get("text_columns", ""))
    found = []
    for text in chosen or []:
        found += [text] if text in names else [part.strip() for part in text.split(",")]
    return [name for name in found if name in names or f"({name})" not in skipped]


def examine(
    source: Source, findings: Sequence[Finding] | None = None, *, progress: Progress = silent
) -> Examined:
    """Assess recordings of one skin; by default, their faults are searched for."""
    if not isinstance(source, Sequence):
        rate_hz = source.excerpt.rate_hz
        summary = replace(
            summarise(source.excerpt, source.health),
            n_frames=source.n_frames,
            duration=None if rate_hz is None else source.n_frames / rate_hz,
            n_constant=int(np.count_nonzero(~source.varying)),
        )
        return Examined(source, source.excerpt, source.health, summary)
    # Comparing all pairs of so many sensors that no map fits into memory takes hours.
    check_pair_memory(max(run.n_sensors for run in source), refined=False)
    with progress("assessing sensors"):
        joined, health = join_runs(source), assess(source)
        found = find_faults(source) if findings is None else findings
        return Examined(source, joined, health, summarise(joined, health), found)


def make_map(
    examined: Examined,
    method: str,
    dimensions: Dimensions,
    *,
    options: MethodOptions | None = None,
    drop: Sequence[str] = (),
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[SensorMap, Judge | None]:
    """Make a map, and what judges it if it can be judged; notes are warnings."""
    source = examined.source
    with progress("making the map"):
        if isinstance(source, Sequence):
            made, stages = reconstruct_with_stages(
                source, method, dimensions, options=options, drop=drop
            )
            diagnosed = partial(
                diagnose,
                recording=source,
                options=options,
                drop=drop,
                health=examined.health,
                findings=examined.findings,
                rng=seed,
                stages=stages,
            )
            return diagnosed(made, with_verdict=False), diagnosed
        from anisomap.large.approximation import (  # noqa: PLC0415
            SimilarityGraph,
            map_similarity_graph,
        )
        from anisomap.large.streaming import map_streamed_similarity  # noqa: PLC0415

        if isinstance(source, SimilarityGraph):
            return map_similarity_graph(source, dimensions, options=options), None
        return map_streamed_similarity(source, method, dimensions, options=options, drop=drop), None
