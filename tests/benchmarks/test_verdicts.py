"""The suite of verdicts contains what it says, and counts failures as defined."""

import math

import numpy as np
import pandas as pd
import pytest
from benchmarks.harness import write_csv
from benchmarks.skins.footprints import FOOTPRINTS
from benchmarks.verdicts.trust import COLUMNS, LEVELS, draw, judged, read_outcomes, table
from benchmarks.verdicts.trust_recordings import FAULTS, Case, damaged, settings

import anisomap
from anisomap.simulation import BODIES, SCENARIOS
from anisomap.simulation import FAULTS as SENSOR_FAULTS

GOOD = dict.fromkeys(COLUMNS, 1.0) | {
    "source": "2001", "name": "good", "group": "simulated", "kind": "pulses", "fault": "",
    "level": "usable", "expected": 0.3, "r": 0.99, "error": 0.2, "reasons": "",
}  # fmt: skip
BAD = GOOD | {
    "name": "bad", "fault": "dead:5%", "level": "not usable", "expected": 2.0, "r": 0.5,
    "error": 3.0, "region": math.nan,
}  # fmt: skip


def skin():
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 5, (30, 2))
    touches = rng.uniform(0, 5, (400, 1, 2))
    readings = np.maximum(0, 1.5 - np.linalg.norm(touches - places, axis=2))
    return anisomap.Recording(readings, positions=places, rate_hz=10.0)


def test_all_bodies_scenarios_and_faults_take_part():
    used = settings()
    assert {one.body for one in used} == set(BODIES)
    assert {one.scenario for one in used} == {*SCENARIOS, *FOOTPRINTS}
    assert {fault.partition(":")[0] for fault in FAULTS} == {*SENSOR_FAULTS}
    assert len(set(used)) == len(used)


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_every_stimulus_touches_all_places(name):
    places = np.random.default_rng(2).uniform(0, 6, (40, 3)) * [1, 1, 0.3]
    readings = FOOTPRINTS[name](places, 3000, np.random.default_rng(3))
    assert readings.shape == (3000, 40)
    assert np.isfinite(readings).all()
    assert (np.ptp(readings, axis=0) > 0).mean() > 0.9
    again = FOOTPRINTS[name](places, 3000, np.random.default_rng(3))
    np.testing.assert_array_equal(readings, again)


@pytest.mark.parametrize("fault", ["swapped:10%", "shifted:20%"])
def test_positions_follow_exchanged_wires(fault):
    before = skin()
    (case,) = damaged("x", before, 2, fault, 1)
    after = case.recording
    rows = [
        np.flatnonzero((column == before.readings.T).all(axis=1)) for column in after.readings.T
    ]
    np.testing.assert_array_equal(after.positions, before.positions[np.concatenate(rows)])
    assert (after.positions != before.positions).any()


@pytest.mark.parametrize("fault", ["nan-bursts:30%", "duplicated:5%"])
def test_recordings_of_a_suite_are_complete(fault):
    (case,) = damaged("x", skin(), 2, fault, 1)
    assert np.isfinite(case.recording.readings).all()


def test_a_recording_is_mapped_and_judged():
    outcome = judged(Case("x", skin(), 2), "7")
    assert outcome.keys() == set(COLUMNS)
    assert (outcome["source"], outcome["name"]) == ("7", "x")
    assert outcome["level"] in LEVELS
    assert 0 < outcome["r"] <= 1


@pytest.mark.parametrize(
    ("outcome", "changed", "reassured", "alarmed"),
    [
        (GOOD, {}, False, False),
        (BAD, {}, False, False),
        (GOOD, {"level": "not usable"}, False, True),
        (GOOD, {"level": "usable for neighbours"}, False, False),
        (GOOD, {"level": "cannot tell"}, False, False),
        (BAD, {"level": "usable"}, True, False),
        (GOOD, {"r": 0.89}, True, False),
        (GOOD, {"error": 1.01}, True, False),
        (GOOD, {"r": 0.96, "level": "not usable"}, False, False),
        (GOOD, {"r": math.nan, "error": math.nan, "level": "refused"}, False, False),
    ],
)
def test_failures_are_counted_as_defined(outcome, changed, reassured, alarmed):
    reassurance, alarms = table(pd.DataFrame([outcome | changed])).split("False alarms:")
    listed = f"- {outcome['name']}: r"
    assert (listed in reassurance, listed in alarms) == (reassured, alarmed)


def test_outcomes_survive_a_file_and_are_drawn(tmp_path):
    write_csv(tmp_path / "trust.csv", COLUMNS, [GOOD.values(), BAD.values()])
    found = read_outcomes(tmp_path / "trust.csv")
    pd.testing.assert_frame_equal(found, pd.DataFrame([GOOD, BAD]), check_dtype=False)
    draw(found, tmp_path / "trust.png")
    assert (tmp_path / "trust.png").stat().st_size > 1000
