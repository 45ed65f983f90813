"""Fit the accuracy of maps to their evidence.

``python -m benchmarks.verdicts.calibration trust/trust.csv`` reads results of `trust`. It
prints the constants of `anisomap.verdict.judge`, and a table of how well they hold for kinds
of skin that were left out of the fit.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logit

from anisomap.method.dimensions import SPATIAL
from benchmarks.harness import keyed_table
from benchmarks.verdicts.trust import MAX_ERROR, closeness, read_outcomes

Floats: TypeAlias = NDArray[np.float64]

_HUBER = 0.7  # differences of logarithms from which outcomes count linearly
_LARGEST, _ENDS = 20.0, (0.02, 0.98)
_START, _FACTORS = -0.7, (-5.0, 1.6)  # logarithms of factors: first ones, and their range


def main(arguments: Sequence[str] | None = None) -> None:
    """Print constants and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    chosen = parser.parse_args(arguments)
    used = usable(pd.concat(map(read_outcomes, chosen.results), ignore_index=True))
    if not len(used):
        parser.error("no map has an error of at most a spacing and the columns metric and uneven")
    print(constants(used))
    print(table(used))


def usable(outcomes: Any) -> Any:
    """Keep outcomes with errors of at most a spacing, unless something else excludes the map."""
    measured = ["repeatability", "difference", "metric", "regional"]
    known = np.isfinite(outcomes[["error", "r", "uneven", *measured]]).all(axis=1)
    kept = outcomes[known & (outcomes.excluded == 0) & (outcomes.error <= MAX_ERROR)]
    return kept.assign(**{name: kept[name].clip(0.01, _LARGEST) for name in measured})


def expected_errors(outcomes: Any, factors: Floats) -> Any:
    """Return expected errors: factors of chance, steps, the metric in 2D and 3D, and paths."""
    chance, steps, flat, spatial, paths = factors
    metric = np.where(outcomes.dimensions == SPATIAL, spatial, flat) * outcomes.metric
    even = np.hypot(steps * outcomes.difference, metric)
    systematic = np.where(outcomes.uneven == 1, paths * outcomes.difference, even)
    return np.hypot(chance * outcomes.repeatability, systematic)


def expected_of_regions(outcomes: Any, factors: Floats) -> Any:
    """Return expected errors of regions, given factors of chance and of differences of regions."""
    return np.hypot(factors[0] * outcomes.repeatability, factors[1] * outcomes.regional)


def fitted(outcomes: Any) -> Floats:
    """Fit the five factors of the errors of maps."""
    return _fitted(lambda factors: outcomes.error / expected_errors(outcomes, factors), 5)


def _fitted(ratios: Callable[[Floats], Any], count: int) -> Floats:
    """Fit factors, robustly, to the logarithms of true errors over those expected with them."""

    def loss(factors: Floats) -> float:
        apart = np.abs(np.log(ratios(np.exp(factors))))
        return float(np.where(apart < _HUBER, apart**2, 2 * _HUBER * apart - _HUBER**2).mean())

    return np.exp(minimize(loss, np.full(count, _START), bounds=[_FACTORS] * count).x)


def constants(outcomes: Any) -> str:
    """Return the constants that fit all outcomes, and the quantiles of what they miss."""
    factors = fitted(outcomes)
    missed = np.quantile(held_out(outcomes), [0.05, 0.95])
    regions = outcomes[outcomes.region > 0]
    of_regions = _fitted(lambda some: regions.region / expected_of_regions(regions, some), 2)
    expected = expected_of_regions(regions, of_regions)
    apart = np.quantile(regions.region / expected, [0.05, 0.95])
    kept = logit(regions.kept.clip(*_ENDS))
    slope, odds = np.polyfit(np.log(expected), kept, 1)
    beyond = np.quantile(kept - slope * np.log(expected) - odds, [0.05, 0.95])
    region = "REGION_BY_CHANCE, REGION_BY_DIFFERENCE, REGION_INTERVAL"
    neighbours = "NEIGHBOURS, NEIGHBOURS_SLOPE, NEIGHBOURS_INTERVAL"
    return "\n".join(
        [
            "BY_CHANCE, BY_STEPS, BY_METRIC, BY_PATHS = "
            "{:.2f}, {:.2f}, ({:.2f}, {:.2f}), {:.2f}".format(*factors),
            "ERROR_INTERVAL = ({:.2f}, {:.1f})".format(*np.exp(missed)),
            "{} = {:.2f}, {:.2f}, ({:.2f}, {:.1f})".format(region, *of_regions, *apart),
            "{} = {:.2f}, {:.2f}, ({:.1f}, {:.1f})".format(neighbours, odds, slope, *beyond),
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
