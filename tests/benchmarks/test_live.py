"""The benchmark of the coach: what its summary says."""

import numpy as np
import pandas as pd
import pytest
from benchmarks.live import coach
from benchmarks.live.coach import Row

from anisomap.simulation import find_body
from anisomap.simulation.kinematic import GuidedHand, RubbingOptions
from anisomap.simulation.options import options_for


def rows(errors, way):
    return [
        Row("sphere", "palm", way, seed, n, error, 1.0)
        for n, error in errors.items()
        for seed in (1, 2, 3)
    ]


def test_the_summary_compares_the_frames_to_each_goal():
    errors = pd.Series({100: 0.9, 200: 2.0, 400: 0.8, 800: 0.7})
    for goal, frames in ((1.0, 400), (0.75, 800), (0.1, np.nan)):  # where the error stays below
        np.testing.assert_equal(coach.frames_until(errors <= goal), frames)
    found = rows({100: 3.0, 200: 1.0, 400: 0.5}, "coached")
    touched, one, last = coach.summary(found + rows({100: 4.0, 200: 2.0, 400: 0.8}, "uncoached"))
    for row, expected in (
        (touched, (100, 100, 1.0)),
        (one, (200, 400, 0.5)),
        (last, (400, 400, 1)),
    ):
        assert (row.coached, row.uncoached, row.ratio) == expected
    assert last.spacings == 0.8


def test_a_sensor_without_a_place_counts_as_in_the_middle():
    body = find_body("plane", 25)
    nothing = np.full((25, 2), np.nan)
    centred = body.positions - body.positions.mean(axis=0)
    expected = np.sqrt((centred**2).sum(axis=1).mean()) / body.spacing
    assert coach.error_of(nothing, body) == pytest.approx(expected, rel=0.05)
    assert coach.error_of(3 * body.positions, body) == pytest.approx(0, abs=1e-9)


def test_a_guided_hand_rubs_where_it_is_told():
    body = find_body("sphere")
    hand = GuidedHand(body, options_for(RubbingOptions, body), np.random.default_rng(1))
    near = np.argsort(np.linalg.norm(body.positions - body.positions[7], axis=1))[:6]
    contacts = np.full(60, 12)
    contacts[near] = 0
    hits = sum(hand.rub(20, [7], contacts)[6, near].sum() > 0 for _ in range(5))
    assert hits == 5
    assert not hand.rub(20)[:6].any()
