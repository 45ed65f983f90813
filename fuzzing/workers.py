"""Run cases in forked processes, each within limits of memory and time."""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from fuzzing import checks, odd, uses
from fuzzing.checks import Findings
from fuzzing.damage import DAMAGES, Damage, inside
from fuzzing.subjects import Subject, Tree

MAX_CPU_SECONDS, MAX_SECONDS = 10, 600
"""A case that computes longer, or waits longer, is a hang; a busy machine slows the clock only."""

ADDRESS_SPACE = 8 << 30
"""Bytes that a worker may reserve, so that a defect does not take the memory of the machine."""

BATCH = 500
"""Cases per process, so that leaks of libraries do not add up."""

_BY_COMMAND, _IS_ODD, _IS_BOMB, _IS_SPLICED, _IS_WHOLE = 0.08, 0.15, 0.001, 0.03, 0.01
_N_BOMBS, _N_USES = 2, 4  # of each format; enough uses to reach all commands
_CHECKS: Mapping[str, Any] = {
    "file": checks.check_file,
    "mesh": checks.check_mesh,
    "maps": uses.check_maps,
    "source": uses.check_source,
}


@dataclass
class Tally:
    """Results of the cases of one format."""

    n_cases: int = 0
    n_accepted: int = 0
    seconds: float = 0.0
    slowest_s: float = 0.0
    memory: int = 0
    problems: Counter[str] = field(default_factory=Counter)
    n_failed: int = 0


def make_case(subject: Subject, seed: int, index: int) -> tuple[str, Tree, bool, Generator]:
    """Make one case, which depends on the subject, the seed and the index alone.

    Returns the damage, the files, whether a command reads them, and a generator for the check.
    """
    rng = np.random.default_rng([seed, zlib.crc32(subject.name.encode()), index])
    tree = dict(subject.seeds[int(rng.integers(len(subject.seeds)))])
    by_command = bool(rng.random() < _BY_COMMAND)
    chosen = list(tree)[int(len(tree) * rng.random())]
    if subject.name in odd.BOMBS and rng.random() < _IS_BOMB:
        tree[chosen] = _bomb(subject.name, int(rng.integers(_N_BOMBS)))
        return "bombs", tree, by_command, rng
    if subject.name in odd.ODD and rng.random() < _IS_ODD:
        tree[chosen] = odd.ODD[subject.name](rng)
        if rng.random() < 0.7:
            return "odd types", tree, by_command, rng
    if rng.random() < _IS_WHOLE:
        return "none", tree, by_command, rng
    if rng.random() < _IS_SPLICED:
        other = subject.seeds[int(rng.integers(len(subject.seeds)))]
        part = next(iter(other.values()))
        at = int(rng.integers(len(tree[chosen]) + 1))
        tree[chosen] = tree[chosen][:at] + part[int(rng.integers(len(part) + 1)) :]
        return "splices", tree, by_command, rng
    name = list(DAMAGES)[rng.integers(len(DAMAGES))]
    for i in range(int(rng.choice([1, 1, 1, 2, 3]))):
        damage: Damage = DAMAGES[name if i == 0 else list(DAMAGES)[rng.integers(len(DAMAGES))]]
        if rng.integers(3):
            tree[chosen] = inside(tree[chosen], rng, damage)
        else:
            tree[chosen] = damage(tree[chosen], rng)
    return name, tree, by_command, rng


@lru_cache
def _bomb(name: str, index: int) -> bytes:
    return odd.BOMBS[name](np.random.default_rng(index))


def run_case(
    subject: Subject, tree: Tree, folder: Path, rng: Generator, *, by_command: bool = False
) -> Findings:
    """Read the files of a case from a folder, and return what that showed."""
    found = Findings(folder)
    for name, content in tree.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    first = next(iter(tree))
    target = folder / Path(first).parts[0]
    command = by_command and subject.kind == "file"
    (checks.check_file_by_command if command else _CHECKS[subject.kind])(target, found, rng)
    return found


