"""Map-reduce over chunks of frames: in one process, with joblib, or on a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import Any, TypeAlias

from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError
from anisomap.large.checkpoints import Checkpoint, ChunkDigests
from anisomap.large.dask_workers import map_on_dask

Mapper: TypeAlias = Callable[[NDArray[Any]], Any]

_CHUNKS_PER_WORKER = 2  # one in progress and one queued; bounds the memory of chunks and results


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
    after: str = "",
) -> Any:
    """Apply a function to every chunk and merge the results.

    Parameters
    ----------
    chunks : callable
        Returns an iterator over all chunks, from the first.
    mapper : callable
        Returns the accumulator of a chunk, an object with a method `merged`. It must be picklable
        if other processes are used.
    pool : WorkerPool
    checkpoint : Checkpoint, optional
        Progress to resume from and to update.
    stage : str
        Name of this reduction in the checkpoint.
    after : str
        Stage with the result on which `mapper` depends, if any. A checkpoint that was made after
        another result of this stage is refused.

    Returns
    -------
    object
        The merged accumulator. Results are merged in the order of the chunks, so the accumulator
        is bitwise equal for any pool.

    Raises
    ------
    InputError
        If there is no chunk, a worker process dies, or the cluster does not answer.
    FileError
        If the checkpoint was made from other chunks.
    MissingExtraError
        If a scheduler is given and Dask is not installed.
    """
    total = None
    if checkpoint is None:
        for result in _results(chunks(), mapper, pool):
            total = result if total is None else total.merged(result)
    else:
        done, total = checkpoint.progress(stage)
        digests = ChunkDigests(checkpoint.digest(after))
        remaining = digests.follow(chunks())
        for _ in islice(remaining, done):
            pass
        checkpoint.verify(stage, digests.up_to(done))
        try:
            for result in _results(remaining, mapper, pool):
                total, done = result if total is None else total.merged(result), done + 1
                checkpoint.update(stage, done, digests.up_to(done), total)
        finally:
            if total is not None:
                checkpoint.write()
    if total is None:
        raise InputError("the recording has no frames")
    return total


def _results(chunks: Iterable[NDArray[Any]], mapper: Mapper, pool: WorkerPool) -> Iterator[Any]:
    """Yield the accumulator of each chunk, in the order of the chunks."""
    if pool.scheduler:
        return map_on_dask(_call, chunks, (mapper, os.getpid()), pool.scheduler)
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
