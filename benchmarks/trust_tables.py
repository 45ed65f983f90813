"""Table and picture of verdicts against true errors."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure

# Okabe & Ito (2008), distinct for all kinds of colour vision.
_LOOKS = (("#0072B2", "o"), ("#E69F00", "s"), ("#D55E00", "x"))

MIN_R, MAX_ERROR = 0.9, 1.0
"""A map with a smaller Mantel r, or a larger error in spacings, must not be called usable."""

GOOD_R, GOOD_ERROR = 0.97, 0.5
"""A map with at least this r, and a smaller error in spacings, should not be called not usable."""

LEVELS = ("usable", "usable locally", "not usable", "unknown", "refused")


@dataclass(frozen=True)
class Outcome:
    """A verdict, and the truth about the map.

    Attributes
    ----------
    source : str
        Seed or file.
    name : str
        Of the recording.
    fault : str
        That was injected.
    level : str
        Of the verdict, or ``"refused"``.
    expected : float
        Expected error in spacings.
    r, error, kept : float
        Mantel r, RMS error in spacings, and share of neighbours kept.
    reasons : str
        Of the verdict.
    evidence : mapping of str to float
        What the verdict follows from, and properties of the recording.
    """

    FIXED: ClassVar = (
        "source", "name", "fault", "level", "expected", "r", "error", "kept", "reasons",
    )  # fmt: skip
    NUMBERS: ClassVar = ("expected", "r", "error", "kept")

    source: str
    name: str
    fault: str
    level: str
    expected: float
    r: float
    error: float
    kept: float
    reasons: str
    evidence: Mapping[str, float]

    @property
    def is_bad(self) -> bool:
        """Whether the map is too wrong to be called usable."""
        return self.r < MIN_R or self.error > MAX_ERROR

    @property
    def is_good(self) -> bool:
        """Whether the map is too good to be called not usable."""
        return self.r >= GOOD_R and self.error < GOOD_ERROR

    @property
    def is_false_reassurance(self) -> bool:
        """Whether a bad map is called usable."""
        return self.is_bad and self.level == "usable"

    @property
    def is_false_alarm(self) -> bool:
        """Whether a good map is called not usable."""
        return self.is_good and self.level == "not usable"


def number(text: str) -> float:
    """Return a number of a CSV file; an empty text is NaN, and a truth value 0 or 1."""
    if text in ("True", "False"):
        return float(text == "True")
    return float(text) if text else math.nan


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the results in Markdown: figures, levels by quality, and all failures by name."""
    mapped = [one for one in outcomes if not math.isnan(one.r)]
    bad = [one for one in mapped if one.is_bad]
    good = [one for one in mapped if one.is_good]
    reassured = [one for one in mapped if one.is_false_reassurance]
    alarms = [one for one in mapped if one.is_false_alarm]
    ratios = np.array(
        [
            one.expected / one.error
            for one in mapped
            if math.isfinite(one.expected) and one.error > 0
        ]
    )
    cost = [
        one.evidence["cpu verdict"] / one.evidence["cpu map"]
        for one in mapped
        if one.evidence.get("cpu map", 0) > 0
    ]
    lines = ["| figure | value | goal |", "|---|---|---|"]
    seeds = [int(one.source) for one in outcomes if one.source.isdecimal()]
    real = len(outcomes) - len(seeds)
    lines += [f"| recordings | {len(outcomes)} | at least 500 |"]
    if seeds:
        lines.append(f"| of simulated skins, seeds {min(seeds)} to {max(seeds)} | {len(seeds)} | |")
    if real:
        lines.append(f"| of real skins, which were seen during development | {real} | |")
    lines += [
        f"| maps | {len(mapped)} | |",
        f"| false reassurance: called usable, but r < {MIN_R} or error > {MAX_ERROR:g} spacing | "
        f"{len(reassured)} of {len(bad)} | none |",
        f"| false alarm: called not usable, but r >= {GOOD_R} and error < {GOOD_ERROR:g} spacing | "
        f"{len(alarms)} of {len(good)} ({len(alarms) / max(1, len(good)):.1%}) | at most 5 % |",
    ]
    if ratios.size:
        within = np.mean((ratios >= 1 / 2) & (ratios <= 2))
        lines += [
            f"| expected error over true error, median | {np.median(ratios):.2f} | 0.67 to 1.5 |",
            f"| expected error within a factor of 2 of the true error | {within:.0%} | |",
            f"| true error above the expected | {np.mean(ratios < 1):.0%} | |",
        ]
    if cost:
        lines.append(
            "| CPU time of the search for faults and the verdict over that of the map, median | "
            f"{np.median(cost):.1f} | |"
        )
    lines += ["", "| maps | number | " + " | ".join(LEVELS[:-1]) + " |", "|---" * 6 + "|"]
    between = [one for one in mapped if not one.is_bad and not one.is_good]
    for title, group in (
        (f"good: r >= {GOOD_R}, error < {GOOD_ERROR:g}", good),
        ("between", between),
        (f"bad: r < {MIN_R} or error > {MAX_ERROR:g}", bad),
    ):
        counts = Counter(one.level for one in group)
        cells = [title, str(len(group)), *(str(counts[level]) for level in LEVELS[:-1])]
        lines.append("| " + " | ".join(cells) + " |")
    for title, group in (("False reassurance", reassured), ("False alarms", alarms)):
        lines += ["", f"{title}: {'none' if not group else ''}".rstrip()]
        lines += [""] if group else []
        lines += [
            f"- {one.name}: r {one.r:.3f}, error {one.error:.2f}, expected {one.expected:.2f}"
            for one in sorted(group, key=lambda one: one.r)
        ]
    return "\n".join(lines) + "\n"


def draw(outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw expected against true errors, coloured by level."""
    figure = Figure(figsize=(6, 5.5), layout="constrained")
    axes = figure.subplots()
    for level, (colour, marker) in zip(LEVELS, _LOOKS, strict=False):
        chosen = [one for one in outcomes if one.level == level and math.isfinite(one.expected)]
        axes.scatter(
            [one.error for one in chosen],
            [one.expected for one in chosen],
            s=14,
            color=colour,
            marker=marker,
            alpha=0.6,
            linewidths=0.8,
            label=f"{level} ({len(chosen)})",
        )
    ends = np.array([0.03, 30])
    axes.plot(ends, ends, color="0.4", linewidth=0.8)
    axes.axvline(MAX_ERROR, color="0.7", linewidth=0.8)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=ends,
        ylim=ends,
        aspect="equal",
        xlabel="true RMS error (spacings)",
        ylabel="expected error (spacings)",
    )
    axes.legend(title="verdict")
    figure.savefig(path, dpi=120)
