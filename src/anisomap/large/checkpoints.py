"""Checkpoints: accumulators on disk, from which an interrupted map-reduce resumes."""

from __future__ import annotations

import io
import time
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from hashlib import blake2b
from io import BufferedReader
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files.paths import atomic_write, check_target, open_regular
from anisomap.numerics.similarity.binning import ValueCounts
from anisomap.numerics.similarity.correlation import CoOccurrences, Moments, StoredCodes

Accumulator: TypeAlias = Moments | CoOccurrences | StoredCodes | ValueCounts

WRITE_SHARE = 0.1
"""Maximum share of the running time that is spent on writing checkpoints.

A killed run loses the work on one chunk, or of ten times the duration of a write if that is longer.
"""

_KINDS = {kind.__name__: kind for kind in (Moments, CoOccurrences, StoredCodes, ValueCounts)}


class Stage(NamedTuple):
    """Progress of a reduction: chunks that are done, a digest of them, and their accumulator."""

    n_chunks: int = 0
    digest: str = ""
    total: Any = None


class Checkpoint:
    """A file with the accumulator of each stage, and the chunks that it covers.

    It is needed since joblib and Dask rerun lost tasks, but do not store a reduction in progress.

    path: The file, an NPZ archive. It is replaced atomically.
    subject: Description of the computation and its input; a checkpoint with another subject is
        refused.
    """

    def __init__(self, path: Path, subject: str) -> None:
        self._path, self._subject = check_target(path), subject
        self.stages: dict[str, Stage] = self._read() if path.exists() else {}
        self._digests = [""]
        self._next_write = time.monotonic()

    def remaining(self, chunks: Iterable[NDArray[Any]], stage: str) -> Iterator[NDArray[Any]]:
        """Skip the chunks that a stage has processed, and return the others.

        Digests cover all chunks up to each, and those of earlier stages. Raises `FileError` if
        other chunks were processed.
        """
        digest = blake2b(digest_size=16)
        for before in takewhile(lambda name: name != stage, self.stages):
            digest.update(self.stages[before].digest.encode())
        self._digests = [""]

        def follow() -> Iterator[NDArray[Any]]:
            for chunk in chunks:
                _update(digest, chunk)
                self._digests.append(digest.hexdigest())
                yield chunk

        known, rest = self.stages.get(stage, Stage()), follow()
        for _ in islice(rest, known.n_chunks):
            pass
        if self._digests[-1] != known.digest:
            raise self._mismatch("other readings")
        return rest

    def update(self, stage: str, n_chunks: int, total: Accumulator) -> None:
        """Set the progress of a stage; write the file if `WRITE_SHARE` permits."""
        self.stages[stage] = Stage(n_chunks, self._digests[n_chunks], total)
        if time.monotonic() >= self._next_write:
            self.write()

    def write(self) -> None:
        """Write the progress of all stages."""
        started = time.monotonic()
        arrays: dict[str, Any] = {"subject": np.array(self._subject)}
        for name, stage in self.stages.items():
            arrays[f"{name}/chunks"] = np.array(stage.n_chunks)
            arrays[f"{name}/digest"] = np.array(stage.digest)
            arrays[f"{name}/kind"] = np.array(type(stage.total).__name__)
            arrays |= {f"{name}/{key}": array for key, array in _pack(stage.total).items()}
        arrays["checksum"] = np.array(_checksum(arrays))
        with atomic_write(self._path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        ended = time.monotonic()
        self._next_write = ended + (ended - started) / WRITE_SHARE

    def _read(self) -> dict[str, Stage]:
        damaged = f"{self._path} is damaged or not a checkpoint; delete it to start again"
        try:
            with warnings.catch_warnings(), open_regular(self._path) as file:
                warnings.simplefilter("ignore")  # of numpy, about headers of other versions
                _check_stored(file)
                with np.load(file, allow_pickle=False) as archive:
                    arrays = {name: archive[name] for name in archive}
            intact = str(arrays.pop("checksum")) == _checksum(arrays)
            subject = str(arrays.pop("subject"))
            stages = dict.fromkeys(name.split("/")[0] for name in arrays)  # in their order
            found = {stage: _read_stage(arrays, stage) for stage in stages}
        except FileError:
            raise
        except Exception as error:  # what numpy raises for a damaged archive is undocumented
            raise FileError(damaged) from error
        if not intact:
            raise FileError(damaged)
        if subject != self._subject:
            raise self._mismatch(subject)
        return found

    def _mismatch(self, subject: str) -> FileError:
        return FileError(
            f"{self._path} is the checkpoint of another computation ({subject}); name another "
            "file, or delete it to start again"
        )


def _check_stored(file: BufferedReader) -> None:
    """Check that all arrays are uncompressed, as `write` leaves them, so that they fit the file."""
    size = file.seek(0, io.SEEK_END)
    with zipfile.ZipFile(file) as archive:
        held = archive.infolist()
    if any(info.compress_type != zipfile.ZIP_STORED or info.file_size > size for info in held):
        raise zipfile.BadZipFile("an array is compressed")
    file.seek(0)


def _checksum(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Digest all arrays: numpy does not verify the CRC of an archive with a damaged header."""
    digest = blake2b(digest_size=16)
    for name in sorted(arrays):
        digest.update(name.encode())
        _update(digest, arrays[name])
    return digest.hexdigest()


def _update(digest: blake2b, array: NDArray[Any]) -> None:
    digest.update(f"{array.dtype.str} {array.shape}".encode())
    digest.update(np.ascontiguousarray(array).data)


def _pack(total: Accumulator) -> dict[str, NDArray[Any]]:
    """Return the fields of an accumulator as arrays; tuples of arrays are concatenated."""
    fields: dict[str, NDArray[Any]] = {}
    for name, value in vars(total).items():
        if isinstance(value, tuple):
            fields[f"{name} sizes"] = np.array([len(part) for part in value])
        fields[name] = np.concatenate(value) if isinstance(value, tuple) else np.asarray(value)
    return fields


def _read_stage(arrays: Mapping[str, NDArray[Any]], stage: str) -> Stage:
    own = {n.split("/")[1]: array for n, array in arrays.items() if n.startswith(f"{stage}/")}
    n_chunks, digest, kind = (own.pop(name) for name in ("chunks", "digest", "kind"))
    fields: dict[str, Any] = {}
    for name, array in own.items():
        if f"{name} sizes" in own:
            fields[name] = tuple(np.split(array, np.cumsum(own[f"{name} sizes"])[:-1]))
        elif not name.endswith(" sizes"):
            fields[name] = array if array.ndim else int(array)
    return Stage(int(n_chunks), str(digest), _KINDS[str(kind)](**fields))
