"""The paper's testable claims, their checks against the experiments, and their verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from anisomap.defaults import DEFAULT_BINS
from anisomap.paper.accuracy import SCORES, all_scores, by_group
from anisomap.paper.cases import FIRST_FAILED_RUN, METHODS
from anisomap.paper.experiment import Outcome, Row, Settings, Table, Tables, experiment, mean_by
from anisomap.paper.sensitivity import MEDIAN

# The paper gives no numbers for its claims; all thresholds are chosen by hand.
REASONABLE, EXCELLENT = 0.7, 0.9  # Mantel r
AMONG_BEST = 0.02  # largest difference in Mantel r
SIMILAR = 0.05  # largest difference in Mantel r
ISOLATED = 2.0  # distance to the nearest sensor, relative to the median of the others
SPHERICAL = 0.95  # spread of radii, relative to the true spread
RELATED = 0.5  # rank correlation

REPRODUCED, NOT_REPRODUCED, PARTLY = "reproduced", "not reproduced", "partly reproduced"

_ANISOMAPS = METHODS[:2]
_ROLLING_CYLINDER = "cylinder-locomotion"
_FLAT_SKINS = {
    "plane": ("plane-bombardment, 2D", "plane-bombardment"),
    "patch": ("patch, 2D", "patch, 3D"),
}


@dataclass(frozen=True)
class ClaimCheck:
    """Result of checking a claim.

    measured: Measured values.
    held: Whether the claim holds in each case; at least one case.
    """

    measured: str
    held: Mapping[str, bool]

    def __post_init__(self) -> None:
        if not self.held:
            raise ValueError("a claim must be checked in at least one case")

    @property
    def verdict(self) -> str:
        """Whether the claim is reproduced, not reproduced, or in which cases it is."""
        good = [case for case, held in self.held.items() if held]
        bad = [case for case, held in self.held.items() if not held]
        if not bad:
            return REPRODUCED
        if not good:
            return NOT_REPRODUCED
        if len(bad) < len(good):
            return f"{PARTLY} in {len(good)} of {len(self.held)} cases: not {'; '.join(bad)}"
        return f"{PARTLY} in {len(good)} of {len(self.held)} cases: {'; '.join(good)}"


Rows: TypeAlias = Sequence[dict[str, Any]]
"""Scores of all maps, see `anisomap.paper.accuracy.all_scores`."""

Check: TypeAlias = Callable[[Rows, Tables], ClaimCheck]


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and its check.

    where: Section or figure of the paper.
    test: Criterion in numbers.
    check: ``check(rows, tables)`` returns a `ClaimCheck`.
    """

    text: str
    where: str
    test: str
    check: Check


CLAIMS: list[Claim] = []
"""In the order of their definition."""


def claim(text: str, where: str, test: str) -> Callable[[Check], Check]:
    """Register a function as the check of a claim; the arguments are the fields of `Claim`."""

    def register(check: Check) -> Check:
        CLAIMS.append(Claim(text, where, test, check))
        return check

    return register


@claim(
    "The r-ANISOMAP algorithm performed reasonably or excellently in all cases",
    "Discussion",
    f"mean Mantel r of at least {REASONABLE} (reasonable; excellent: {EXCELLENT})",
)
def is_reasonable(rows: Rows, _: Tables) -> ClaimCheck:
    """Check the accuracy of r-ANISOMAP in each group."""
    means = {group: found["r-anisomap"] for group, found in _means(rows).items()}
    return ClaimCheck(_listed(means), {group: r >= REASONABLE for group, r in means.items()})


@claim(
    "The best 3D reconstruction was invariably one of the ANISOMAP variants",
    "Discussion",
    "r- or I-ANISOMAP has the highest Mantel r in 3D in every run",
)
def best_is_anisomap(rows: Rows, _: Tables) -> ClaimCheck:
    """Check which method is the most accurate in 3D in each run."""
    won: dict[str, list[bool]] = {}
    for group, runs in _runs_in_3d(rows).items():
        won[group] = [max(run, key=run.__getitem__) in _ANISOMAPS for run in runs]
    shares = {group: float(np.mean(each)) for group, each in won.items()}
    measured = "share of runs: " + _listed(shares)
    return ClaimCheck(measured, {group: share == 1 for group, share in shares.items()})


@claim(
    "r-ANISOMAP was consistently among the best performing",
    "Results",
    f"mean Mantel r at most {AMONG_BEST} below that of the best method",
)
def r_anisomap_among_best(rows: Rows, _: Tables) -> ClaimCheck:
    """Check the difference between r-ANISOMAP and the best method."""
    behind = {
        group: max(found.values()) - found["r-anisomap"] for group, found in _means(rows).items()
    }
    measured = "difference of the mean r from the best: " + _listed(behind)
    return ClaimCheck(measured, {group: gap <= AMONG_BEST for group, gap in behind.items()})


