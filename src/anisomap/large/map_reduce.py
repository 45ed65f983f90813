"""Map-reduce over chunks of frames, with checkpoints: in one process, with joblib, or with Dask."""

from __future__ import annotations

import io
import logging
import os
import socket
import time
import warnings
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from hashlib import blake2b
from importlib import import_module
from io import BufferedReader
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from anisomap.errors import FileError, InputError, import_extra
from anisomap.files.paths import atomic_write, check_target, open_regular
from anisomap.numerics.similarity.binning import ValueCounts
from anisomap.numerics.similarity.correlation import CoOccurrences, Moments, StoredCodes

Accumulator: TypeAlias = Moments | CoOccurrences | StoredCodes | ValueCounts

# Of the running time, at most, that is spent on writing checkpoints. A killed run loses the work on
# one chunk, or of ten times the duration of a write if that is longer.
_WRITE_SHARE = 0.1

_KINDS = {kind.__name__: kind for kind in (Moments, CoOccurrences, StoredCodes, ValueCounts)}


class Stage(NamedTuple):
    """Progress of a reduction: chunks that are done, a digest of them, and their accumulator."""

    n_chunks: int = 0
    digest: str = ""
    total: Any = None


class Checkpoint:
    """A file with the accumulator of each stage, and the chunks that it covers.

    joblib and Dask rerun lost tasks, but do not store a reduction in progress.

    subject: The computation and its input; a checkpoint with another subject is refused.
    """

    def __init__(self, path: Path, subject: str) -> None:
        self._path, self._subject = check_target(path), subject
        self.stages: dict[str, Stage] = self._read() if path.exists() else {}
        self._digests = [""]
        self._next_write = time.monotonic()

    def remaining(self, chunks: Iterable[NDArray[Any]], stage: str) -> Iterator[NDArray[Any]]:
        """Skip the chunks that a stage has processed, and return the others.

        Digests cover all chunks up to each, and those of earlier stages, to refuse other readings.
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
        """Set the progress of a stage; write the file if `_WRITE_SHARE` permits."""
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
        self._next_write = ended + (ended - started) / _WRITE_SHARE

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


# Chosen by hand.
ANSWER_S = 3.0  # until a scheduler answers; one that runs takes milliseconds
WORKERS_S = 30.0  # without any worker, in which a cluster may replace a lost one
_CHUNKS_PER_WORKER = 2  # one in progress and one queued; bounds the memory of chunks and results
_SCHEMES = ("tcp", "tls", "ws", "wss")
_POLL_S = 1.0
_CLOSE_S = 2.0


Mapper: TypeAlias = Callable[[NDArray[Any]], Any]
"""Makes an accumulator of a chunk of finite readings, shape (t, N)."""


@dataclass(frozen=True)
class WorkerPool:
    """Workers that process chunks in parallel.

    Parameters
    ----------
    n_workers : int
        Number of threads, as `n_jobs` of joblib; 1 runs in the calling thread.
    scheduler : str
        Address of a Dask scheduler, such as ``tcp://host:8786``. Its workers are used instead.

    Notes
    -----
    If `n_workers` is not 1, a joblib backend in effect around the call is used, for example
    ``joblib.parallel_config("loky")`` for processes. Threads are the default: the expensive
    operations release the global interpreter lock, and data are not copied.

    Dask reruns the chunks of a worker that dies. Ray does so if configured by
    ``joblib.parallel_config("ray", ray_remote_args={"max_restarts": 3, "max_task_retries": 3})``.
    """

    n_workers: int = 1
    scheduler: str = ""


SERIAL = WorkerPool()


def map_reduce(
    chunks: Callable[[], Iterable[NDArray[Any]]],
    mapper: Mapper,
    *,
    pool: WorkerPool = SERIAL,
    checkpoint: Checkpoint | None = None,
    stage: str = "total",
) -> Any:
    """Apply a function to every chunk and merge the results; stages share a checkpoint."""
    done, total, remaining = 0, None, chunks()
    if checkpoint is not None:
        done, _, total = checkpoint.stages.get(stage, Stage())
        remaining = checkpoint.remaining(remaining, stage)
    try:
        for result in _results(remaining, mapper, pool):
            total, done = result if total is None else total.merged(result), done + 1
            if checkpoint is not None:
                checkpoint.update(stage, done, total)
    finally:
        if checkpoint is not None and total is not None:
            checkpoint.write()
    if total is None:
        raise InputError("the recording has no frames")
    return total


def _results(chunks: Iterable[NDArray[Any]], mapper: Mapper, pool: WorkerPool) -> Iterator[Any]:
    """Yield the accumulator of each chunk, in the order of the chunks."""
    if pool.scheduler:
        return _on_dask(chunks, mapper, pool.scheduler)
    if pool.n_workers != 1:
        return _on_joblib(chunks, mapper, pool.n_workers)
    return map(mapper, chunks)


def _on_joblib(chunks: Iterable[NDArray[Any]], mapper: Mapper, n_workers: int) -> Iterator[Any]:
    joblib: Any = import_module("joblib")
    calls = (joblib.delayed(_call)(chunk, mapper, os.getpid()) for chunk in chunks)
    # The limit is per process: threads that set and lifted it separately would interfere.
    with threadpool_limits(1), joblib.Parallel(n_workers, prefer="threads", batch_size=1) as pool:
        # Batches, not return_as="generator": joblib runs ahead of a merge that is slower than the
        # workers, and the results fill memory.
        batch_size = _CHUNKS_PER_WORKER * joblib.effective_n_jobs(n_workers)
        while batch := list(islice(calls, batch_size)):
            try:
                yield from pool(batch)
            except BrokenExecutor as error:
                raise InputError(
                    "a worker process died, perhaps for lack of memory; use fewer workers "
                    "(with a checkpoint, the next run resumes here)"
                ) from error


def _call(chunk: NDArray[Any], mapper: Mapper, caller: int) -> Any:
    """Apply `mapper`, with single-threaded BLAS outside the caller's process."""
    if os.getpid() == caller:
        return mapper(chunk)
    with threadpool_limits(1):
        return mapper(chunk)


