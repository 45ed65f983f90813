"""Map-reduce over chunks of frames, by one process, several, or several machines."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import Any

from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from anisomap.errors import InputError, MissingExtraError
from anisomap.large.checkpoints import Checkpoint, Trail

logger = logging.getLogger(__name__)

_ATTEMPTS = 3
_ROUND = 2  # chunks a worker


@dataclass(frozen=True)
class WorkerPool:
    """Who does the work.

    Parameters
    ----------
    n_workers : int
        Threads of this process that make something of chunks side by side; 1 is none but this.
    scheduler : str
        Address of a Dask scheduler, as in ``tcp://host:8786``, whose workers do it instead.

    Notes
    -----
    Another backend of joblib does the work if it is chosen around the call and `n_workers` is more
    than 1: ``joblib.parallel_config("ray")``, say, or ``"loky"`` for processes. Threads are the
    default since what takes long lets go of the interpreter's lock, and nothing has to be sent.
    """

    n_workers: int = 1
    scheduler: str = ""


SERIAL = WorkerPool()


def map_reduce(
    chunks: Callable[[], Iterable[NDArray[Any]]],
    take: Callable[[NDArray[Any]], Any],
    *,
    pool: WorkerPool = SERIAL,
    checkpoint: Checkpoint | None = None,
    stage: str = "total",
    after: str = "",
) -> Any:
    """Make something of every chunk and merge it.

    Parameters
    ----------
    chunks : callable
        Opens the chunks, from the first on, each time that it is called.
    take : callable
        Makes an accumulator of a chunk: something with a method `merged`. It must go to other
        processes, if there are any.
    pool : WorkerPool
    checkpoint : Checkpoint, optional
        Where to go on, and what to keep up to date.
    stage : str
        Its name in the checkpoint.
    after : str
        A stage that `take` was made from, if any: nothing is gone on with after another outcome.

    Returns
    -------
    object
        The accumulator of all chunks: merged in their order, whoever did the work, and so the
        same to the last bit.

    Raises
    ------
    InputError
        If there is no chunk, or workers keep dying.
    FileError
        If the checkpoint is of other chunks.
    MissingExtraError
        If a scheduler is given, and Dask is not installed.
    """
    done, total = checkpoint(stage) if checkpoint else (0, None)
    failures = 0
    while True:
        trail = Trail(checkpoint.mark(after) if checkpoint else "")
        opened = iter(trail.along(chunks()) if checkpoint else chunks())
        for _ in islice(opened, done):
            pass
        if checkpoint:
            checkpoint.check(stage, trail.mark(done))
        try:
            for part in _shared(opened, take, pool):
                total, done = part if total is None else total.merged(part), done + 1
                failures = 0
                if checkpoint:
                    checkpoint.keep(stage, done, trail.mark(done), total)
            break
        except BrokenExecutor as error:
            failures += 1
            if failures == _ATTEMPTS:
                raise InputError(
                    f"workers died {failures} times over the chunk after the first {done}: "
                    "they may lack memory; use fewer"
                ) from error
            logger.info("a worker died; going on after chunk %d", done)
    if total is None:
        raise InputError("there is no frame to make a map of")
    if checkpoint:
        checkpoint.write()
    return total


def _shared(
    chunks: Iterable[NDArray[Any]], take: Callable[[NDArray[Any]], Any], pool: WorkerPool
) -> Iterator[Any]:
    if pool.n_workers == 1 and not pool.scheduler:
        return map(take, chunks)
    joblib: Any = import_module("joblib")
    if pool.scheduler:
        return _on_dask(joblib, chunks, take, pool.scheduler)
    return _on_joblib(joblib, chunks, take, pool.n_workers)


def _on_joblib(
    joblib: Any, chunks: Iterable[NDArray[Any]], take: Callable[[NDArray[Any]], Any], workers: int
) -> Iterator[Any]:
    # Limits are those of a process: threads that set and lifted them would undo one another's.
    with threadpool_limits(1), joblib.Parallel(workers, prefer="threads", batch_size=1) as pool:
        yield from _in_rounds(joblib, pool, chunks, take, joblib.effective_n_jobs(workers))


def _in_rounds(
    joblib: Any,
    pool: Callable[[list[Any]], list[Any]],
    chunks: Iterable[NDArray[Any]],
    take: Callable[[NDArray[Any]], Any],
    n_workers: int,
) -> Iterator[Any]:
    """Hand out some chunks at a time: workers that are faster than merging would fill memory."""
    jobs = (joblib.delayed(_alone)(take, chunk, os.getpid()) for chunk in chunks)
    while batch := list(islice(jobs, _ROUND * n_workers)):
        yield from pool(batch)


def _on_dask(
    joblib: Any, chunks: Iterable[NDArray[Any]], take: Callable[[NDArray[Any]], Any], address: str
) -> Iterator[Any]:
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise MissingExtraError("work on a Dask cluster", "cluster") from error
    try:
        client = distributed.Client(address, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"there is no Dask scheduler at {address}: {error}") from error
    died = (distributed.client.FutureCancelledError, distributed.KilledWorker)
    with client, joblib.parallel_config("dask", client=client):
        pool = joblib.Parallel(batch_size=1)
        try:
            yield from _in_rounds(joblib, pool, chunks, take, joblib.effective_n_jobs(-1))
        except died as error:
            # Dask takes up the work of a worker that died, but not the chunks that it held.
            raise BrokenExecutor(str(error)) from error


def _alone(take: Callable[[NDArray[Any]], Any], chunk: NDArray[Any], asked_by: int) -> Any:
    """Do a worker's part on one thread: the others have work of their own."""
    if os.getpid() == asked_by:
        return take(chunk)
    with threadpool_limits(1):
        return take(chunk)
