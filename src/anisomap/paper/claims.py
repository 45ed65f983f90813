"""The paper's testable claims, their checks against the experiments, and their verdicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import spearmanr

from anisomap.defaults import DEFAULT_BINS
from anisomap.paper.accuracy import MORE_BINS, SCORES, all_scores, by_group
from anisomap.paper.cases import CASES, FIRST_FAILED_RUN, METHODS, PATCH_RUNS
from anisomap.paper.experiment import Outcome, Row, Settings, Table, Tables, experiment
from anisomap.paper.rivals import ABLATIONS
from anisomap.paper.sensitivity import CLAIMED_NOISE, MEDIAN
from anisomap.wording import join_items

# The paper gives no numbers for its claims; all bounds are chosen by hand, before the runs.
REASONABLE, EXCELLENT = 0.7, 0.9  # Mantel r
AMONG_BEST = 0.02  # difference in Mantel r
SIMILAR = 0.05  # difference in Mantel r, or in a share
LARGE = 0.5  # a correlation that is large by the convention of Cohen (1988)
ISOLATED = 2.0  # ratio of distances to the nearest sensor

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
PARTLY, UNCLEAR = "partly reproduced", "not clear"

_LEVEL = 0.95
_RESAMPLES = 1000
_MAX_LISTED = 10  # cases with a value in the table
_ANISOMAPS = METHODS[:2]
_ROLLING, _BOMBARDED = "cylinder-locomotion", "cylinder-bombardment"
_FLAT_SKINS = {
    "plane": ("plane-bombardment, 2D", "plane-bombardment"),
    "patch": ("patch, 2D", "patch, 3D"),
}


@dataclass(frozen=True)
class Interval:
    """A statistic over runs, and its bootstrap interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:z.2f} [{self.low:z.2f}, {self.high:z.2f}]"


Statistic: TypeAlias = Callable[[NDArray[np.float64]], float]


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean())


def interval(runs: ArrayLike, statistic: Statistic = _mean) -> Interval:
    """Compute a statistic of runs with its percentile bootstrap interval. runs (S, ...)."""
    values = np.asarray(runs, dtype=np.float64)
    drawn = np.random.default_rng(0).integers(len(values), size=(_RESAMPLES, len(values)))
    found = [statistic(values[rows]) for rows in drawn]
    low, high = np.quantile(found, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2])
    return Interval(statistic(values), float(low), float(high))


Rows: TypeAlias = Sequence[dict[str, Any]]
"""Scores of all maps, see `anisomap.paper.accuracy.all_scores`."""

Check: TypeAlias = Callable[[Rows, Tables], Mapping[str, Interval]]


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and its check.

    where: Section or figure of the paper.
    statistic: What is measured in each run of a case.
    bound: A case holds if the interval of the statistic lies above it, and is refuted if the
        interval lies below it; otherwise it is not clear.
    below: The reverse: a case holds if the interval lies below the bound.
    check: ``check(rows, tables)`` returns the interval of each case.
    """

    text: str
    where: str
    statistic: str
    bound: float
    below: bool
    check: Check

    def holds(self, found: Interval) -> bool | None:
        """Whether a case holds; None if it is not clear."""
        if found.low <= self.bound <= found.high and found.low < found.high:
            return None
        return bool((found.value < self.bound) == self.below)

    def verdict(self, cases: Mapping[str, Interval]) -> str:
        """Whether the claim is reproduced, not reproduced, or in which cases it is not."""
        verdicts = {case: self.holds(found) for case, found in cases.items()}
        good, bad, unclear = (
            [case for case, held in verdicts.items() if held is kind]
            for kind in (True, False, None)
        )
        if len(good) == len(verdicts):
            return REPRODUCED
        if len(bad) == len(verdicts):
            return NOT_REPRODUCED
        lists = (("refuted", bad), (UNCLEAR, unclear))
        listed = "; ".join(f"{kind}: {join_items(names)}" for kind, names in lists if names)
        most = f"{PARTLY} in {len(good)} of {len(verdicts)} cases" if good else UNCLEAR
        return f"{most}; {listed}"

    @property
    def test(self) -> str:
        """The statistic and its bound."""
        return f"{self.statistic}: {'below' if self.below else 'above'} {self.bound:g}"


CLAIMS: list[Claim] = []
"""In the order of their definition."""


def claim(
    text: str, where: str, statistic: str, *, above: float | None = None, below: float | None = None
) -> Callable[[Check], Check]:
    """Register a function as the check of a claim with either bound; see `Claim`."""
    bound = below if above is None else above
    if bound is None:
        raise ValueError("a claim requires a bound")

    def register(check: Check) -> Check:
        CLAIMS.append(Claim(text, where, statistic, bound, below is not None, check))
        return check

    return register


@claim(
    "The r-ANISOMAP algorithm performed reasonably or excellently in all cases",
    "Discussion",
    f"Mantel r (reasonable: {REASONABLE}; excellent: {EXCELLENT})",
    above=REASONABLE,
)
def is_reasonable(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check the accuracy of r-ANISOMAP."""
    return {group: interval(found["r-anisomap"]) for group, found in _runs(rows).items()}


