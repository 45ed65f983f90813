"""All experiments, in the order of the page, and their runs: in parallel, each at most once."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

from joblib import Parallel, cpu_count, delayed
from threadpoolctl import threadpool_limits

from anisomap.errors import AnisomapWarning, FileError, InputError, MissingExtraError
from anisomap.paper import accuracy, bodies, claims, patch, results, sample_data, sensitivity
from anisomap.paper.experiment import REGISTRY, Experiment, Settings
from anisomap.paper.results import write_page

_MODULES = (claims, bodies, patch, accuracy, sample_data, sensitivity)
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
    "bins",
    "failing-sensor",
    "unlike-responses",
    "rivals",
    sensitivity.CYLINDER,
    *(f"sensitivity-{parameter.name}" for parameter in sensitivity.PARAMETERS),
    "dimensions",
)
"""Experiments with a section on the page; the others, which provide data to them, follow."""

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {name: REGISTRY[name] for name in (*_PAGE_ORDER, *REGISTRY)}
)
"""By name, which is also the name of the folder of its results."""


PAGE = "index.html"


@dataclass(frozen=True)
class Status:
    """State of an experiment after a run.

    seconds: Duration of the experiment when it was computed.
    state: Skipped experiments lack a recording.
    """

    name: str
    seconds: float
    state: str


def reproduce(
    folder: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    only: Sequence[str] = (),
    workers: int | None = None,
    experiments: Mapping[str, Experiment] = EXPERIMENTS,
    report: Callable[[Status, float], None] | None = None,
) -> list[Status]:
    """Run the experiments of the paper and write the page."""
    settings, target = settings or Settings(), Path(folder)
    chosen = _with_needs(only or list(experiments), experiments)
    _check(settings, workers)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot create the folder {target}: {error.strerror}") from error

    found = {one.name: Status(one.name, 0.0, "skipped") for one in chosen}
    prints: dict[str, str] = {}
    pending: dict[str, Experiment] = {}

    def finish(name: str, seconds: float, state: str) -> None:
        found[name] = Status(name, seconds, state)
        if report is not None:
            finished = sum(status.state != "skipped" for status in found.values())
            report(found[name], finished / total)

    runnable = [one for one in chosen if one.can_run(settings)]
    total = len(runnable)
    for one in runnable:
        prints[one.name] = results.fingerprint(one, settings, prints)
        result = results.load(target, one.name, prints[one.name])
        if result is None:
            pending[one.name] = one
        else:
            finish(one.name, result["seconds"], "cached")
    order = TopologicalSorter({one.name: {*one.needs} & {*pending} for one in pending.values()})
    order.prepare()
    while order.is_active():
        level = sorted(order.get_ready(), key=lambda name: -pending[name].cost)
        parallel = Parallel(
            n_jobs=min(workers or cpu_count(), len(level)),
            batch_size=1,
            pre_dispatch="n_jobs",  # after a kill, workers finish only what they are running
            return_as="generator_unordered",
        )
        calls = (delayed(_run)(target, pending[name], settings, prints) for name in level)
        for name, seconds in parallel(calls):
            finish(name, seconds, "computed")
            order.done(name)
    write_page(target / PAGE, settings, experiments, prints)
    return list(found.values())


def _check(settings: Settings, workers: int | None) -> None:
    if not all(map(find_spec, ("mujoco", "matplotlib", "jinja2"))):
        raise MissingExtraError("reproducing the paper", "paper")
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    if settings.recordings is not None and not settings.recordings.is_dir():
        raise FileError(f"the folder of recordings {settings.recordings} does not exist")


def _run(
    folder: Path, experiment: Experiment, settings: Settings, prints: Mapping[str, str]
) -> tuple[str, float]:
    """Compute and save an experiment; return its name and duration."""
    started = time.perf_counter()
    needed = [results.load(folder, name, prints[name]) for name in experiment.needs]
    tables = {table.name: table for result in needed if result for table in result["tables"]}
    with threadpool_limits(1), warnings.catch_warnings():
        # Notes on single maps would be repeated for hundreds of maps; the tables hold the scores.
        warnings.simplefilter("ignore", AnisomapWarning)
        found = [*experiment.compute(settings, tables)]
        seconds = round(time.perf_counter() - started, 2)
        results.save(folder, experiment.name, found, prints[experiment.name], seconds)
    return experiment.name, seconds


def _with_needs(names: Sequence[str], experiments: Mapping[str, Experiment]) -> list[Experiment]:
    """Return experiments in an order in which each follows those that it needs."""
    found: dict[str, Experiment] = {}

    def add(name: str) -> None:
        if name not in experiments:
            raise InputError(f"unknown experiment {name!r}; choose from {', '.join(experiments)}")
        for needed in experiments[name].needs:
            add(needed)
        found.setdefault(name, experiments[name])

    for name in names:
        add(name)
    return list(found.values())
