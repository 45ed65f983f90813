"""Accumulators on disk, so that a long count that was cut off goes on where it was."""

from __future__ import annotations

import time
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import atomic_write, check_target
from anisomap.numerics.similarity.accumulators import CoOccurrences, Moments, StoredCodes
from anisomap.numerics.similarity.value_counts import ValueCounts

Accumulator: TypeAlias = Moments | CoOccurrences | StoredCodes | ValueCounts

SECONDS = 60.0
"""How often a checkpoint is written."""

_KINDS = {kind.__name__: kind for kind in (Moments, CoOccurrences, StoredCodes, ValueCounts)}
# RuntimeError: a flipped bit may mark a member of the archive as encrypted.
_DAMAGE = (OSError, EOFError, KeyError, ValueError, TypeError, RuntimeError, zipfile.BadZipFile)


@dataclass(frozen=True, eq=False)
class _Stage:
    n_chunks: int
    mark: str
    total: Accumulator


class Trail:
    """Marks by which chunks are known again: each is a digest of all up to it.

    Parameters
    ----------
    seed : str
        What else they must have in common to have the same marks.
    """

    def __init__(self, seed: str = "") -> None:
        self._digest = blake2b(seed.encode(), digest_size=16)
        self._marks = [""]

    def along(self, chunks: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Give chunks on and mark them."""
        for chunk in chunks:
            _take_in(self._digest, chunk)
            self._marks.append(self._digest.hexdigest())
            yield chunk

    def mark(self, n_chunks: int) -> str:
        """Give the mark of the first chunks; of all if there are not so many."""
        return self._marks[min(n_chunks, len(self._marks) - 1)]


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
        self._stages: dict[str, _Stage] = self._read() if path.exists() else {}
        self._written = time.monotonic()

    def __call__(self, stage: str) -> tuple[int, Accumulator | None]:
        """Tell how many chunks were done in a stage, and what was made of them."""
        held = self._stages.get(stage)
        return (held.n_chunks, held.total) if held else (0, None)

    def mark(self, stage: str) -> str:
        """Give the mark of the chunks that were done in a stage; see `Trail`."""
        held = self._stages.get(stage)
        return held.mark if held else ""

    def check(self, stage: str, mark: str) -> None:
        """Refuse to go on after chunks that are not those of which this checkpoint is."""
        if stage in self._stages and mark != self._stages[stage].mark:
            raise FileError(
                f"{self._path} is a checkpoint of something else (of other readings): "
                "name another file, or delete it to count anew"
            )

    def keep(self, stage: str, n_chunks: int, mark: str, total: Accumulator) -> None:
        """Take note of what was made of the chunks so far; write it if it is time."""
        self._stages[stage] = _Stage(n_chunks, mark, total)
        if time.monotonic() - self._written >= SECONDS:
            self.write()

    def write(self) -> None:
        """Write what was noted down."""
        arrays: dict[str, Any] = {"of": np.array(self._of)}
        for name, stage in self._stages.items():
            arrays[f"{name}/chunks"] = np.array(stage.n_chunks)
            arrays[f"{name}/mark"] = np.array(stage.mark)
            arrays[f"{name}/kind"] = np.array(type(stage.total).__name__)
            arrays |= {f"{name}/{key}": array for key, array in packed(stage.total).items()}
        arrays["seal"] = np.array(_seal(arrays))
        with atomic_write(self._path) as aside, aside.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        self._written = time.monotonic()

    def _read(self) -> dict[str, _Stage]:
        try:
            with self._path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                held = dict(archive)
            whole = str(held.pop("seal")) == _seal(held)
            of = str(held.pop("of"))
            stages = {name.split("/")[0] for name in held}
            found = {stage: _stage(held, stage) for stage in stages}
        except _DAMAGE as error:
            raise FileError(self._damaged()) from error
        if not whole:
            raise FileError(self._damaged())
        if of != self._of:
            raise FileError(
                f"{self._path} is a checkpoint of something else ({of}): "
                "name another file, or delete it to count anew"
            )
        return found

    def _damaged(self) -> str:
        return f"{self._path} is no checkpoint, or damaged: delete it to count anew"


def _seal(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Tell arrays that were written together from any others."""
    digest = blake2b(digest_size=16)
    for name in sorted(arrays):
        digest.update(name.encode())
        _take_in(digest, arrays[name])
    return digest.hexdigest()


def _take_in(digest: blake2b, array: NDArray[Any]) -> None:
    digest.update(f"{array.dtype.str} {array.shape}".encode())
    digest.update(np.ascontiguousarray(array).data)


def packed(total: Accumulator) -> dict[str, NDArray[Any]]:
    """Give the arrays that an accumulator is made of, by name."""
    fields: dict[str, Any] = {**vars(total)}
    if isinstance(total, ValueCounts):
        fields["sizes"] = [values.size for values in total.values]
        fields["values"] = np.concatenate(total.values)
        fields["counts"] = np.concatenate(total.counts)
    if isinstance(total, StoredCodes):
        fields["parts"] = total.whole()
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
    if kind == StoredCodes.__name__:
        fields["parts"] = (fields["parts"],)
    total: Accumulator = _KINDS[kind](**fields)
    return total


def _stage(held: Mapping[str, NDArray[Any]], stage: str) -> _Stage:
    own = {n.split("/")[1]: array for n, array in held.items() if n.startswith(f"{stage}/")}
    n_chunks, mark = int(own.pop("chunks")), str(own.pop("mark"))
    return _Stage(n_chunks, mark, unpacked(str(own.pop("kind")), own))
