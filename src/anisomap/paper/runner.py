"""Running experiments: each once, those that others need first, over all cores."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from anisomap.errors import AnisomapWarning, FileError, InputError, MissingExtraError
from anisomap.paper import result_cache as results
from anisomap.paper.experiment import Experiment, Settings, Table
from anisomap.paper.page import write_page
from anisomap.paper.registry import EXPERIMENTS

PAGE = "index.html"


@dataclass(frozen=True)
class Done:
    """What became of an experiment.

    Attributes
    ----------
    name : str
    seconds : float
        How long it took when it ran.
    how : {"made", "kept", "left out"}
        Kept ones were finished before; those left out lack a recording.
    """

    name: str
    seconds: float
    how: str


def reproduce(
    folder: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    only: Sequence[str] = (),
    workers: int | None = None,
    experiments: Mapping[str, Experiment] = EXPERIMENTS,
    tell: Callable[[Done, float], None] | None = None,
) -> list[Done]:
    """Run the experiments of the paper, and write the page.

    Parameters
    ----------
    folder : path-like
        Where to; made if it is not there. What is finished there is not run again.
    settings : Settings, optional
    only : sequence of str
        Names of experiments; all unless given. Those that they need are run, too.
    workers : int, optional
        Processes; as many as there are cores unless given. With 1, everything runs in this one.
    experiments : mapping of str to Experiment
        What there is to run.
    tell : callable, optional
        Told of every experiment once it is done, and the share of all that is.

    Returns
    -------
    list of Done
        In the order of `experiments`.

    Raises
    ------
    InputError
        If there is no such experiment, or fewer than 1 worker.
    FileError
        If the folder cannot be made or written to, or the folder of recordings is not there.
    MissingExtraError
        If MuJoCo, matplotlib or jinja2 is not installed.
    """
    _check_extras()
    chosen = settings or Settings()
    target = Path(folder)
    wanted = _with_needs(only or list(experiments), experiments)
    if workers is not None and workers < 1:
        raise InputError(f"workers is {workers}; it takes at least 1")
    if chosen.recordings is not None and not chosen.recordings.is_dir():
        raise FileError(f"there is no folder of recordings {chosen.recordings}")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot make the folder {target}: {error.strerror}") from error
    results.sweep(target, experiments)
    can_run = [one for one in wanted if one.can_run(chosen)]
    keys: dict[str, str] = {}
    for one in can_run:
        keys[one.name] = results.key_of(one, chosen, keys)
    pending = [one for one in can_run if results.load(target, one.name, keys[one.name]) is None]
    tell = tell or (lambda _done, _share: None)
    for done, one in enumerate(one for one in can_run if one not in pending):
        tell(_finished(target, one, "kept"), (done + 1) / len(can_run))
    run = _Run(target, chosen, keys, len(can_run), tell)
    run.make(pending, workers or os.cpu_count() or 1)
    write_page(target / PAGE, target, chosen, experiments, keys)
    return [
        Done(one.name, 0.0, "left out")
        if one not in can_run
        else _finished(target, one, "made" if one in pending else "kept")
        for one in wanted
    ]


@dataclass(frozen=True, eq=False)
class _Run:
    """Makes experiments, in processes of their own or in this one."""

    folder: Path
    settings: Settings
    keys: Mapping[str, str]
    total: int
    tell: Callable[[Done, float], None]

    def make(self, pending: Sequence[Experiment], workers: int) -> None:
        if not pending:
            return
        if workers == 1:
            self._make_in(_Here(), pending)
            return
        # Fresh processes, since forked ones inherit threads.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            try:
                self._make_in(pool, pending)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise

    def _make_in(self, pool: Executor, pending: Sequence[Experiment]) -> None:
        waiting = sorted(pending, key=lambda one: -one.cost)
        unfinished = {one.name for one in pending}
        running: dict[Future[None], Experiment] = {}
        while waiting or running:
            ready = [one for one in waiting if not unfinished & set(one.needs)]
            waiting = [one for one in waiting if one not in ready]
            for one in ready:
                arguments = (self.folder, one, self.settings, self._tables(one), self.keys)
                running[pool.submit(_make, *arguments)] = one
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                one = running.pop(future)
                future.result()
                unfinished.discard(one.name)
                share = 1 - len(unfinished) / self.total
                self.tell(_finished(self.folder, one, "made"), share)

    def _tables(self, one: Experiment) -> dict[str, Table]:
        kept = [results.load(self.folder, name) for name in one.needs]
        return {table.name: table for each in kept if each for table in each.tables}


class _Here(Executor):
    """Runs what is submitted at once, in this process."""

    def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*arguments, **options))
        return future


def _make(
    folder: Path,
    experiment: Experiment,
    settings: Settings,
    tables: Mapping[str, Table],
    keys: Mapping[str, str],
) -> None:
    started = time.perf_counter()
    with threadpool_limits(1), warnings.catch_warnings():
        # One doubt would be told for hundreds of maps; the tables show what there is to doubt.
        warnings.simplefilter("ignore", AnisomapWarning)
        outcome = experiment.make(settings, tables)
        results.save(folder, experiment, outcome, keys[experiment.name], started)


def _finished(folder: Path, one: Experiment, how: str) -> Done:
    kept = results.load(folder, one.name)
    return Done(one.name, kept.seconds if kept else 0.0, how)


def _check_extras() -> None:
    for module, extra in (("mujoco", "simulation"), ("matplotlib", "report"), ("jinja2", "report")):
        if find_spec(module) is None:
            raise MissingExtraError("making the paper again", extra)


def _with_needs(names: Sequence[str], experiments: Mapping[str, Experiment]) -> list[Experiment]:
    """Give experiments and those that they need, each after those, else in their order."""
    found: dict[str, Experiment] = {}

    def add(name: str) -> None:
        if name not in experiments:
            raise InputError(
                f"there is no experiment {name!r}; choose from {', '.join(experiments)}"
            )
        for needed in experiments[name].needs:
            add(needed)
        found.setdefault(name, experiments[name])

    for name in names:
        add(name)
    return list(found.values())
