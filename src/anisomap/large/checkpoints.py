"""Checkpoints: accumulators on disk, from which an interrupted map-reduce resumes."""

from __future__ import annotations

import io
import time
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from hashlib import blake2b
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import atomic_write, check_target, open_regular
from anisomap.numerics.similarity.binning import ValueCounts
from anisomap.numerics.similarity.correlation import CoOccurrences, Moments, StoredCodes

Accumulator: TypeAlias = Moments | CoOccurrences | StoredCodes | ValueCounts

WRITE_SHARE = 0.1
"""Maximum share of the running time that is spent on writing checkpoints.

A killed run loses the work on one chunk, or of ten times the duration of a write if that is longer.
"""

_KINDS = {kind.__name__: kind for kind in (Moments, CoOccurrences, StoredCodes, ValueCounts)}


class _Stage(NamedTuple):
    n_chunks: int
    digest: str
    total: Accumulator


class ChunkDigests:
    """Cumulative digests that identify chunks: each covers all chunks up to it.

    seed: Included in every digest.
    """

    def __init__(self, seed: str = "") -> None:
        self._hash = blake2b(seed.encode(), digest_size=16)
        self._digests = [""]

    def follow(self, chunks: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Yield the chunks, and record the digest after each."""
        for chunk in chunks:
            _update(self._hash, chunk)
            self._digests.append(self._hash.hexdigest())
            yield chunk

    def up_to(self, n_chunks: int) -> str:
        """Return the digest of the first `n_chunks`, or of all if there are fewer."""
        return self._digests[min(n_chunks, len(self._digests) - 1)]


class Checkpoint:
    """A file with the accumulator of each stage, and the chunks that it covers.

    It is needed since joblib and Dask rerun lost tasks, but do not store a reduction in progress.

    path: The file, an NPZ archive. It is replaced atomically.
    subject: Description of the computation and its input; a checkpoint with another subject is
        refused.
    """

    def __init__(self, path: Path, subject: str) -> None:
        self._path, self._subject = check_target(path), subject
        self._stages: dict[str, _Stage] = self._read() if path.exists() else {}
        self._next_write = time.monotonic()

    def progress(self, stage: str) -> tuple[int, Accumulator | None]:
        """Return the number of chunks that a stage has processed, and its accumulator."""
        known = self._stages.get(stage)
        return (known.n_chunks, known.total) if known else (0, None)

    def digest(self, stage: str) -> str:
        """Return the digest of the chunks that a stage has processed; see `ChunkDigests`."""
        known = self._stages.get(stage)
        return known.digest if known else ""

    def verify(self, stage: str, digest: str) -> None:
        """Raise `FileError` if the stage has processed chunks with another digest."""
        if stage in self._stages and digest != self._stages[stage].digest:
            raise self._mismatch("other readings")

    def update(self, stage: str, n_chunks: int, digest: str, total: Accumulator) -> None:
        """Set the progress of a stage; write the file if `WRITE_SHARE` permits."""
        self._stages[stage] = _Stage(n_chunks, digest, total)
        if time.monotonic() >= self._next_write:
            self.write()

    def write(self) -> None:
        """Write the progress of all stages."""
        started = time.monotonic()
        arrays: dict[str, Any] = {"subject": np.array(self._subject)}
        for name, stage in self._stages.items():
            arrays[f"{name}/chunks"] = np.array(stage.n_chunks)
            arrays[f"{name}/digest"] = np.array(stage.digest)
            arrays[f"{name}/kind"] = np.array(type(stage.total).__name__)
            arrays |= {f"{name}/{key}": array for key, array in _pack(stage.total).items()}
        arrays["checksum"] = np.array(_checksum(arrays))
        with atomic_write(self._path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        ended = time.monotonic()
        self._next_write = ended + (ended - started) / WRITE_SHARE

    def _read(self) -> dict[str, _Stage]:
        try:
            with warnings.catch_warnings(), open_regular(self._path) as file:
                warnings.simplefilter("ignore")  # of numpy, about headers of other versions
                _check_stored(file)
                with np.load(file, allow_pickle=False) as archive:
                    arrays = {name: archive[name] for name in archive}
            intact = str(arrays.pop("checksum")) == _checksum(arrays)
            subject = str(arrays.pop("subject"))
            stages = {name.split("/")[0] for name in arrays}
            found = {stage: _read_stage(arrays, stage) for stage in stages}
        except FileError:
            raise
        except Exception as error:  # what numpy raises for a damaged archive is undocumented
            raise FileError(self._damaged()) from error
        if not intact:
            raise FileError(self._damaged())
        if subject != self._subject:
            raise self._mismatch(subject)
        return found

    def _damaged(self) -> str:
        return f"{self._path} is damaged or not a checkpoint; delete it to start again"

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
    """Return the fields of an accumulator as arrays."""
    fields: dict[str, Any] = {**vars(total)}
    if isinstance(total, ValueCounts):
        fields["sizes"] = [values.size for values in total.values]
        fields["values"] = np.concatenate(total.values)
        fields["counts"] = np.concatenate(total.counts)
    if isinstance(total, StoredCodes):
        fields["parts"] = total.whole()
    return {name: np.asarray(value) for name, value in fields.items()}


def _unpack(kind: str, arrays: Mapping[str, NDArray[Any]]) -> Accumulator:
    """Make an accumulator of the arrays that `_pack` returned."""
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


def _read_stage(arrays: Mapping[str, NDArray[Any]], stage: str) -> _Stage:
    own = {n.split("/")[1]: array for n, array in arrays.items() if n.startswith(f"{stage}/")}
    n_chunks, digest = int(own.pop("chunks")), str(own.pop("digest"))
    return _Stage(n_chunks, digest, _unpack(str(own.pop("kind")), own))
