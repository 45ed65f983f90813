"""Accumulators on disk, so that a long count that was cut off goes on where it was."""

from __future__ import annotations

import time
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap._files import check_target, replacing
from anisomap.errors import FileError
from anisomap.numerics.accumulators import CoOccurrences, Moments
from anisomap.numerics.values import ValueCounts

Accumulator: TypeAlias = Moments | CoOccurrences | ValueCounts

SECONDS = 60.0
"""How often a checkpoint is written."""

_KINDS = {kind.__name__: kind for kind in (Moments, CoOccurrences, ValueCounts)}
_DAMAGE = (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile)


class Checkpoint:
    """A file that holds what was made of the chunks so far, stage by stage.

    Parameters
    ----------
    path : pathlib.Path
        The file, an NPZ archive; written aside and moved there whole.
    of : str
        What is counted, and of what: a checkpoint of anything else is refused.

    Raises
    ------
    FileError
        If the file is there but damaged or of something else, or could not be written.
    """

    def __init__(self, path: Path, of: str) -> None:
        self._path, self._of = check_target(path), of
        self._stages: dict[str, tuple[int, Accumulator]] = self._read() if path.exists() else {}
        self._written = time.monotonic()

    def __call__(self, stage: str) -> tuple[int, Accumulator | None]:
        """Tell how many chunks were done in a stage, and what was made of them."""
        return self._stages.get(stage, (0, None))

    def keep(self, stage: str, n_chunks: int, total: Accumulator, *, now: bool = False) -> None:
        """Take note of what was made of the chunks so far; write it if it is time."""
        self._stages[stage] = n_chunks, total
        if now or time.monotonic() - self._written >= SECONDS:
            self._write()

    def _write(self) -> None:
        arrays: dict[str, Any] = {"of": np.array(self._of)}
        for stage, (n_chunks, total) in self._stages.items():
            arrays[f"{stage}/chunks"] = np.array(n_chunks)
            arrays[f"{stage}/kind"] = np.array(type(total).__name__)
            arrays |= {f"{stage}/{name}": array for name, array in packed(total).items()}
        with replacing(self._path) as aside, aside.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        self._written = time.monotonic()

    def _read(self) -> dict[str, tuple[int, Accumulator]]:
        try:
            with self._path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                held = dict(archive)
            of = str(held.pop("of"))
            stages = {name.split("/")[0] for name in held}
            found = {stage: _stage(held, stage) for stage in stages}
        except _DAMAGE as error:
            raise FileError(
                f"{self._path} is no checkpoint, or damaged: delete it to count anew"
            ) from error
        if of != self._of:
            raise FileError(
                f"{self._path} is a checkpoint of something else ({of}): "
                "name another file, or delete it to count anew"
            )
        return found


def packed(total: Accumulator) -> dict[str, NDArray[Any]]:
    """Give the arrays that an accumulator is made of, by name."""
    fields: dict[str, Any] = {**vars(total)}
    if isinstance(total, ValueCounts):
        fields["sizes"] = [values.size for values in total.values]
        fields["values"] = np.concatenate(total.values)
        fields["counts"] = np.concatenate(total.counts)
    return {name: np.asarray(value) for name, value in fields.items()}


def unpacked(kind: str, arrays: Mapping[str, NDArray[Any]]) -> Accumulator:
    """Make an accumulator of its arrays; see `packed`."""
    fields: dict[str, Any] = {
        name: array if array.ndim else int(array) for name, array in arrays.items()
    }
    if kind == ValueCounts.__name__:
        cuts = np.cumsum(fields.pop("sizes"))[:-1]
        for name in ("values", "counts"):
            fields[name] = tuple(np.split(fields[name], cuts))
    total: Accumulator = _KINDS[kind](**fields)
    return total


def _stage(held: Mapping[str, NDArray[Any]], stage: str) -> tuple[int, Accumulator]:
    own = {n.split("/")[1]: array for n, array in held.items() if n.startswith(f"{stage}/")}
    return int(own.pop("chunks")), unpacked(str(own.pop("kind")), own)