@claim(
    "The best 3D reconstruction was invariably one of the ANISOMAP variants",
    "Discussion",
    "3D: Mantel r of the better ANISOMAP minus that of the better other method, in the same run",
    above=0,
)
def best_is_anisomap(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check which methods are the most accurate in 3D."""
    found = _runs([row for row in rows if row["dimensions"] == 3])
    return {group: interval(_lead(each, _ANISOMAPS)) for group, each in found.items()}


@claim(
    "r-ANISOMAP was consistently among the best performing",
    "Results",
    "Mantel r of r-ANISOMAP minus that of the best other method, in the same run",
    above=-AMONG_BEST,
)
def r_anisomap_among_best(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check the difference between r-ANISOMAP and the best method."""
    return {group: interval(_lead(each, METHODS[:1])) for group, each in _runs(rows).items()}


@claim(
    "Cylinder, locomotion: correlations relatively poor for all reconstruction methods",
    "Discussion",
    "Mantel r of the same cylinder when bombarded minus that when rolling",
    above=SIMILAR,
)
def rolling_cylinder_is_poor(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check the accuracy of the rolling cylinder against that of the bombarded one."""
    return {m: interval(control - r) for m, r, control in _with_control(rows, "mantel_r")}


@claim(
    "Reconstructions of the rolling cylinder were compressed in the axial direction",
    "Discussion, Fig. 4",
    "local axial scale of the rolling cylinder divided by that of the bombarded one",
    below=1 - SIMILAR,
)
def rolling_cylinder_is_compressed(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check the axial compression of the rolling cylinder against that of the bombarded one."""
    pairs = _with_control(rows, "local_axial_scale")
    return {m: interval(scale / control) for m, scale, control in pairs}


@claim(
    "Reconstructions of the rolling cylinder have the topology of the sensors reasonably well",
    "Discussion",
    "order of the lines around the axis, and of the sensors along each line (Figure 4); 1 is "
    "correct, chance gives 0.22 and 0",
    above=LARGE,
)
def rolling_cylinder_keeps_topology(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check the order of the sensors around and along the axis of the rolling cylinder."""
    return {
        f"{m} {direction} the axis": interval(order)
        for direction in ("around", "along")
        for m, order, _control in _with_control(rows, f"order_{direction}")
    }


@claim(
    "Information distance performed well in 2 dimensions",
    "Discussion",
    "Mantel r in 2D",
    above=REASONABLE,
)
def information_distance_is_good_in_2d(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check the accuracy of information distance on flat skins."""
    found = _runs(rows)
    return {s: interval(found[g]["information-distance"]) for s, (g, _3d) in _FLAT_SKINS.items()}


@claim(
    "3D reconstructions by information distance are notably worse than 2D ones",
    "Methods, Fig. 3",
    "flat skins: Mantel r in 2D minus that in 3D, in the same run",
    above=AMONG_BEST,
)
def information_distance_is_worse_in_3d(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check whether information distance is less accurate in 3D."""
    return _drops(rows, ("information-distance",))


@claim(
    "For the other methods, 3D reconstructions are not notably worse than 2D ones",
    "Methods, Fig. 3",
    "flat skins: Mantel r in 2D minus that in 3D, in the same run",
    below=AMONG_BEST,
)
def others_are_not_worse_in_3d(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check whether the other methods are less accurate in 3D."""
    return _drops(rows, [m for m in METHODS if m != "information-distance"])


@claim(
    "All algorithms perform far better than random guessing",
    "Results, Fig. 3",
    "Mantel r minus the maximum of its null distribution",
    above=LARGE,
)
def better_than_random(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check all maps against their null distributions."""
    r, null = _runs(rows), _runs(rows, "null_max")
    return {
        f"{m} on {group}": interval(found[m] - null[group][m])
        for group, found in r.items()
        for m in METHODS
    }


@claim(
    "The faulty sensor 30 is isolated from the others by r-ANISOMAP",
    "Results, Fig. 2",
    "2D, ten sensors in turn: distance of the failing sensor to the nearest one, divided by that "
    "in the same run without the failure",
    above=ISOLATED,
)
def failing_sensor_is_isolated(_: Rows, tables: Tables) -> dict[str, Interval]:
    """Check the isolation of a failing sensor against the same sensor without its failure."""
    return _failures(tables, lambda row: row["isolation"] / row["isolation_before"])


@claim(
    "The reconstruction is robust to unanticipated hardware failure",
    "Abstract",
    "r-ANISOMAP in 2D, ten sensors in turn: Mantel r of the other sensors in the same run without "
    "the failure minus that with it",
    below=SIMILAR,
)
def is_robust(_: Rows, tables: Tables) -> dict[str, Interval]:
    """Check the accuracy of the patch with a failing sensor against that without."""
    return _failures(tables, lambda row: row["mantel_r_before"] - row["mantel_r"])


@claim(
    "Information distance has a tendency to spherise reconstructions",
    "Methods, Fig. 7",
    "3D: straightness of straight lines of sensors (Figure 7), by r-ANISOMAP minus by information "
    "distance, in the same run",
    above=SIMILAR,
)
def information_distance_spherises(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check whether information distance bends straight lines of sensors."""
    found = _runs(rows, "straightness")
    bodies = ("cylinder", "y-shape", "plane")
    runs = ((body, found[f"{body}-bombardment"]) for body in bodies)
    return {body: interval(run["r-anisomap"] - run["information-distance"]) for body, run in runs}


@claim(
    "6 and 8 bins produced qualitatively similar results",
    "Methods",
    "largest absolute difference in Mantel r from 4 bins, in the same run",
    below=SIMILAR,
)
def bins_do_not_matter(_: Rows, tables: Tables) -> dict[str, Interval]:
    """Check the effect of the number of bins."""
    rows = all_scores(tables)
    four, *more = (
        _runs([row for row in rows if row["bins"] == bins], methods=METHODS[1:])
        for bins in (DEFAULT_BINS, *MORE_BINS)
    )
    return {
        f"{m} on {group}": interval(np.max([abs(one[group][m] - r) for one in more], axis=0))
        for group, found in four.items()
        for m, r in found.items()
    }


@claim(
    "All pairs of points, instead of neighbours only, give an increase in accuracy",
    "Methods",
    "Mantel r of r-ANISOMAP minus that with the edges of a neighbour graph only, in the same run",
    above=0,
)
def all_pairs_are_better(_: Rows, tables: Tables) -> dict[str, Interval]:
    """Check r-ANISOMAP against its ablation to neighbours."""
    return _gains(tables, ABLATIONS[0])


@claim(
    "Shorter chains of distances refine over-estimated long distances",
    "Discussion",
    "Mantel r of r-ANISOMAP minus that without shortest paths, in the same run",
    above=0,
)
def metricising_is_better(_: Rows, tables: Tables) -> dict[str, Interval]:
    """Check r-ANISOMAP against its ablation without a metric."""
    return _gains(tables, ABLATIONS[1])


@claim(
    "If one sensor is linear and another a radial basis function around an optimal response, "
    "mutual information is more likely than r to identify their relation",
    "Discussion",
    "share of radial-basis sensors (optimum: median contact) whose most similar linear sensor "
    f"measures the same quantity, noise of {CLAIMED_NOISE:.0%}: by mutual information minus by r",
    above=SIMILAR,
)
def information_identifies_unlike_sensors(_: Rows, tables: Tables) -> dict[str, Interval]:
    """Check which similarity identifies linear and radial-basis sensors of one quantity."""
    rows = [
        row | {"group": row["run"]}
        for row in tables["unlike-responses"].records()
        if (row["optimum"], row["noise"]) == (MEDIAN, CLAIMED_NOISE)
    ]
    linear, general = _ANISOMAPS
    return {
        run: interval(found[general] - found[linear])
        for run, found in _runs(rows, "identified", _ANISOMAPS).items()
    }


@claim(
    "High distance-correlation corresponds to a map that respects the topology",
    "Results",
    "rank correlation between Mantel r and the share of neighbours preserved, over the maps of "
    "all methods and runs",
    above=LARGE,
)
def r_implies_topology(rows: Rows, _: Tables) -> dict[str, Interval]:
    """Check whether maps with a higher r preserve more neighbours."""
    r, kept = _runs(rows), _runs(rows, "neighbours_kept")

    def correlation(runs: NDArray[np.float64]) -> float:
        return float(spearmanr(runs[..., 0].ravel(), runs[..., 1].ravel()).statistic)

    return {
        group: interval(
            np.stack([[found[m], kept[group][m]] for m in METHODS], axis=0).transpose(2, 0, 1),
            correlation,
        )
        for group, found in r.items()
    }


Runs: TypeAlias = dict[str, dict[str, NDArray[np.float64]]]


def _runs(rows: Rows, value: str = "mantel_r", methods: Sequence[str] = METHODS) -> Runs:
    """Return a value of each run, by group and method, in the same order of runs."""
    return {
        group: {m: np.array([row[value] for row in each if row["method"] == m]) for m in methods}
        for group, each in by_group(rows).items()
    }


def _lead(found: Mapping[str, NDArray[np.float64]], methods: Sequence[str]) -> NDArray[np.float64]:
    """Best value of some methods minus the best of the others, by run."""
    best, rest = (
        np.max([found[m] for m in METHODS if (m in methods) == inside], axis=0)
        for inside in (True, False)
    )
    return np.asarray(best - rest)


def _with_control(
    rows: Rows, value: str
) -> list[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """Return a value of the rolling and of the bombarded cylinder, for each method."""
    found = _runs(rows, value)
    return [(m, found[_ROLLING][m], found[_BOMBARDED][m]) for m in METHODS]


def _drops(rows: Rows, methods: Sequence[str]) -> dict[str, Interval]:
    """Compute how much Mantel r is lower in 3D than in 2D, on flat skins."""
    found = _runs(rows)
    return {
        f"{m} on {skin}": interval(found[in_2d][m] - found[in_3d][m])
        for skin, (in_2d, in_3d) in _FLAT_SKINS.items()
        for m in methods
    }


def _failures(tables: Tables, value: Callable[[Mapping[str, Any]], float]) -> dict[str, Interval]:
    """Compute a value over the sensors that fail in turn, in each run."""
    rows = tables["failures"].records()
    return {
        f"run {number}": interval([value(row) for row in rows if row["run"] == number])
        for number in PATCH_RUNS
        if number >= FIRST_FAILED_RUN
    }


def _gains(tables: Tables, ablation: str) -> dict[str, Interval]:
    """Compute the gain of r-ANISOMAP over an ablation, on the paper's runs."""
    names = {case.name for case in CASES} | {"patch, 2D"}
    scores = [row for row in tables["rival-scores"].records() if row["run"] in names]
    rows = [row | {"group": row["run"]} for row in scores]
    found = _runs(rows, methods=("r-anisomap", ablation))
    return {run: interval(each["r-anisomap"] - each[ablation]) for run, each in found.items()}


_CASE_COLUMNS = {
    "claim": "claim of the paper",
    "case": "run, method or sensor",
    "value": "statistic: mean over the runs",
    "low": "lower end of the 95 % bootstrap interval",
    "high": "upper end",
    "holds": "yes, no or not clear",
}
COLUMNS = {
    "claim": "claim of the paper",
    "where": "section or figure of the paper",
    "test": "statistic, and the bound above or below which its interval has to lie; an interval on "
    "the other side of the bound refutes the claim",
    "measured": "mean over the runs, and 95 % bootstrap interval; the range of the means for more "
    f"than {_MAX_LISTED} cases",
    "cases": "number of cases in which the criterion is met",
    "verdict": "whether the claim is reproduced; cases that are refuted, and not clear",
}


@experiment(
    "claims",
    "Claims of the paper and results",
    "Each testable claim of the paper, with a statistic and a bound that were chosen here. A case "
    "holds if the 95 % bootstrap interval of the mean over runs (seeds; sensors that fail) lies on "
    "the claimed side of the bound, is refuted if it lies on the other side, and is not clear "
    "otherwise. Comparisons are within runs of the same seed.\n\nThe paper's supplement with the "
    "parameters of its simulation could not be had. A claim that is not reproduced may therefore "
    "depend on these parameters; the sensitivity analyses below show their effects.",
    needs=(*SCORES, "failing-sensor", "rivals", "unlike-responses"),
)
def claims_table(_: Settings, tables: Tables) -> Outcome:
    """Check every claim."""
    scores = [row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS]
    rows: list[Row] = []
    cases: list[Row] = []
    for one in CLAIMS:
        found = one.check(scores, tables)
        for case, each in found.items():
            holds = {True: "yes", False: "no", None: UNCLEAR}[one.holds(each)]
            cases.append((one.text, case, each.value, each.low, each.high, holds))
        n_held = sum(one.holds(each) is True for each in found.values())
        count = f"{n_held} of {len(found)}"
        rows.append((one.text, one.where, one.test, _listed(found), count, one.verdict(found)))
    caption = "Verdict on each claim."
    every = Table("cases", "All cases of all claims.", _CASE_COLUMNS, tuple(cases), shown=False)
    return Outcome(tables=(Table("claims", caption, COLUMNS, tuple(rows)), every))


def _listed(cases: Mapping[str, Interval]) -> str:
    if len(cases) <= _MAX_LISTED:
        return "; ".join(f"{case} {found}" for case, found in cases.items())
    means = [found.value for found in cases.values()]
    return f"means from {min(means):.2f} to {max(means):.2f} in {len(cases)} cases"