def _on_dask(chunks: Iterable[NDArray[Any]], mapper: Mapper, address: str) -> Iterator[Any]:
    dask, distributed = (
        import_extra(name, "using a Dask cluster", "cluster") for name in ("dask", "distributed")
    )
    _check_address(distributed, address)
    settings = {
        # Chunks are part of the task, not scattered, so the scheduler can rerun it if a worker
        # dies.
        "distributed.admin.large-graph-warning-threshold": "1TB",
        "distributed.comm.timeouts.connect": f"{ANSWER_S}s",
    }
    with dask.config.set(settings), ExitStack() as opened:
        try:
            _greet(distributed, address)
            client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError, ImportError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"no Dask scheduler at {address}: {reason}") from error
        opened.callback(_close, client)
        # It logs a traceback when the connection is lost, which is an error here.
        log = logging.getLogger("distributed.client")
        opened.callback(log.setLevel, log.level)
        log.setLevel(logging.CRITICAL)
        try:
            yield from _results_on_cluster(client, chunks, mapper)
        except distributed.KilledWorker as error:
            raise InputError(
                "several Dask workers died over one chunk of frames, perhaps for lack of memory; "
                "give them more memory or fewer threads"
            ) from error
        except (CancelledError, distributed.comm.CommClosedError) as error:
            raise InputError(
                f"the connection to the Dask scheduler at {address} is lost; start it, and run "
                "this again (with a checkpoint, it resumes here)"
            ) from error


def _check_address(distributed: Any, address: str) -> None:
    """Check an address before a client is made, since a client that fails half-way does not end."""
    scheme, separator, place = address.partition("://")
    host, _, port = place.rpartition(":")
    if not separator or scheme not in _SCHEMES or not host or not port.isdecimal():
        raise InputError(
            f"the address of a Dask scheduler must be as in tcp://host:8786, got {address!r}"
        )
    if scheme in ("tls", "wss"):
        given = distributed.Security().get_connection_args("client")
        if given.get("ssl_context") is None:
            raise InputError(
                f"{address} needs certificates: set distributed.comm.tls in the configuration of "
                "Dask, or use tcp://"
            )


def _greet(distributed: Any, address: str) -> None:
    """Check that a scheduler answers; a client has no limit for the time to its first answer."""
    import asyncio  # noqa: PLC0415, slow to import

    host, _, port = address.partition("://")[2].rpartition(":")
    # It fails at once where nothing listens, and says why; Dask tries again until the time is over.
    socket.create_connection((host.strip("[]"), int(port)), ANSWER_S).close()
    options = distributed.Security().get_connection_args("client")

    async def greet() -> None:
        async with asyncio.timeout(ANSWER_S):
            comm = await distributed.comm.connect(address, timeout=ANSWER_S, **options)
            await comm.close()

    # In a thread of its own, since the caller may be in an event loop, such as that of Jupyter.
    with ThreadPoolExecutor(1) as thread:
        try:
            thread.submit(asyncio.run, greet()).result()
        except TimeoutError:
            raise TimeoutError(f"no answer within {ANSWER_S:g} s") from None
        except MemoryError:  # the first bytes of another protocol are taken for a length
            raise ValueError("another server answers, perhaps the dashboard of Dask") from None


def _results_on_cluster(
    client: Any, chunks: Iterable[NDArray[Any]], mapper: Mapper
) -> Iterator[Any]:
    pending: deque[Any] = deque()
    for chunk in chunks:
        pending.append(client.submit(_call, chunk, mapper, os.getpid(), pure=False))
        while len(pending) >= _CHUNKS_PER_WORKER * max(1, sum(client.nthreads().values())):
            yield _result(client, pending.popleft())
    while pending:
        yield _result(client, pending.popleft())


def _result(client: Any, future: Any) -> Any:
    """Wait for a result as long as the scheduler answers and has workers."""
    last_worker, patience_s = time.monotonic(), _POLL_S
    while True:
        try:
            return future.result(timeout=patience_s)
        except TimeoutError:
            if future.status == "error":
                return future.result()  # raises it
            if future.done():
                patience_s *= 2  # it is done, but takes longer to arrive
        if client.status != "running":
            raise CancelledError
        if client.nthreads():
            last_worker = time.monotonic()
        elif time.monotonic() - last_worker > WORKERS_S:
            raise InputError(
                f"the Dask cluster has had no worker for {WORKERS_S:g} s; start workers, and run "
                "this again (with a checkpoint, it resumes here)"
            )


def _close(client: Any) -> None:
    with suppress(OSError, TimeoutError):
        client.close(timeout=_CLOSE_S)
