"""All experiments, in the order of the page; they run in parallel, each at most once."""

from __future__ import annotations

import importlib.metadata
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

from joblib import Parallel, cpu_count, delayed
from joblib import hash as digest
from threadpoolctl import threadpool_limits

import anisomap
from anisomap.errors import AnisomapWarning, FileError, InputError, MissingExtraError
from anisomap.files.paths import named_errors
from anisomap.paper import accuracy, bodies, claims, patch, reach, sample_data, sensitivity
from anisomap.paper.experiment import REGISTRY, Experiment, Settings
from anisomap.paper.results import PAGE, load, save, write_page

_MODULES = (claims, bodies, patch, accuracy, sample_data, sensitivity, reach)
"""Modules that register experiments when they are imported."""

_PAGE_ORDER = (
    "claims",
    "figure-1",
    "figure-2",
    "real-skin",
    "figure-3",
    *(f"figure-{number}" for number in range(4, 8)),
    *(f"figure-s{number}" for number in range(1, 11)),
    "data-s1-s6",
    "data-s7-s11",
    "text-s3",
    "ablations",
)
"""The first experiments with a section on the page; all others follow in order of definition."""

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {name: REGISTRY[name] for name in (*_PAGE_ORDER, *REGISTRY)}
)
"""Experiments by name, which is also the name of the folder of results."""

_WATCH_S = 1.0  # interval of checks of a worker that its parent is alive


@dataclass(frozen=True)
class Status:
    """State of an experiment after a run.

    seconds: Duration of the computation of the experiment.
    state: Experiments that lack a recording are skipped.
    """

    name: str
    seconds: float
    state: str


def reproduce(
    folder: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    only: Sequence[str] = (),
    experiments: Mapping[str, Experiment] = EXPERIMENTS,
    report: Callable[[Status, float], None] | None = None,
) -> list[Status]:
    """Run the experiments of the paper, one in each process, and write the page.

    The environment variable LOKY_MAX_CPU_COUNT limits the number of processes.
    """
    settings, target = settings or Settings(), Path(folder)
    chosen = _with_needs(only or list(experiments), experiments)
    _check(settings)
    with named_errors(target, "create the folder"):
        target.mkdir(parents=True, exist_ok=True)
    found = {one.name: Status(one.name, 0.0, "skipped") for one in chosen}
    prints: dict[str, str] = {}
    pending: list[Experiment] = []
    n_finished, total = 0, sum(one.can_run(settings) for one in chosen)

    def finish(name: str, seconds: float, state: str) -> None:
        nonlocal n_finished
        n_finished += 1
        found[name] = Status(name, seconds, state)
        if report is not None:
            report(found[name], n_finished / total)

    for one in chosen:
        if one.can_run(settings):
            prints[one.name] = _fingerprint(one, settings, prints)
            result = load(target, one.name, prints[one.name])
            if result is None:
                pending.append(one)
            else:
                finish(one.name, result["seconds"], "cached")
    for is_needing in (False, True):
        level = [one for one in pending if bool(one.needs) == is_needing]
        parallel = Parallel(
            n_jobs=min(cpu_count(), max(1, len(level))),
            batch_size=1,
            pre_dispatch="n_jobs",  # start no more experiments after an interruption
            return_as="generator_unordered",
        )
        for name, seconds in parallel(
            delayed(_run)(os.getpid(), target, one, settings, prints)
            for one in sorted(level, key=lambda one: -one.cost)
        ):
            finish(name, seconds, "computed")
    write_page(target / PAGE, settings, experiments.values(), prints)
    return list(found.values())


def _check(settings: Settings) -> None:
    if not all(map(find_spec, ("mujoco", "matplotlib", "jinja2", "numba"))):
        raise MissingExtraError("reproducing the paper", "paper")
    if settings.recordings is not None and not settings.recordings.is_dir():
        raise FileError(f"the folder of recordings {settings.recordings} does not exist")


def _with_needs(names: Iterable[str], experiments: Mapping[str, Experiment]) -> list[Experiment]:
    """Return experiments, with the experiments that each needs before it."""
    chosen = list(names)
    for name in chosen:
        if name not in experiments:
            raise InputError(f"unknown experiment {name!r}; choose from {', '.join(experiments)}")
    needed = [name for one in chosen for name in experiments[one].needs]
    return [experiments[name] for name in dict.fromkeys([*needed, *chosen])]


def _run(
    parent: int, folder: Path, experiment: Experiment, settings: Settings, prints: Mapping[str, str]
) -> tuple[str, float]:
    """Compute and save an experiment; return its name and duration."""
    _end_with(parent)
    started = time.perf_counter()
    needed = [load(folder, name, prints[name]) for name in experiment.needs if name in prints]
    tables = {table.name: table for result in needed if result for table in result["tables"]}
    with threadpool_limits(1), warnings.catch_warnings():
        # Notes would be repeated for hundreds of maps; the tables contain the scores.
        warnings.simplefilter("ignore", AnisomapWarning)
        found = [*experiment.compute(settings, tables)]
        seconds = round(time.perf_counter() - started, 2)
        save(folder, experiment.name, found, prints[experiment.name], seconds)
    return experiment.name, seconds


@cache
def _end_with(parent: int) -> None:
    """End this process, if it is a worker, soon after its parent has ended for any reason."""

    def watch() -> None:
        while os.getppid() == parent:  # on Windows always: workers end when they are idle
            time.sleep(_WATCH_S)
        os._exit(1)

    if os.getpid() != parent:
        threading.Thread(target=watch, daemon=True).start()


def _fingerprint(experiment: Experiment, settings: Settings, needed: Mapping[str, str]) -> str:
    """Digest all inputs of the result of an experiment."""
    inputs = (
        experiment.name,
        (settings.seed, settings.quick, sorted(settings.changes)),
        [path.read_bytes() for path in experiment.paths(settings)],
        [(name, needed.get(name)) for name in experiment.needs],
        _digest_of_package(),
        [importlib.metadata.version(name) for name in ("numpy", "scipy", "mujoco", "matplotlib")],
    )
    return str(digest(inputs))


@cache
def _digest_of_package() -> str:
    """Digest the source code and texts; the command line does not affect results."""
    root = Path(str(files(anisomap)))
    sources = [path for path in sorted(root.rglob("*")) if path.suffix in (".py", ".txt")]
    inside = [path for path in sources if path.relative_to(root).parts[0] not in ("cli", "live")]
    return str(digest([path.read_bytes() for path in inside]))
