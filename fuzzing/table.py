"""Results by format, kept while a run lasts, and their table.

``python -m fuzzing.table fuzz-1/results.json fuzz-2/results.json -o docs/reliability-table.md``
writes the table of several runs.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from fuzzing.workers import Tally

_COLUMNS = (
    *("format", "cases", "refused", "accepted", "errors", "hangs", "memory", "outputs"),
    *("slowest (s)", "largest (MB)"),
)


class Results:
    """The results of a run, in a file from which it can be continued.

    Parameters
    ----------
    path : Path
    seed, first : int
        Seed and number of the first case per format.
    resume : bool
        Whether to begin with the results in the file.

    Raises
    ------
    ValueError
        If the results in the file are of other cases.
    """

    def __init__(self, path: Path, seed: int, first: int, resume: bool) -> None:
        self._path = path
        self._run = {"seed": seed, "first": first}
        self.tallies: dict[str, Tally] = {}
        if not (resume and path.exists()):
            return
        run, self.tallies = _read(path)
        if run != self._run:
            raise ValueError(f"{path} holds the results of {run}, not of {self._run}")

    def save(self) -> None:
        """Write the results."""
        tallies = {name: vars(tally) for name, tally in self.tallies.items()}
        content = {"run": self._run, "tallies": tallies}
        self._path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _read(path: Path) -> tuple[dict[str, int], dict[str, Tally]]:
    found = json.loads(path.read_text(encoding="utf-8"))
    tallies = {name: Tally(**values) for name, values in found["tallies"].items()}
    for tally in tallies.values():
        tally.damages, tally.problems = Counter(tally.damages), Counter(tally.problems)
    return found["run"], tallies


def write(tallies: Mapping[str, Tally], path: Path, *seeds: int) -> None:
    """Write the results of the runs of some seeds as a Markdown table, and the problems."""
    total = Tally()
    for tally in tallies.values():
        total.add(tally)
    problems = [
        f"- {name}, {_times(n)}: {problem}"
        for name, tally in tallies.items()
        for problem, n in tally.problems.items()
    ]
    lines = [
        "| " + " | ".join(_COLUMNS) + " |",
        "|---" + "|---:" * (len(_COLUMNS) - 1) + "|",
        *(_line(name, tally) for name, tally in {**tallies, "**all**": total}.items()),
        "",
        f"Written by `python -m fuzzing.table`, of seed{'s' * (len(seeds) > 1)} "
        f"{', '.join(map(str, seeds))}. {'Problems:' if problems else 'There was no problem.'}",
        "",
        *problems,
    ]
    path.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def _line(name: str, tally: Tally) -> str:
    counts = Counter[str]()
    for problem, n in tally.problems.items():
        counts[_column(problem)] += n
    refused = tally.n_cases - tally.n_accepted - tally.n_failed
    columns = [tally.n_cases, refused, tally.n_accepted, *(counts[c] for c in _COLUMNS[4:8])]
    figures = [*(f"{n:,}" for n in columns), f"{tally.slowest_s:.1f}", f"{tally.memory / 1e6:.0f}"]
    return f"| {name} | " + " | ".join(figures) + " |"


def _column(problem: str) -> str:
    if problem == "hang":
        return "hangs"
    if "memory" in problem or "MemoryError" in problem:
        return "memory"
    return "outputs" if "after" in problem or "left" in problem else "errors"


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the table of several runs."""
    parser = argparse.ArgumentParser(prog="fuzzing.table", description=main.__doc__)
    parser.add_argument("results", type=Path, nargs="+", help="results.json of each run")
    parser.add_argument("-o", "--output", type=Path, required=True)
    chosen = parser.parse_args(arguments)
    seeds, joined = list[int](), dict[str, Tally]()
    for path in chosen.results:
        run, tallies = _read(path)
        seeds.append(run["seed"])
        for name, tally in tallies.items():
            joined.setdefault(name, Tally()).add(tally)
    write(joined, chosen.output, *seeds)


if __name__ == "__main__":
    main()
