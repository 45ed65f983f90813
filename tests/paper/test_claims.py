"""Every claim of the paper can be reproduced, and can fail."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.paper import Table
from anisomap.paper.accuracy import ALL_PAIRS, DIRECT, SMALLEST
from anisomap.paper.cases import CASES, METHODS
from anisomap.paper.claims import (
    CLAIMS,
    NOT_REPRODUCED,
    REPRODUCED,
    Claim,
    Interval,
    claims_table,
    interval,
)
from anisomap.paper.experiment import Settings

RUNS = [(case.name, 3) for case in CASES]
RUNS += [("plane-bombardment, 2D", 2), ("patch, 2D", 2), ("patch, 3D", 3)]
SEEDS = (1, 2, 3)


def rows(bins, score):
    """Return scores of all methods and runs; `score` takes run, method, dimensions and bins."""
    for run, k in RUNS:
        for seed in SEEDS:
            for method in METHODS:
                r = score(run, method, k, bins) + 0.001 * seed
                names = ("run", "seed", "method", "dimensions", "bins", "mantel_r")
                yield dict(zip(names, (run, seed, method, k, bins, r), strict=True))


def as_in_the_paper(run, method, dimensions, _bins):
    r = {"r-anisomap": 0.98, "i-anisomap": 0.97, "information-distance": 0.95, "isomap": 0.95}
    rolling = 0.2 * (run == "cylinder-locomotion")
    spherised = 0.05 * (method == "information-distance" and dimensions == 3)
    return r[method] - rolling - spherised


def contrary_to_the_paper(run, method, dimensions, bins):
    r = {"r-anisomap": 0.1, "i-anisomap": 0.11, "information-distance": 0.2, "isomap": 0.3}
    rolling = 0.2 * (run == "cylinder-locomotion")
    worse_in_3d = 0.1 * (dimensions == 2) * (1 - 2 * (method == "information-distance"))
    return r[method] + rolling + worse_in_3d + 0.2 * (bins > 4)


def tables(score, *, good):
    """Return the tables that the claims read, with values for or against the claims."""
    found = [row for bins in (4, 6, 8) for row in rows(bins, score)]
    scores = {f"scores-{case.name}": [r for r in found if case.name in r["run"]] for case in CASES}
    scores["scores-patch"] = [row for row in found if "patch" in row["run"]]
    for row in found:
        rolling = row["run"] == "cylinder-locomotion"
        spherised = row["method"] == "information-distance"
        row |= {
            "null_max": 0.2 if good else 0.05,
            "neighbours_kept": row["mantel_r"] * (1 if good else -1),
            "local_axial_scale": 0.3 if good and rolling else 0.6,
            "order_around": 0.9 if good else 0.3,
            "order_along": 0.8 if good else 0.1,
            "sphericity": 0.7 if good == spherised else 0.3,
        }
    failed = {"isolation": 4.0, "mantel_r": 0.9} if good else {"isolation": 1.0, "mantel_r": 0.5}
    before = {"isolation_before": 1.0, "mantel_r_before": 0.91}
    gain = 0.1 if good else -0.1
    others = {
        "failures-patch": [{"run": run} | failed | before for run in (4, 5) for _ in SEEDS],
        "ablations-patch": [
            {"run": "patch, 2D", "edges": edges, "mantel_r": 0.8 - gain * (edges != ALL_PAIRS)}
            for edges in (ALL_PAIRS, SMALLEST, "k = 4", "k = 8", DIRECT)
        ],
        "responses-plane-bombardment": [
            {"run": "plane", "method": method, "optimum": 0.5, "noise": 0.1, "identified": share}
            for method, share in zip(METHODS[:2], (0.5, 1.0 if good else 0.3), strict=True)
        ],
    }
    return {
        name: Table(name, "", dict.fromkeys(each[0], ""), tuple(tuple(r.values()) for r in each))
        for name, each in (scores | others).items()
    }


@pytest.mark.parametrize(
    ("score", "expected"), [(as_in_the_paper, REPRODUCED), (contrary_to_the_paper, NOT_REPRODUCED)]
)
def test_every_claim_can_be_reproduced_and_can_fail(score, expected):
    found = tables(score, good=expected == REPRODUCED)
    table, cases = claims_table(Settings(), found)
    verdicts = {row["claim"]: row["verdict"] for row in table.records()}
    assert set(verdicts) == {claim.text for claim in CLAIMS}
    assert verdicts == dict.fromkeys(verdicts, expected)
    assert {row["holds"] for row in cases.records()} == {"yes" if expected == REPRODUCED else "no"}


def verdict(*, below=None, **cases):
    return Claim("", "", "", dict, above=0.5, below=below).verdict(cases)


def test_a_case_is_unclear_where_its_interval_includes_the_bound():
    high, low, wide = Interval(0.8, 0.7, 0.9), Interval(0.2, 0.1, 0.3), Interval(0.6, 0.4, 0.7)
    assert verdict(a=high, b=high) == "reproduced"
    assert verdict(a=low, b=low) == "not reproduced"
    assert verdict(below=0.5, a=low) == "reproduced"
    assert verdict(below=0.5, a=high) == "not reproduced"
    assert verdict(a=high, b=low, c=wide) == (
        "partly reproduced in 1 of 3 cases; refuted: b; not clear: c"
    )
    assert verdict(a=low, b=wide) == "not clear; refuted: a; not clear: b"


def test_what_is_invariable_has_to_hold_in_every_run():
    claim = Claim("", "", "", dict, every=True)
    found = claim.check({"a": np.array([0.1, 0.2]), "b": np.array([0.9, 0.8, -0.01])})
    assert claim.verdict(found) == "partly reproduced in 1 of 2 cases; refuted: b"


def test_maps_at_chance_are_left_out_and_counted():
    claim = Claim("", "", "", dict, above=0.5)
    chance = np.full(3, np.nan)
    found = claim.check({"a": np.array([0.7, np.nan, 0.9]), "b": chance})
    assert found["a"].value == pytest.approx(0.8)
    assert claim.verdict(found) == "reproduced; at chance: b"
    assert claim.verdict(claim.check({"b": chance})) == "not clear; at chance: b"
    one_of_three = np.array([0.7, np.nan, np.nan])
    assert claim.verdict(claim.check({"a": one_of_three})) == "not clear; at chance: a"
    score = as_in_the_paper
    beaten = tables(lambda *of: 0.01 if of[1] == "isomap" else score(*of), good=True)
    rows = claims_table(Settings(), beaten).__next__().records()
    shown = {row["claim"]: row["verdict"] for row in rows}
    compressed = next(text for claim, text in shown.items() if "compressed" in claim)
    assert compressed == "reproduced; at chance: isomap"


@given(st.integers(0, 100))
def test_the_interval_of_a_mean_agrees_with_its_standard_error(seed):
    values = np.random.default_rng(seed).normal(size=200)
    found = interval(values)
    assert found.low < found.value < found.high
    assert found.value == pytest.approx(values.mean())
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 200**0.5, rel=0.15)
    assert interval([0.3, 0.3, 0.3]) == Interval(*[pytest.approx(0.3)] * 3)
