"""Recordings that are too large for memory: read in blocks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Group, Parameter
from cyclopts.validators import Number
from numpy.typing import NDArray

from anisomap import io
from anisomap.cli.console import progress
from anisomap.cli.parameters import sensors
from anisomap.cli.pipeline import Examined
from anisomap.errors import InputError
from anisomap.health import summarise
from anisomap.io.parsing.grids import with_grid
from anisomap.large.approximation import APPROXIMATED, Related, relate
from anisomap.large.chunks import chunk_frames, complete_chunks
from anisomap.large.landmarks.options import ApproximateOptions
from anisomap.large.map_reduce import WorkerPool
from anisomap.large.streaming import Gathered, gather_similarity
from anisomap.methods import DEFAULT_METHOD, MethodOptions, check_even_spacing
from anisomap.recording import MissingPolicy, Recording, default_names

LARGE_BYTES = 1 << 29
"""Size of the readings, as float32, above which a recording is read in blocks: 512 MiB."""

PROBED_BYTES = 1 << 24
"""Size of files below which the size of the recording is not estimated."""

large_group = Group("Large recordings", sort_key=4)


@dataclass(frozen=True)
class LargeOptions:
    """Options for large recordings.

    Parameters
    ----------
    workers
        Number of parallel threads; more than the number of cores gain nothing.
    dask
        Address of a Dask scheduler whose workers do the work, as in tcp://host:8786.
    checkpoint
        File for intermediate results, to resume from if it exists.
    approximate
        Make an approximate map by r-anisomap, for too many sensors to compare all pairs.
    """

    workers: Annotated[int, Parameter(validator=Number(gte=1))] = 1
    dask: str = ""
    checkpoint: Path | None = None
    approximate: Annotated[bool, Parameter(negative=())] = False

    @property
    def asked_for(self) -> bool:
        """Whether any of the options was given."""
        return self.approximate or self._shared

    @property
    def _shared(self) -> bool:
        return self.workers > 1 or bool(self.dask) or self.checkpoint is not None

    def method(self, asked: str | None) -> str:
        """Choose the method, given the one that the user asked for, if any.

        Raises
        ------
        InputError
            If an approximate map does not support the method or another option.
        """
        if not self.approximate:
            return asked or DEFAULT_METHOD
        if asked not in (None, APPROXIMATED):
            raise InputError(
                f"--approximate supports {APPROXIMATED} only, got {asked}; leave out --method or "
                "--approximate"
            )
        if self._shared:
            raise InputError(
                "--approximate does not support --workers, --dask and --checkpoint; leave them out"
            )
        return APPROXIMATED


AS_EVER = LargeOptions()


def too_large(paths: Sequence[Path], how: io.ReadOptions) -> bool:
    """Estimate from their first blocks whether recordings are too large for memory."""
    if sum(map(_on_disk, paths)) < PROBED_BYTES:
        return False
    total = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the same warnings follow when the file is read
        for path in paths:
            with io.open_stream(path, options=how) as stream:
                for block in stream.blocks:
                    total += 4 * block.readings.size / max(block.fraction, 1e-9)
                    break
    return total > LARGE_BYTES


def examine(
    paths: Sequence[Path],
    how: io.ReadOptions,
    *,
    missing: MissingPolicy,
    method: str,
    options: MethodOptions,
    large: LargeOptions,
    drop: list[str] | None = None,
    seed: int = 0,
) -> tuple[Examined, Gathered | Related]:
    """Read recordings of the same sensors in blocks, with progress, for a map.

    Dropped sensors and the seed affect approximate maps only.

    Raises
    ------
    InputError
        If sensors are missing in some, or the preset does not fit.
    """
    with progress("inspecting the files"):
        like = _like(paths, how)
    with progress("reading all frames") as tell:
        files = _Files(tuple(paths), how, like.names, missing, tell)
        if how.preset:
            like, kept = _named(files, like, how.preset)
            files = replace(files, kept=kept)
        found: Gathered | Related
        if large.approximate:
            check_even_spacing(method, options, readings=False)
            found = relate(
                files,
                like=like,
                drop=sensors(drop, like.names),
                options=ApproximateOptions(seed=seed),
            )
        else:
            found = gather_similarity(
                files,
                method,
                options,
                like=like,
                pool=WorkerPool(large.workers, large.dask),
                checkpoint=large.checkpoint,
                source=_described(paths, how, missing),
            )
    summary = replace(
        summarise(found.excerpt, found.health),
        n_frames=found.n_frames,
        duration=None if like.rate_hz is None else found.n_frames / like.rate_hz,
        n_constant=int(np.count_nonzero(~found.varying)),
    )
    return Examined(found.excerpt, found.health, summary), found


def _like(paths: Sequence[Path], how: io.ReadOptions) -> Recording:
    """Return the first frame of the recordings, with their metadata."""
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
                raise InputError(f"{path} holds no frames")
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
    """Recordings of the same sensors as one; a call opens their readings without gaps.

    Sensors that a preset leaves out are removed as in recordings that fit in memory: before gaps
    are filled for one recording, after it for several.
    """

    paths: tuple[Path, ...]
    how: io.ReadOptions
    names: tuple[str, ...]
    missing: MissingPolicy
    tell: Callable[[float], None]
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
                self.tell((number + block.fraction) / len(self.paths))


def _named(files: _Files, like: Recording, preset: str) -> tuple[Recording, NDArray[np.intp]]:
    """Apply a preset, after a pass that finds the channels that vary."""
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


def _described(paths: Sequence[Path], how: io.ReadOptions, missing: MissingPolicy) -> str:
    """Describe files and options, so that checkpoints of others are refused."""
    of = " + ".join(f"{path.name} ({_on_disk(path)} bytes)" for path in paths)
    told = {
        "select": how.select,
        "preset": how.preset,
        "missing": "" if missing == "error" else missing,
    }
    return ", ".join([of, *(f"{option} {value}" for option, value in told.items() if value)])


def _on_disk(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
