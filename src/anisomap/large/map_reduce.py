"""Map-reduce over chunks of frames: in one process, with joblib, or on a Dask cluster."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import Any, TypeAlias

from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError, import_extra
from anisomap.large.checkpoints import Checkpoint, Stage

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
