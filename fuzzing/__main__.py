"""Read damaged files of every format; fail if anything but a refusal happens.

Each case depends on the seed, the format and its number, so that any case can be repeated. The
formats take turns, so that a run that is stopped has tried each of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import product
from pathlib import Path

from benchmarks.harness import markdown_table

from fuzzing.subjects import Subject, subjects
from fuzzing.workers import BATCH, Tally, run_cases, warm_up

_LOADED = (
    *("h5py", "rosbags.rosbag1", "rosbags.rosbag2", "mujoco"),
    *("trimesh", "scipy.io", "defusedxml.ElementTree"),
    *(f"anisomap.cli.commands.{each}" for each in ("recording", "maps", "simulation")),
)
"""Modules that are loaded once, before processes are forked."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and write the table; return 1 if there was a problem."""
    chosen = _parse(arguments)
    for module in _LOADED:
        import_module(module)
    tried = [s for s in subjects() if not chosen.formats or s.name in chosen.formats]
    warm_up(tried)
    chosen.output.mkdir(parents=True, exist_ok=True)
    tallies = {subject.name: Tally() for subject in tried}
    end = time.monotonic() + chosen.seconds
    share = -(-chosen.cases // len(tried))
    for start, subject in product(range(0, share, BATCH), tried):
        tally = tallies[subject.name]
        if time.monotonic() > end:
            break
        stop = min(start + BATCH, share)
        indices = range(chosen.first + start, chosen.first + stop)
        run_cases(subject, chosen.seed, indices, chosen.output, tally)
        if stop == share:
            _print(subject, tally)
        write(tallies, chosen.output / "reliability-table.md", chosen.seed)
    return 1 if any(tally.n_failed for tally in tallies.values()) else 0


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="fuzzing", description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000, help="cases of all formats")
    parser.add_argument("--seconds", type=float, default=3600.0, help="time limit of the run")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case per format")
    parser.add_argument("--formats", nargs="+", help="formats to try; default: all")
    parser.add_argument("-o", "--output", type=Path, default=Path("fuzz"), help="output folder")
    return parser.parse_args(arguments)


def _print(subject: Subject, tally: Tally) -> None:
    each = 1000 * tally.seconds / max(1, tally.n_cases)
    print(
        f"{subject.name}: {tally.n_cases} cases, {tally.n_accepted} accepted, "
        f"{tally.n_failed} with problems, {each:.1f} ms each",
        flush=True,
    )


def write(tallies: Mapping[str, Tally], path: Path, seed: int) -> None:
    """Write the results as a table in Markdown, and the problems."""
    names = ("format", "cases", "refused", "accepted", "problems", "slowest (s)", "largest (MB)")
    rows: list[tuple[object, ...]] = [
        (name, one.n_cases, one.n_cases - one.n_accepted - one.n_failed, one.n_accepted,
         one.n_failed, f"{one.slowest_s:.1f}", f"{one.memory / 1e6:.0f}")
        for name, one in tallies.items()
    ]  # fmt: skip
    problems = [
        f"- {name}, {n} times: {problem}"
        for name, tally in tallies.items()
        for problem, n in tally.problems.items()
    ]
    told = "Problems:" if problems else "There was no problem."
    lines = [*markdown_table(names, rows, names[:1]), "", f"Seed {seed}. {told}", "", *problems]
    path.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
