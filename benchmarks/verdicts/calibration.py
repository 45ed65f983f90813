"""Fit the accuracy of maps to their evidence.

``python -m benchmarks.verdicts.calibration trust/trust.csv`` reads results of `trust`. It
prints the constants of `anisomap.verdict.judge`, and a table of how well they hold for kinds
of skin that were left out of the fit.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit

from anisomap.method.dimensions import SPATIAL
from benchmarks.harness import keyed_table
from benchmarks.verdicts.trust import MAX_ERROR, closeness, read_outcomes

Floats: TypeAlias = NDArray[np.float64]

_HUBER = 0.7  # differences of logarithms from which outcomes count linearly
_LARGEST, _ENDS = 20.0, (0.02, 0.98)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print constants and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    chosen = parser.parse_args(arguments)
    used = usable(pd.concat(map(read_outcomes, chosen.results), ignore_index=True))
    print(constants(used))
    print(table(used))


def usable(outcomes: Any) -> Any:
    """Keep outcomes with errors of at most a spacing, unless something else excludes the map."""
    known = np.isfinite(outcomes[["error", "r", "difference", "regional"]]).all(axis=1)
    kept = outcomes[known & (outcomes.excluded == 0) & (outcomes.error <= MAX_ERROR)]
    measured = ["repeatability", "difference", "regional"]
    return kept.assign(**{name: kept[name].clip(0.01, _LARGEST) for name in measured})


_WHOLE, _REGIONS = ("difference", "error"), ("regional", "region")
"""Columns of the second measurement, and of the true errors: of maps, and of regions."""


def expected_errors(outcomes: Any, factors: Floats, range_: tuple[str, str] = _WHOLE) -> Any:
    """Return the expected errors, given the factors of chance, and of differences in 2D and 3D."""
    by_difference = np.where(outcomes.dimensions == SPATIAL, factors[-1], factors[1])
    return np.hypot(factors[0] * outcomes.repeatability, by_difference * outcomes[range_[0]])


def fitted(outcomes: Any, range_: tuple[str, str] = _WHOLE) -> Floats:
    """Fit the factors of the expected error, robustly, to the logarithms of errors."""

    def loss(factors: Floats) -> float:
        expected = expected_errors(outcomes, np.exp(factors), range_)
        apart = np.abs(np.log(expected / outcomes[range_[1]]))
        return float(np.where(apart < _HUBER, apart**2, 2 * _HUBER * apart - _HUBER**2).mean())

    start = [-0.7, -0.5] if range_ is _REGIONS else [-0.7, -0.5, -0.5]
    return np.exp(minimize(loss, start, method="Nelder-Mead").x)


def constants(outcomes: Any) -> str:
    """Return the constants that fit all outcomes, and the quantiles of what they miss."""
    factors = fitted(outcomes)
    missed = np.quantile(held_out(outcomes), [0.05, 0.95])
    regions = outcomes[outcomes.region > 0]
    of_regions = fitted(regions, _REGIONS)
    expected = expected_errors(regions, of_regions, _REGIONS)
    apart = np.quantile(regions.region / expected, [0.05, 0.95])
    kept = logit(regions.kept.clip(*_ENDS))
    slope, odds = np.polyfit(np.log(expected), kept, 1)
    beyond = np.quantile(kept - slope * np.log(expected) - odds, [0.05, 0.95])
    at = expit(odds + slope * np.log(0.5))
    return "\n".join(
        [
            "BY_CHANCE, BY_STEPS = {:.2f}, ({:.2f}, {:.2f})".format(*factors),
            "ERROR_INTERVAL = ({:.2f}, {:.1f})".format(*np.exp(missed)),
            "REGION_BY_CHANCE, REGION_BY_DIFFERENCE = {:.2f}, {:.2f}".format(*of_regions),
            "REGION_INTERVAL = ({:.2f}, {:.1f})".format(*apart),
            f"NEIGHBOURS, NEIGHBOURS_SLOPE = {odds:.2f}, {slope:.2f}  # {at:.0%} at .5 spacings",
            "NEIGHBOURS_INTERVAL = ({:.1f}, {:.1f})".format(*beyond),
        ]
    )


def held_out(outcomes: Any) -> Any:
    """Return log true over expected errors, each kind expected by a fit to all others."""
    factors = {kind: fitted(outcomes[outcomes.kind != kind]) for kind in outcomes.kind.unique()}
    by_row = np.stack(outcomes.kind.map(factors), axis=1)
    return np.log(outcomes.error / expected_errors(outcomes, by_row))


def table(outcomes: Any) -> str:
    """Return how well errors are expected for each kind that was left out, in Markdown."""
    missed = held_out(outcomes)
    groups = [(f"{name}: all", part) for name, part in missed.groupby(outcomes.group)]
    groups += [
        (f"{name}: {kind}", part)
        for (kind, name), part in missed.groupby([outcomes.kind, outcomes.group])
    ]
    rows = ({"kind left out": label, **closeness(np.exp(-part))} for label, part in groups)
    return "\n".join(keyed_table(rows))


if __name__ == "__main__":
    main()
