"""The measurement of the calibration of ellipses."""

import numpy as np
import pytest
from benchmarks import uncertainty
from benchmarks.uncertainty import OURS, RIVAL, Judged

import anisomap
from anisomap.evaluation import align
from skins import flat_skin

quiet = pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")


def judged(name, method, inside, error=0.3):
    return Judged(name, 1000, method, error, 0.2, inside, 1.0, 1.5)


def test_the_table_has_a_row_for_each_skin_and_one_for_all():
    results = [
        judged("sphere", OURS, 0.9, 0.3),
        judged("sphere", OURS, 1.0, 0.4),
        judged("sphere", RIVAL, 0.5),
        judged("cube", OURS, 0.8),
        judged("cube", RIVAL, 0.7),
    ]
    text = uncertainty.table(results)
    assert "| sphere | 1000 | 2 | 0.35 | 0.20 | 95% | 0.30 | 0.20 | 50% |" in text
    assert "| **all** |  | 3 | 0.34 | 0.20 | 90% | 0.30 | 0.20 | 60% |" in text
    assert "take 1.5 times as long as the map" in text


@quiet
def test_halves_of_a_recording_judge_each_other(tmp_path):
    anisomap.write(flat_skin(n_frames=800), tmp_path / "skin.npz")
    ours, rival = uncertainty.judge_recording(tmp_path / "skin.npz")
    assert (ours.method, rival.method) == (OURS, RIVAL)
    for one in (ours, rival):
        assert 0 <= one.inside <= 1
        assert 0 < one.error < 2
        assert one.expected > 0


def test_resampling_frames_understates_the_errors_of_slow_readings():
    """Every frame occurs ten times: single frames seem to be ten times as much evidence."""
    skins = [flat_skin(seed=seed, n_frames=150) for seed in range(2)]
    slow = [
        anisomap.Recording(np.repeat(skin.readings, 10, axis=0), positions=skin.positions)
        for skin in skins
    ]
    once, ten = (
        np.trace(uncertainty.bootmds(run, 2).covariances.mean(axis=0))
        for run in (skins[0], slow[0])
    )
    assert ten < once / 3
    made = [uncertainty.bootmds(run, 2).positions for run in slow]
    difference = align(made[0], made[1]).rms ** 2
    assert difference > 2 * ten