def warm_up(tried: Sequence[Subject]) -> None:
    """Read whole files by the library and the commands, so that forked processes find all loaded.

    Modules are imported, and compiled functions loaded, when they are used first.
    """
    with (
        tempfile.TemporaryDirectory(prefix="anisomap-fuzz-") as name,
        Path(os.devnull).open("w") as nowhere,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
        for use, subject in product(range(_N_USES), tried):
            folder = Path(name) / f"{use}-{subject.name}"
            folder.mkdir()
            rng = np.random.default_rng(use)
            run_case(subject, subject.seeds[0], folder, rng, by_command=bool(use % 2))


def run_cases(
    subject: Subject, seed: int, indices: Sequence[int], keep: Path, tally: Tally | None = None
) -> Tally:
    """Run cases of a subject in processes that are replaced when they die; keep failing ones."""
    tally = Tally() if tally is None else tally
    if subject.name in odd.BOMBS and len(indices) >= BATCH:
        for index in range(_N_BOMBS):
            _bomb(subject.name, index)  # once, before processes are forked
    position = 0
    while position < len(indices):
        n_done = 0
        for record in _forked(subject, seed, indices[position : position + BATCH]):
            n_done += 1
            _count(tally, subject, seed, record, keep)
        position += n_done
    return tally


def _count(tally: Tally, subject: Subject, seed: int, record: dict[str, Any], keep: Path) -> None:
    tally.n_cases += 1
    tally.n_accepted += bool(record["accepted"])
    tally.seconds += record["seconds"]
    tally.slowest_s = max(tally.slowest_s, record["seconds"])
    tally.memory = max(tally.memory, record["memory"])
    tally.n_failed += bool(record["problems"])
    for problem in record["problems"]:
        tally.problems[problem] += 1
        if tally.problems[problem] == 1:
            print(f"{subject.name} {record['index']} ({record['damage']}): {problem}", flush=True)
            _, tree, *_ = make_case(subject, seed, record["index"])
            for name, content in tree.items():
                path = keep / f"{subject.name.replace(' ', '-')}-{record['index']}" / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)


def _forked(subject: Subject, seed: int, indices: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Run cases in one forked process; stop after the case in which it dies."""
    forked, begun = get_context("fork"), dict[str, Any]()
    receiving, sending = forked.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="anisomap-fuzz-") as folder:  # also if it dies
        cases = subject, seed, indices, Path(folder), sending
        worker = forked.Process(target=_run, args=cases)
        worker.start()
        sending.close()
        with suppress(EOFError):
            while True:
                begun = receiving.recv()
                if "problems" in begun:
                    yield begun
                    begun = {}
        worker.join()
    number = -min(worker.exitcode or 0, 0)
    if begun:
        hang = number in (signal.SIGPROF, signal.SIGALRM)
        name = signal.Signals(number).name if number else f"exit code {worker.exitcode}"
        problem = "hang" if hang else f"the process died: {name}"
        costs = {"seconds": MAX_CPU_SECONDS, "memory": 0}
        yield {**begun, **costs, "accepted": False, "problems": [problem]}
    elif worker.exitcode:
        raise RuntimeError(f"a worker for {subject.name} ended with code {worker.exitcode}")


def _run(
    subject: Subject, seed: int, indices: Sequence[int], base: Path, sending: Connection
) -> None:
    os.environ["ANISOMAP_DEBUG"] = "1"  # errors in the commands are raised, not reported as 70
    in_use = checks.status("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (in_use + ADDRESS_SPACE, in_use + ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    here = base / "here"
    here.mkdir()
    os.chdir(here)
    printed = [_redirected(stream, base / f"{stream}.txt") for stream in (1, 2)]
    sys.stdout, sys.stderr = (open(n, "w", closefd=False) for n in (1, 2))  # noqa: SIM115
    for index in indices:
        damage, tree, by_command, rng = make_case(subject, seed, index)
        begun = {"index": index, "damage": damage}
        sending.send(begun)
        for stream in printed:
            os.ftruncate(stream, 0)
        started = checks.processor_time()
        signal.setitimer(signal.ITIMER_PROF, MAX_CPU_SECONDS)
        signal.setitimer(signal.ITIMER_REAL, MAX_SECONDS)
        with tempfile.TemporaryDirectory(dir=base, prefix="case-") as folder:
            found = run_case(subject, tree, Path(folder), rng, by_command=by_command)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        sys.stdout.flush()
        sys.stderr.flush()
        shown = os.pread(printed[1], 1 << 20, 0).decode("utf-8", "replace")
        found.check_printed(shown, by_command=by_command)
        if not by_command and os.fstat(printed[0]).st_size:
            found.problems.append("the library printed on standard output")
        for stray in here.iterdir():
            found.problems.append(f"left {stray.name} in the working folder")
            stray.unlink()
        seconds = checks.processor_time() - started
        costs = {"seconds": seconds, "memory": found.memory}
        result = {"accepted": found.accepted, "problems": found.problems}
        sending.send({**begun, **costs, **result})


def _redirected(stream: int, path: Path) -> int:
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
    os.dup2(file, stream)
    return file
