"""The faults that the benchmark of `anisomap check` seeds are what it says."""

import numpy as np
import pytest
from benchmarks.accuracy.check import (
    LAYOUT_FAULTS,
    MIN_SWAPPED,
    MOVED,
    READING_FAULTS,
    Result,
    Skin,
    table,
)
from benchmarks.harness import read_rows, write_rows
from scipy.spatial.distance import cdist

from skins import flat_skin, triangles

TRUTH = triangles()
SKIN = Skin(TRUTH, 1.0, list(np.arange(len(TRUTH)).reshape(-1, 10)))


@pytest.mark.parametrize("kind", LAYOUT_FAULTS)
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_faults_change_only_their_sensors(kind, share):
    stated, groups = LAYOUT_FAULTS[kind](SKIN, share, np.random.default_rng(301))
    changed = (stated != TRUTH).any(axis=1)
    inside = np.zeros(len(TRUTH), dtype=bool)
    inside[np.concatenate(groups)] = True
    assert sum(map(len, groups)) == inside.sum()  # groups do not overlap
    assert changed.sum() >= 0.01 * len(TRUTH)
    assert not changed[~inside].any()
    distance = np.linalg.norm(stated - TRUTH, axis=1)
    if kind == "moved":
        assert MOVED[0] <= distance[inside].min() <= distance[inside].max() <= MOVED[1]
        return
    # All others permute the places of each group, or of all groups.
    taken = cdist(stated, TRUTH).argmin(axis=1)
    assert sorted(taken) == list(range(len(TRUTH)))
    if kind in ("swapped", "cycle"):
        assert distance[inside].min() >= MIN_SWAPPED


@pytest.mark.parametrize("kind", READING_FAULTS)
def test_faults_of_readings_are_in_the_readings(kind):
    recording = flat_skin(n_frames=200)
    spoilt, groups = READING_FAULTS[kind](recording, 0.1, np.random.default_rng(302))
    assert len(groups) == 4
    changed = (spoilt.readings != recording.readings).any(axis=0)
    assert set(np.flatnonzero(changed)) <= {int(group[0]) for group in groups}
    for group in groups:
        column = spoilt.readings[:, group[0]]
        expected = spoilt.readings[:, group[1]] if kind == "doubled" else 0
        np.testing.assert_array_equal(column, expected)


def test_scores_are_kept_and_summarised(tmp_path):
    results = [
        Result("skin", 100, "turned", share, 1001, 2, 2, 1, 20, 80, 1) for share in (0.01, 0.1)
    ]
    write_rows(tmp_path / "check.csv", results)
    assert read_rows(tmp_path / "check.csv", Result) == results
    assert read_rows(tmp_path / "missing.csv", Result) == []
    row = "| skin | 100 | turned | 1% to 10% | 4 | 100.0% | 50.0% | 1.25% |"
    assert table(results)[-1] == row
