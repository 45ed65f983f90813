"""Table of the results by format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fuzzing.workers import Tally

_COLUMNS = ("format", "cases", "refused", "accepted", "errors", "hangs", "memory", "outputs")


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
