"""Every claim of the paper can be reproduced, and can fail."""

import pytest

from anisomap.paper import Table
from anisomap.paper.cases import CASES, METHODS, PATCH_RUNS
from anisomap.paper.claims import CLAIMS, NOT_REPRODUCED, REPRODUCED, ClaimCheck


def rows_of(score):
    """Return rows of scores; `score` returns Mantel r by group, method and dimensions."""
    runs = [(case.name, case.name, 3) for case in CASES]
    runs.append(("plane-bombardment", "plane-bombardment, 2D", 2))
    runs += [(str(number), f"patch, {k}D", k) for number in PATCH_RUNS for k in (2, 3)]
    return [
        {
            "run": run,
            "group": group,
            "seed": seed,
            "method": method,
            "dimensions": k,
            "mantel_r": score(group, method, k) + 0.001 * seed,
        }
        for run, group, k in runs
        for seed in (1, 2)
        for method in METHODS
    ]


def tables(*, isolation, patch_r, axial_scale, spread, change, identified=(0.5, 1.0)):
    maps = enumerate(zip(isolation, patch_r, strict=True), start=1)
    common = {"method": "r-anisomap", "dimensions": 2}
    scales = {"scenario": "locomotion", "local_axial_scale": axial_scale}
    spreads = {"r-anisomap": 1.0, "information-distance": spread}
    unlike = zip(METHODS[:2], identified, strict=True)
    rows = {
        "figure-2": [common | {"run": i, "isolation": a, "mantel_r": r} for i, (a, r) in maps],
        "figure-4": [scales | {"method": m, "axial_scale": axial_scale} for m in METHODS],
        "figure-7": [spreads | {"body": body} for body in ("cylinder", "plane")],
        "bins": [{"run": "plane", "method": m, "largest change": change} for m in METHODS[1:]],
        "unlike-responses": [
            {"run": "plane", "method": m, "optimum": 0.5, "identified": share}
            for m, share in unlike
        ],
    }
    return {
        name: Table(name, "", dict.fromkeys(found[0], ""), tuple(tuple(r.values()) for r in found))
        for name, found in rows.items()
    }


def as_in_the_paper(group, method, dimensions):
    r = {"r-anisomap": 0.98, "i-anisomap": 0.97, "information-distance": 0.95, "isomap": 0.95}
    rolling = 0.2 * (group == "cylinder-locomotion")
    spherised = 0.05 * (method == "information-distance" and dimensions == 3)
    return r[method] - rolling - spherised


def contrary_to_the_paper(group, method, _dimensions):
    r = {"r-anisomap": 0.1, "i-anisomap": 0.11, "information-distance": 0.2, "isomap": 0.3}
    return r[method] + 0.2 * (group == "cylinder-locomotion")


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.check.__name__)
def test_every_claim_can_be_reproduced_and_can_fail(claim):
    good = [
        row | {"null_max": 0.2, "neighbours_kept": row["mantel_r"]}
        for row in rows_of(as_in_the_paper)
    ]
    found = tables(
        isolation=(1, 1, 1, 3, 3), patch_r=[0.9] * 5, axial_scale=0.5, spread=0.5, change=0.01
    )
    assert claim.check(good, found).verdict == REPRODUCED
    bad = [
        row | {"null_max": 0.9, "neighbours_kept": -row["mantel_r"]}
        for row in rows_of(contrary_to_the_paper)
    ]
    found = tables(
        isolation=[1] * 5,
        patch_r=(0.9, 0.9, 0.9, 0.5, 0.5),
        axial_scale=1.5,
        spread=1.5,
        change=0.3,
        identified=(1.0, 1.0),
    )
    assert claim.check(bad, found).verdict == NOT_REPRODUCED


def test_a_sensor_that_is_isolated_while_it_works_is_not_isolated_by_its_failure():
    (claim,) = (claim for claim in CLAIMS if "sensor 30" in claim.text)
    found = tables(isolation=(3, 1, 1, 3, 3), patch_r=[0.9] * 5, axial_scale=1, spread=1, change=0)
    assert claim.check([], found).verdict == NOT_REPRODUCED


def test_a_verdict_names_the_smaller_group_of_cases():
    def verdict(**held):
        return ClaimCheck("", held).verdict

    assert verdict(a=True, b=True) == "reproduced"
    assert verdict(a=False, b=False) == "not reproduced"
    assert verdict(a=True, b=False, c=False) == "partly reproduced in 1 of 3 cases: a"
    assert verdict(a=True, b=True, c=True, d=False, e=False) == (
        "partly reproduced in 3 of 5 cases: not d; e"
    )
    with pytest.raises(ValueError, match="at least one case"):
        verdict()