@claim(
    "Cylinder, locomotion: correlations relatively poor for all reconstruction methods",
    "Discussion",
    "mean Mantel r lower than in all other groups, for each method",
)
def rolling_cylinder_is_poor(rows: Rows, _: Tables) -> ClaimCheck:
    """Check whether the rolling cylinder has the least accurate maps."""
    means = _means(rows)
    rolling = means.pop(_ROLLING_CYLINDER)
    others = {m: min(found[m] for found in means.values()) for m in METHODS}
    measured = "; ".join(f"{m} {rolling[m]:.2f} (others at least {others[m]:.2f})" for m in METHODS)
    return ClaimCheck(measured, {m: rolling[m] < others[m] for m in METHODS})


@claim(
    "Reconstructions of the rolling cylinder were compressed in the axial direction",
    "Discussion, Fig. 4",
    "local axial scale below 1: axial neighbours too close relative to circumferential ones",
)
def rolling_cylinder_is_compressed(_: Rows, tables: Tables) -> ClaimCheck:
    """Check the axial compression of the rolling cylinder."""
    rows = [row for row in tables["figure-4"].records() if row["scenario"] == "locomotion"]
    measured = "; ".join(
        f"{row['method']} {row['local_axial_scale']:.2f} locally, {row['axial_scale']:.2f} globally"
        for row in rows
    )
    return ClaimCheck(measured, {row["method"]: row["local_axial_scale"] < 1 for row in rows})


@claim(
    "3D reconstructions by information distance are notably worse than 2D ones; not so for "
    "the other methods",
    "Methods, Fig. 3",
    f"flat skins: mean r in 2D minus mean r in 3D above {AMONG_BEST} for information distance only",
)
def flat_maps_are_better(rows: Rows, _: Tables) -> ClaimCheck:
    """Check which methods are less accurate in 3D than in 2D on flat skins."""
    means = _means(rows)
    measured, held = [], {}
    for skin, (in_2d, in_3d) in _FLAT_SKINS.items():
        drops = {m: means[in_2d][m] - means[in_3d][m] for m in METHODS}
        measured.append(f"{skin}: " + _listed(drops, 3, ", "))
        worse = {m for m, drop in drops.items() if drop > AMONG_BEST}
        held[skin] = worse == {"information-distance"}
    return ClaimCheck("mean r in 2D minus mean r in 3D, " + "; ".join(measured), held)


@claim(
    "All algorithms perform far better than random guessing",
    "Results, Fig. 3",
    "Mantel r above the maximum of the null distribution for every map",
)
def better_than_random(rows: Rows, _: Tables) -> ClaimCheck:
    """Check all maps against their null distributions."""
    held: dict[str, bool] = {}
    margins: list[float] = []
    for row in rows:
        case = f"{row['method']} on {row['group']}"
        held[case] = held.get(case, True) and row["mantel_r"] > row["null_max"]
        margins.append(row["mantel_r"] - row["null_max"])
    measured = (
        f"r above the maximum of the null distribution in {sum(m > 0 for m in margins)} of "
        f"{len(margins)} maps; smallest difference {min(margins):.2f}"
    )
    return ClaimCheck(measured, held)


@claim(
    "The faulty sensor 30 is isolated from the others by r-ANISOMAP",
    "Results, Fig. 2",
    f"2D maps: distance to the nearest sensor at least {ISOLATED:g} times the median of the "
    "others in runs 4 and 5, and less in runs 1 to 3",
)
def failing_sensor_is_isolated(_: Rows, tables: Tables) -> ClaimCheck:
    """Check the isolation of sensor 30 after its failure; before it is the control."""
    isolation = {row["run"]: row["isolation"] for row in _patch_maps(tables)}
    measured = "isolation: " + _listed({f"run {run}": value for run, value in isolation.items()})
    control = all(value < ISOLATED for run, value in isolation.items() if run < FIRST_FAILED_RUN)
    held = {
        f"run {run}": control and value >= ISOLATED
        for run, value in isolation.items()
        if run >= FIRST_FAILED_RUN
    }
    return ClaimCheck(measured, held)


@claim(
    "The reconstruction is robust to unanticipated hardware failure",
    "Abstract",
    f"r-ANISOMAP in 2D: Mantel r of runs 4 and 5 at most {SIMILAR} below the mean of runs 1 to 3",
)
def is_robust(_: Rows, tables: Tables) -> ClaimCheck:
    """Check the accuracy of the patch after the failure of sensor 30."""
    r = {row["run"]: row["mantel_r"] for row in _patch_maps(tables)}
    before = _mean(value for run, value in r.items() if run < FIRST_FAILED_RUN)
    after = {f"run {run}": value for run, value in r.items() if run >= FIRST_FAILED_RUN}
    measured = f"mean r of runs 1 to 3: {before:.3f}; " + _listed(after, 3)
    return ClaimCheck(measured, {run: value >= before - SIMILAR for run, value in after.items()})


@claim(
    "Information distance has a tendency to spherise reconstructions",
    "Methods, Fig. 7",
    f"spread of radii below {SPHERICAL} of the true spread, and below that of r-ANISOMAP",
)
def information_distance_spherises(_: Rows, tables: Tables) -> ClaimCheck:
    """Check whether maps of information distance are closer to a sphere than the truth."""
    rows = tables["figure-7"].records()
    measured = "spread of radii relative to the true spread: " + _listed(
        {row["body"]: row["information-distance"] for row in rows}
    )
    held = {
        row["body"]: row["information-distance"] < min(SPHERICAL, row["r-anisomap"]) for row in rows
    }
    return ClaimCheck(measured, held)


