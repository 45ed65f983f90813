"""Results by format, kept while a run lasts, and their table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from fuzzing.workers import Tally

_COLUMNS = ("format", "cases", "refused", "accepted", "errors", "hangs", "memory", "outputs")


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
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["run"] != self._run:
            raise ValueError(f"{path} holds the results of {found['run']}, not of {self._run}")
        for name, values in found["tallies"].items():
            tally = Tally(**values)
            tally.damages, tally.problems = Counter(tally.damages), Counter(tally.problems)
            self.tallies[name] = tally

    def save(self) -> None:
        """Write the results."""
        tallies = {name: vars(tally) for name, tally in self.tallies.items()}
        content = {"run": self._run, "tallies": tallies}
        self._path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def write(tallies: Mapping[str, Tally], path: Path, seed: int) -> None:
    """Write the results as a Markdown table."""
    figures = {name: _figures(tally) for name, tally in tallies.items()}
    figures["**all**"] = [sum(column) for column in zip(*figures.values(), strict=True)]
    lines = [
        "| " + " | ".join(_COLUMNS) + " |",
        "|---" + "|---:" * (len(_COLUMNS) - 1) + "|",
        *(_line(name, row) for name, row in figures.items()),
        "",
        f"Seed {seed}; written by `make fuzz`.",
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")


def _figures(tally: Tally) -> list[int]:
    counts = {"hangs": 0, "memory": 0, "outputs": 0, "errors": 0}
    for problem, n in tally.problems.items():
        counts[_column(problem)] += n
    refused = tally.n_cases - tally.n_accepted - tally.n_failed
    order = ("errors", "hangs", "memory", "outputs")
    return [tally.n_cases, refused, tally.n_accepted, *(counts[name] for name in order)]


def _line(name: str, row: list[int]) -> str:
    return f"| {name} | " + " | ".join(f"{n:,}" for n in row) + " |"


def _column(problem: str) -> str:
    if problem == "hang":
        return "hangs"
    if "memory" in problem or "MemoryError" in problem:
        return "memory"
    return "outputs" if "after" in problem or "left" in problem else "errors"
