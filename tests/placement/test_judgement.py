"""Errors of a map are told in one unit, each as the quantity that it is."""

import json
from dataclasses import replace

import numpy as np
import pytest

import anisomap
from anisomap.notes import Note
from anisomap.placement import scaled_to_spacing
from anisomap.placement.judgement import errors_of_sensors, headline, judgement
from anisomap.usability import Verdict
from skins import flat_map

ERRORS = (0.2, 0.1, 0.6, 0.16, 0.12, 0.32, 0.9, 0.8, 1.0, 0.25)


@pytest.fixture
def judged():
    reasons = (Note("chance", size=0.24, much=False), "touched once")
    made = flat_map()
    spread = np.broadcast_to(0.01 * np.eye(2), (made.n_sensors, 2, 2))
    return replace(made, verdict=Verdict("usable", *ERRORS, reasons=reasons), covariances=spread)


def test_every_error_is_in_millimetres_once_the_scale_is_known(judged, tmp_path):
    assert "0.20 spacings (0.10 to 0.60)" in headline(judged)
    scaled = scaled_to_spacing(judged, 6.5, "mm")
    told = judgement(scaled)
    assert told[0] == "Usable: positions are right to about 1.3 mm (0.65 to 3.9)."
    assert "Maps of resampled recordings differ by 1.56 mm." in told
    assert "Touched once." in told
    assert not any("spacings" in one.replace("radius of 5 spacings", "") for one in told)
    assert judgement(scaled_to_spacing(judged, 0.0065, "m")) == told
    anisomap.write(scaled, tmp_path / "map.json")
    stated = json.loads((tmp_path / "map.json").read_text())["verdict"]
    assert stated["expected_error_mm"] == pytest.approx(6.5 * stated["expected_error"])
    again = anisomap.read_map(tmp_path / "map.json")
    assert again.verdict.expected_error == 0.2
    assert judgement(again) == told


def test_the_error_of_a_sensor_holds_nine_of_ten(judged):
    drawn = np.random.default_rng(0).multivariate_normal([0, 0], judged.covariances[0], 20_000)
    within = np.linalg.norm(drawn, axis=1) <= errors_of_sensors(judged)[0]
    assert within.mean() == pytest.approx(0.9, abs=0.01)
