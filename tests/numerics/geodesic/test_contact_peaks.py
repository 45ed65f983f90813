"""Lengths from contact peaks: simulated ground of known correlation gives known lengths."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.numerics.geodesic.contact_heights import (
    MIN_PEAKS,
    ContactHeights,
    contacts_of,
    peak_lengths,
)
from anisomap.numerics.similarity.rest import estimate_rest

PULSE = np.array([0, 1, 3, 6, 3, 1, 0]) / 6


def rolled_over(similar: np.ndarray, n_contacts: int, seed: int = 0, delay: int = 0) -> np.ndarray:
    """Simulate contacts over a line of sensors with autoregressive heights.

    The heights of neighbours i and i + 1 have the correlation ``similar[i]``, `delay` frames apart.
    """
    rng = np.random.default_rng(seed)
    heights = [rng.standard_normal(n_contacts)]
    for a in similar:
        heights.append(a * heights[-1] + np.sqrt(1 - a * a) * rng.standard_normal(n_contacts))
    readings = np.zeros((40 * n_contacts + 40, len(heights)))
    for i, column in enumerate(heights):
        pulses = 5 + column.clip(-4, 4)
        for n in range(n_contacts):
            at = 10 + 40 * n + delay * i
            readings[at : at + len(PULSE), i] = pulses[n] * PULSE
    return readings


def chain(n: int) -> np.ndarray:
    return np.eye(n, k=1, dtype=bool) | np.eye(n, k=-1, dtype=bool)


def lengths_of(readings, links):
    return peak_lengths(ContactHeights.of(estimate_rest(readings).depth(readings)), links)


def test_peaks_are_the_maxima_of_contacts():
    raised = np.array([0.0, 0, 5, 9, 5, 0, 0, 4, 4, 0, 8])
    frames, heights, _ = contacts_of(raised)
    assert frames.tolist() == [3, 7, 10]
    assert heights.tolist() == [9, 4, 8]


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60))
def test_peaks_are_ordered_readings(values):
    raised = np.array(values)
    frames, heights, _ = contacts_of(raised)
    assert (np.diff(frames) > 1).all()
    np.testing.assert_array_equal(heights, raised[frames])


@pytest.mark.parametrize("delay", [0, 3])
def test_lengths_of_autoregressive_ground_equal_the_closed_form(delay):
    similar = np.array([0.9, 0.7, 0.4, 0.0])
    found = lengths_of(rolled_over(similar, 4000, delay=delay), chain(5))
    # Spearman's rho of two normal variables of correlation a is 6 / pi asin(a / 2).
    expected = np.sqrt(1 - 6 / np.pi * np.arcsin(similar / 2))
    np.testing.assert_allclose(np.diag(found, k=1), expected, atol=0.03)
    assert np.array_equal(found, found.T, equal_nan=True)
    assert np.array_equal(np.isfinite(found), chain(5))


@given(st.integers(0, 50))
def test_lengths_do_not_depend_on_gain_offset_and_sign(seed):
    readings, rng = rolled_over(np.array([0.8, 0.5]), 30, seed), np.random.default_rng(seed)
    gains = 2.0 ** rng.integers(-5, 6, 3) * rng.choice([-1, 1], 3)
    found = lengths_of(readings * gains + rng.integers(-9, 9, 3), chain(3))
    np.testing.assert_allclose(found, lengths_of(readings, chain(3)))


def test_lengths_are_equivariant_to_labels():
    readings, order = rolled_over(np.array([0.9, 0.5, 0.7]), 60, delay=2), [2, 0, 3, 1]
    found = lengths_of(readings, chain(4))
    again = lengths_of(readings[:, order], chain(4)[np.ix_(order, order)])
    np.testing.assert_array_equal(again, found[np.ix_(order, order)])


def test_few_peaks_and_binary_readings_give_no_lengths():
    few = rolled_over(np.array([0.9]), MIN_PEAKS - 1)
    assert np.isnan(lengths_of(few, chain(2))).all()
    enough = rolled_over(np.array([0.9]), MIN_PEAKS)
    assert np.isfinite(lengths_of(enough, chain(2))).any()
    assert np.isnan(lengths_of(enough > 0, chain(2))).all()
