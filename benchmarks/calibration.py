"""Fit the accuracy of maps to their evidence: ``python -m benchmarks.calibration trust/trust.csv``.

Reads results of ``make trust``. Prints the constants of `anisomap.diagnosis.accuracy`, and a table
of how well they hold for kinds of skin that were left out of the fit.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit

from benchmarks.harness import heading, line
from benchmarks.trust import Outcome, read_outcomes

Floats: TypeAlias = NDArray[np.float64]

_UNSAYABLE = ("duplicated", "cycling", "swapped")
"""Faults that no evidence shows: copies of wires and signals of one period are found by themselves,
and exchanged wires leave maps right."""

_HUBER = 0.7  # differences of logarithms from which outcomes count linearly
_LARGEST, _ENDS = 20.0, (0.02, 0.98)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print constants and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    chosen = parser.parse_args(arguments)
    used = [one for path in chosen.results for one in read_outcomes(path) if is_used(one)]
    print(constants(used))
    print(table(used))


def is_used(outcome: Outcome) -> bool:
    """Return whether a map and its evidence are known."""
    known = (outcome.error, outcome.r, outcome.evidence.get("difference", math.nan))
    return all(map(math.isfinite, known)) and not outcome.fault.startswith(_UNSAYABLE)


def columns(outcomes: Sequence[Outcome]) -> tuple[Floats, Floats, Floats]:
    """Return the two measurements and the error of each map."""
    chance, difference = (
        np.array([one.evidence.get(name, math.nan) for one in outcomes]).clip(0.01, _LARGEST)
        for name in ("repeatability", "difference")
    )
    return chance, difference, np.array([one.error for one in outcomes])


def fitted(chance: Floats, difference: Floats, error: Floats) -> Floats:
    """Fit the two factors of the expected error, robustly, to the logarithms of errors."""

    def loss(factors: Floats) -> float:
        by_chance, by_difference = np.exp(factors)
        expected = np.hypot(by_chance * chance, by_difference * difference)
        apart = np.abs(np.log(expected / error))
        return float(np.where(apart < _HUBER, apart**2, 2 * _HUBER * apart - _HUBER**2).mean())

    return np.exp(minimize(loss, [-0.7, -0.5], method="Nelder-Mead").x)


def constants(outcomes: Sequence[Outcome]) -> str:
    """Return the constants that fit all outcomes, and the quantiles of what they miss."""
    chance, difference, error = columns(outcomes)
    factors = fitted(chance, difference, error)
    expected = np.hypot(factors[0] * chance, factors[1] * difference)
    missed = np.quantile(held_out(outcomes, error), [0.05, 0.95])
    region = np.array([one.evidence.get("region", math.nan) for one in outcomes])
    known = np.isfinite(region) & (region > 0)
    power, scale = np.polyfit(np.log(expected[known]), np.log(region[known]), 1)
    apart = np.log(region[known]) - power * np.log(expected[known]) - scale
    kept = logit(np.clip([one.kept for one in outcomes], *_ENDS))
    slope, odds = np.polyfit(np.log(expected), kept, 1)
    beyond = np.quantile(kept - slope * np.log(expected) - odds, [0.05, 0.95])
    at = expit(odds + slope * np.log(0.5))
    return "\n".join(
        [
            f"BY_CHANCE, BY_DIFFERENCE = {factors[0]:.2f}, {factors[1]:.2f}",
            "ERROR_INTERVAL = ({:.2f}, {:.1f})".format(*np.exp(missed)),
            f"REGION, REGION_POWER = {math.exp(scale):.2f}, {power:.2f}",
            "REGION_INTERVAL = ({:.2f}, {:.1f})".format(*np.exp(np.quantile(apart, [0.05, 0.95]))),
            f"NEIGHBOURS, NEIGHBOURS_SLOPE = {odds:.1f}, {slope:.1f}  # {at:.0%} at .5 spacings",
            "NEIGHBOURS_INTERVAL = ({:.1f}, {:.1f})".format(*beyond),
        ]
    )


def held_out(outcomes: Sequence[Outcome], error: Floats) -> Floats:
    """Return log true over expected errors, each kind expected by a fit to all others."""
    chance, difference, _ = columns(outcomes)
    kinds = np.array([one.kind for one in outcomes])
    found = np.empty(len(outcomes))
    for kind in np.unique(kinds):
        out = kinds == kind
        factors = fitted(chance[~out], difference[~out], error[~out])
        expected = np.hypot(factors[0] * chance[out], factors[1] * difference[out])
        found[out] = np.log(error[out] / expected)
    return found


def table(outcomes: Sequence[Outcome]) -> str:
    """Return how well errors are expected for each kind that was left out, in Markdown."""
    ratios = np.exp(-held_out(outcomes, columns(outcomes)[2]))
    lines = heading(("kind left out", "maps", "expected / true, median", "within 1.5", "within 2"))
    groups = {("all", group) for group in {one.group for one in outcomes}}
    for kind, group in sorted(groups) + sorted({(one.kind, one.group) for one in outcomes}):
        part = np.array([one.group == group and kind in ("all", one.kind) for one in outcomes])
        found = ratios[part]
        within = (float(np.mean(np.abs(np.log(found)) < math.log(limit))) for limit in (1.5, 2))
        cells = (f"{group}: {kind}", str(part.sum()), f"{np.median(found):.2f}")
        lines.append(line([*cells, *(f"{share:.0%}" for share in within)]))
    return "\n".join(lines)


if __name__ == "__main__":
    main()