@claim(
    "6 and 8 bins produced qualitatively similar results",
    "Methods",
    f"mean Mantel r within {SIMILAR} of that with 4 bins",
)
def bins_do_not_matter(_: Rows, tables: Tables) -> ClaimCheck:
    """Check the effect of the number of bins."""
    rows = tables["bins"].records()
    changes = {
        m: max(row["largest change"] for row in rows if row["method"] == m) for m in METHODS[1:]
    }
    held = {f"{row['method']} on {row['run']}": row["largest change"] <= SIMILAR for row in rows}
    return ClaimCheck("largest change of mean r: " + _listed(changes), held)


@claim(
    "If one sensor is linear and another a radial basis function around an optimal response, "
    "mutual information is more likely than r to identify their relation",
    "Methods",
    "share of radial-basis sensors, with the optimum at the median contact, whose most similar "
    "linear sensor measures the same quantity: higher by mutual information than by r",
)
def information_identifies_unlike_sensors(_: Rows, tables: Tables) -> ClaimCheck:
    """Check which similarity identifies linear and radial-basis sensors of one quantity."""
    records = [row for row in tables["unlike-responses"].records() if row["optimum"] == MEDIAN]
    shares = {
        (run, method): _mean(
            row["identified"] for row in records if (row["run"], row["method"]) == (run, method)
        )
        for run in dict.fromkeys(row["run"] for row in records)
        for method in _ANISOMAPS
    }
    linear, general = _ANISOMAPS
    held = {run: shares[run, general] > shares[run, linear] for run, _ in shares}
    measured = "share by r and by mutual information: " + "; ".join(
        f"{run} {shares[run, linear]:.2f}, {shares[run, general]:.2f}" for run in held
    )
    return ClaimCheck(measured, held)


@claim(
    "High distance-correlation corresponds to a map that respects the topology",
    "Results",
    "rank correlation between Mantel r and the share of neighbours preserved, over the maps of "
    f"a group, above {RELATED}",
)
def r_implies_topology(rows: Rows, _: Tables) -> ClaimCheck:
    """Check whether maps with a higher r preserve more neighbours."""
    found: dict[str, float] = {}
    for group, each in by_group(rows).items():
        r, kept = (
            np.argsort(np.argsort([row[name] for row in each]))
            for name in ("mantel_r", "neighbours_kept")
        )
        found[group] = float(np.corrcoef(r, kept)[0, 1])
    measured = "rank correlation of r with the share of neighbours preserved: " + _listed(found)
    return ClaimCheck(measured, {group: value > RELATED for group, value in found.items()})


def _means(rows: Rows) -> dict[str, dict[str, float]]:
    """Return the mean Mantel r by group and method."""
    return {group: mean_by(found, "method", "mantel_r") for group, found in by_group(rows).items()}


def _runs_in_3d(rows: Rows) -> dict[str, list[dict[str, float]]]:
    """Return the Mantel r of each run in 3D, by group and method."""
    found: dict[str, dict[tuple[str, int], dict[str, float]]] = {}
    for row in rows:
        if row["dimensions"] == 3:
            run = found.setdefault(row["group"], {}).setdefault((row["run"], row["seed"]), {})
            run[row["method"]] = row["mantel_r"]
    return {group: list(runs.values()) for group, runs in found.items()}


def _patch_maps(tables: Tables) -> list[dict[str, Any]]:
    return [
        row
        for row in tables["figure-2"].records()
        if row["method"] == "r-anisomap" and row["dimensions"] == 2
    ]


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _listed(values: Mapping[str, float], digits: int = 2, separator: str = "; ") -> str:
    return separator.join(f"{name} {value:.{digits}f}" for name, value in values.items())


COLUMNS = {
    "claim": "claim of the paper",
    "where": "section or figure of the paper",
    "test": "criterion in numbers",
    "measured": "measured values",
    "cases": "number of cases in which the criterion is met",
    "verdict": "whether the claim is reproduced, and in which cases",
}


@experiment(
    "claims",
    "Claims of the paper and results",
    "Each testable claim of the paper, with a criterion in numbers that was chosen here. The "
    "paper's supplement with the parameters of its simulation could not be had. A claim that "
    "is not reproduced may therefore depend on these parameters; the sensitivity analyses below "
    "show their effects.",
    needs=(*SCORES, "figure-2", "figure-4", "figure-7", "bins", "unlike-responses"),
)
def claims_table(_: Settings, tables: Tables) -> Outcome:
    """Check every claim."""
    scores = [row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS]
    rows: list[Row] = []
    for one in CLAIMS:
        found = one.check(scores, tables)
        cases = f"{sum(found.held.values())} of {len(found.held)}"
        rows.append((one.text, one.where, one.test, found.measured, cases, found.verdict))
    caption = "Verdict on each claim."
    return Outcome(tables=(Table("claims", caption, COLUMNS, tuple(rows)),))
