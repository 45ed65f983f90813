"""Recordings that are too large for memory, which are read in blocks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.cli.console import progress
from anisomap.cli.parameters import sensors
from anisomap.cli.pipeline import on_disk
from anisomap.errors import InputError
from anisomap.io.presets import with_grid
from anisomap.large.approximation import SimilarityGraph, build_similarity_graph
from anisomap.large.chunks import chunk_frames, complete_chunks
from anisomap.large.map_reduce import WorkerPool
from anisomap.large.sketch import ApproximateOptions
from anisomap.large.streaming import StreamedSimilarity, stream_similarity
from anisomap.methods import check_even_spacing
from anisomap.options import MethodOptions
from anisomap.recording import MissingPolicy, Recording, default_names

if TYPE_CHECKING:
    from anisomap.cli.commands.recording import LargeOptions


def read_in_blocks(
    paths: Sequence[Path],
    how: io.ReadOptions,
    *,
    missing: MissingPolicy,
    method: str,
    options: MethodOptions,
    large: LargeOptions,
    drop: list[str] | None = None,
    seed: int = 0,
) -> StreamedSimilarity | SimilarityGraph:
    """Read recordings of the same sensors in blocks, with progress, for a map.

    Dropped sensors and the seed affect approximate maps only.
    """
    check_even_spacing(method, options, readings=False)
    with progress("inspecting the files"):
        like = _first_frame_of_all(paths, how)
    with progress("reading all frames") as report_progress:
        files = _Files(tuple(paths), how, like.names, missing, report_progress)
        if how.preset:
            like, kept = _apply_preset(files, like, how.preset)
            like = io.attach_positions(like, how.positions)
            files = replace(files, kept=kept)
        if large.approximate:
            dropped = sensors(drop, like.names)
            approximate = ApproximateOptions(seed=seed)
            return build_similarity_graph(files, like=like, drop=dropped, options=approximate)
        return stream_similarity(
            files,
            method,
            options,
            like=like,
            pool=WorkerPool(large.workers, large.dask),
            checkpoint=large.checkpoint,
            source=_describe(paths, how, missing),
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with io.open_stream(path, frames=1, options=how) as stream:
            readings = next((block.readings for block in stream.blocks), None)
            if readings is None:
                raise InputError(f"{path} contains no frames")
            frame = Recording(
                readings,
                names=stream.names or default_names(stream.n_sensors),
                rate_hz=stream.rate_hz,
                positions=stream.positions,
                normals=stream.normals,
                surface_distances=stream.surface_distances,
                units=stream.units,
                source=stream.source or path.name,
                metadata=stream.metadata,
            )
    return with_grid(frame, how.grid)


@dataclass(frozen=True, eq=False)
class _Files:
    """Recordings of the same sensors; calling it yields their complete readings in chunks.

    Sensors that a preset leaves out are removed as in recordings that fit in memory: before gaps
    are filled if there is one recording, afterwards if there are several.
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


def _apply_preset(
    files: _Files, like: Recording, preset: str
) -> tuple[Recording, NDArray[np.intp]]:
    """Apply a preset, which requires a pass over all frames to find the channels that vary."""
    frames: list[NDArray[Any]] = []
    for chunk in files.raw(0) if len(files.paths) == 1 else files():
        known = np.isfinite(chunk)
        lowest = np.where(known, chunk, np.inf).min(axis=0)
        highest = np.where(known, chunk, -np.inf).max(axis=0)
        first, low, high = frames or (chunk[0], lowest, highest)
        frames = [first, np.minimum(low, lowest), np.maximum(high, highest)]
    probe = replace(like, readings=np.array(frames))
    kept = np.array(list(io.numbering(probe, preset)))
    return io.apply_preset(probe, preset), kept


def _describe(paths: Sequence[Path], how: io.ReadOptions, missing: MissingPolicy) -> str:
    """Describe files and options; checkpoints with another description are refused."""
    files = " + ".join(f"{path.name} ({on_disk(path)} bytes)" for path in paths)
    settings = {
        "select": how.select,
        "preset": how.preset,
        "bin": "" if how.bin_s is None else f"{how.bin_s:g} s",
        "missing": "" if missing == "error" else missing,
    }
    return ", ".join([files, *(f"{name} {value}" for name, value in settings.items() if value)])
