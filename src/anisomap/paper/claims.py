"""Every sentence of the paper that can be checked, what we measured, and whether it holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper import claim_evidence
from anisomap.paper.claim_evidence import (
    ALIKE,
    AMONG_BEST,
    EXCELLENT,
    ISOLATED,
    REASONABLE,
    SPHERICAL,
    Evidence,
    Rows,
)
from anisomap.paper.experiment import Experiment, Outcome, Row, Settings, Table, Tables
from anisomap.paper.experiments.quality import SCORES, all_scores

_COLUMNS = {
    "claim": "what the paper says",
    "where": "where in the paper",
    "test": "what we take it to mean in numbers",
    "measured": "what came out",
    "cases": "in how many of the cases it held",
    "verdict": "holds, does not hold, or what it holds only for",
}


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, and how it is checked.

    Parameters
    ----------
    text : str
    where : str
        Section or figure.
    test : str
        What we take it to mean.
    check : callable
        Takes the rows of scores and all tables; gives the evidence.
    """

    text: str
    where: str
    test: str
    check: Callable[[Rows, Tables], Evidence]


CLAIMS = (
    Claim(
        "The r-ANISOMAP algorithm performed reasonably or excellently in all cases",
        "Discussion",
        f"mean Mantel r of at least {REASONABLE} (reasonable; {EXCELLENT} is excellent)",
        claim_evidence.reasonable,
    ),
    Claim(
        "The best 3D reconstruction was invariably one of the ANISOMAP variants",
        "Discussion",
        "in every run, the greatest Mantel r in 3D is r- or I-ANISOMAP's",
        claim_evidence.best_is_anisomap,
    ),
    Claim(
        "r-ANISOMAP was consistently among the best performing",
        "Results",
        f"mean Mantel r at most {AMONG_BEST} behind the best method's",
        claim_evidence.r_among_best,
    ),
    Claim(
        "Cylinder, locomotion: correlations relatively poor for all reconstruction methods",
        "Discussion",
        "mean Mantel r below that of the method on all other runs",
        claim_evidence.rolling_is_poor,
    ),
    Claim(
        "Reconstructions of the rolling cylinder were compressed in the axial direction",
        "Discussion, Fig. 4",
        "neighbours along the axis too close, against those around it: local axial scale below 1",
        claim_evidence.axial,
    ),
    Claim(
        "3D reconstructions by information distance are notably worse than 2D ones; not so for "
        "the other methods",
        "Methods, Fig. 3",
        f"flat skins: r in 2D less that in 3D above {AMONG_BEST} for information distance only",
        claim_evidence.flat_is_better,
    ),
    Claim(
        "All algorithms perform far better than random guessing",
        "Results, Fig. 3",
        "Mantel r above the greatest of all random relabellings, in every map",
        claim_evidence.above_null,
    ),
    Claim(
        "The faulty sensor 30 is isolated from the others by r-ANISOMAP",
        "Results, Fig. 2",
        f"2D: at least {ISOLATED:g} times as far from its nearest as others are, in runs 4 and 5, "
        "and not in runs 1 to 3",
        claim_evidence.isolated,
    ),
    Claim(
        "The reconstruction is robust to unanticipated hardware failure",
        "Abstract",
        f"r-ANISOMAP in 2D: Mantel r of runs 4 and 5 at most {ALIKE} below runs 1 to 3",
        claim_evidence.robust,
    ),
    Claim(
        "Information distance has a tendency to spherise reconstructions",
        "Methods, Fig. 7",
        f"spread of radii below {SPHERICAL} of the truth's, and below r-ANISOMAP's",
        claim_evidence.spherises,
    ),
    Claim(
        "6 and 8 bins produced qualitatively similar results",
        "Methods",
        f"mean Mantel r within {ALIKE} of that with 4 bins",
        claim_evidence.bins_do_not_matter,
    ),
    Claim(
        "High distance-correlation corresponds to a map that respects the topology",
        "Results",
        "over maps of a scenario, r and the share of true neighbours kept go together (rank "
        "correlation above 0.5)",
        claim_evidence.r_means_topology,
    ),
    Claim(
        "Visual and auditory surfaces can be learned from their data, too",
        "Abstract, Introduction",
        f"Mantel r of at least {REASONABLE} for retina and cochlea, in the better dimension",
        claim_evidence.senses,
    ),
)


def claims_table(_: Settings, tables: Tables) -> Outcome:
    """Check every claim."""
    rows = [row for row in all_scores(tables) if row["bins"] == DEFAULT_BINS]
    checked: list[Row] = []
    for claim in CLAIMS:
        found = claim.check(rows, tables)
        cases = f"{sum(found.held.values())} of {len(found.held)}"
        checked.append((claim.text, claim.where, claim.test, found.measured, cases, found.verdict))
    caption = "What the paper says, and what came out."
    return Outcome(tables=(Table("claims", caption, _COLUMNS, tuple(checked)),))


EXPERIMENT = Experiment(
    "claims",
    "What the paper says, and what came out",
    "Each sentence of the paper that can be checked, with what we take it to mean in numbers. The "
    "supplement with the paper's parameters is lost, so where a claim does not hold here, our "
    "physics may differ from theirs: the curves further down show what each parameter decides.",
    claims_table,
    needs=(
        *SCORES,
        "figure-2",
        "figure-4",
        "figure-7",
        "bins",
        "failing-sensor",
        "retina",
        "cochlea",
    ),
)
