"""The paper's testable claims, and the table of their verdicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper import claim_checks
from anisomap.paper.claim_checks import (
    AMONG_BEST,
    EXCELLENT,
    ISOLATED,
    REASONABLE,
    RELATED,
    SIMILAR,
    SPHERICAL,
    ClaimCheck,
    Rows,
)
from anisomap.paper.experiment import Experiment, Outcome, Row, Settings, Table, Tables
from anisomap.paper.experiments.accuracy import SCORES, all_scores

COLUMNS = {
    "claim": "claim of the paper",
    "where": "section or figure of the paper",
    "test": "criterion in numbers",
    "measured": "measured values",
    "cases": "number of cases in which the criterion is met",
    "verdict": "whether the claim is reproduced, and in which cases",
}


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and its check.

    Parameters
    ----------
    text : str
    where : str
        Section or figure of the paper.
    test : str
        Criterion in numbers.
    check : callable
        ``check(rows, tables)`` returns a `ClaimCheck`.
    """

    text: str
    where: str
    test: str
    check: Callable[[Rows, Tables], ClaimCheck]


CLAIMS = (
    Claim(
        "The r-ANISOMAP algorithm performed reasonably or excellently in all cases",
        "Discussion",
        f"mean Mantel r of at least {REASONABLE} (reasonable; excellent: {EXCELLENT})",
        claim_checks.is_reasonable,
    ),
    Claim(
        "The best 3D reconstruction was invariably one of the ANISOMAP variants",
        "Discussion",
        "r- or I-ANISOMAP has the highest Mantel r in 3D in every run",
        claim_checks.best_is_anisomap,
    ),
    Claim(
        "r-ANISOMAP was consistently among the best performing",
        "Results",
        f"mean Mantel r at most {AMONG_BEST} below that of the best method",
        claim_checks.r_anisomap_among_best,
    ),
    Claim(
        "Cylinder, locomotion: correlations relatively poor for all reconstruction methods",
        "Discussion",
        "mean Mantel r lower than in all other groups, for each method",
        claim_checks.rolling_cylinder_is_poor,
    ),
    Claim(
        "Reconstructions of the rolling cylinder were compressed in the axial direction",
        "Discussion, Fig. 4",
        "local axial scale below 1: axial neighbours too close relative to circumferential ones",
        claim_checks.rolling_cylinder_is_compressed,
    ),
    Claim(
        "3D reconstructions by information distance are notably worse than 2D ones; not so for "
        "the other methods",
        "Methods, Fig. 3",
        f"flat skins: mean r in 2D minus mean r in 3D above {AMONG_BEST} for information distance "
        "only",
        claim_checks.flat_maps_are_better,
    ),
    Claim(
        "All algorithms perform far better than random guessing",
        "Results, Fig. 3",
        "Mantel r above the maximum of the null distribution for every map",
        claim_checks.better_than_random,
    ),
    Claim(
        "The faulty sensor 30 is isolated from the others by r-ANISOMAP",
        "Results, Fig. 2",
        f"2D maps: distance to the nearest sensor at least {ISOLATED:g} times the median of the "
        "others in runs 4 and 5, and less in runs 1 to 3",
        claim_checks.failing_sensor_is_isolated,
    ),
    Claim(
        "The reconstruction is robust to unanticipated hardware failure",
        "Abstract",
        f"r-ANISOMAP in 2D: Mantel r of runs 4 and 5 at most {SIMILAR} below the mean of runs 1 to "
        "3",
        claim_checks.is_robust,
    ),
    Claim(
        "Information distance has a tendency to spherise reconstructions",
        "Methods, Fig. 7",
        f"spread of radii below {SPHERICAL} of the true spread, and below that of r-ANISOMAP",
        claim_checks.information_distance_spherises,
    ),
    Claim(
        "6 and 8 bins produced qualitatively similar results",
        "Methods",
        f"mean Mantel r within {SIMILAR} of that with 4 bins",
        claim_checks.bins_do_not_matter,
    ),
    Claim(
        "If one sensor is linear and another a radial basis function around an optimal response, "
        "mutual information is more likely than r to identify their relation",
        "Methods",
        "share of radial-basis sensors, with the optimum at the median contact, whose most similar "
        "linear sensor measures the same quantity: higher by mutual information than by r",
        claim_checks.information_identifies_unlike_sensors,
    ),
    Claim(
        "High distance-correlation corresponds to a map that respects the topology",
        "Results",
        "rank correlation between Mantel r and the share of neighbours preserved, over the maps of "
        f"a group, above {RELATED}",
        claim_checks.r_implies_topology,
    ),
)


def claims_table(_: Settings, tables: Tables) -> Outcome:
    """Check every claim."""
    scores = [row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS]
    rows: list[Row] = []
    for claim in CLAIMS:
        found = claim.check(scores, tables)
        cases = f"{sum(found.held.values())} of {len(found.held)}"
        rows.append((claim.text, claim.where, claim.test, found.measured, cases, found.verdict))
    caption = "Verdict on each claim."
    return Outcome(tables=(Table("claims", caption, COLUMNS, tuple(rows)),))


EXPERIMENT = Experiment(
    "claims",
    "Claims of the paper and results",
    "Each testable claim of the paper, with a criterion in numbers that was chosen here. The "
    "paper's supplement with the parameters of its simulation is no longer available. A claim that "
    "is not reproduced may therefore depend on these parameters; the sensitivity analyses below "
    "show their effects.",
    claims_table,
    needs=(*SCORES, "figure-2", "figure-4", "figure-7", "bins", "unlike-responses"),
)
