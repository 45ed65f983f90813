"""Coverage of the sensors by recording length."""

import numpy as np
import pytest

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation import coverage_curve, simulate
from anisomap.simulation.coverage import QUANTILES, neighbouring_pairs


@pytest.fixture(scope="module")
def curve():
    return coverage_curve("sphere", "rubbing", (600, 40, 150, 150), (1, 2), method="r-anisomap")


def test_coverage_and_maps_improve_with_length(curve):
    assert curve.n_frames.tolist() == [40, 150, 600]
    np.testing.assert_allclose(curve.seconds, [2, 7.5, 30])
    assert curve.touched.shape == curve.pairs.shape == curve.mantel_r.shape == (3, 2)
    assert curve.contacts.shape == (3, 2, len(QUANTILES))
    for values in (curve.touched, curve.pairs, curve.contacts):
        assert (np.diff(values, axis=0) >= 0).all()
        assert not values.flags.writeable
    assert (np.diff(curve.contacts, axis=2) >= 0).all()
    assert (curve.pairs <= curve.n_pairs).all()
    assert (curve.touched[-1] == 1).all()
    assert (curve.touched[0] < 0.8).all()
    assert np.median(curve.mantel_r[-1]) > 0.8
    assert np.median(curve.mantel_r[-1]) > np.median(curve.mantel_r[1])


def test_coverage_agrees_with_direct_counts(curve):
    recording = simulate("sphere", "rubbing", n_frames=600, seed=2)
    on = recording.readings[:150] > 0
    onsets = [sum(now and not was for was, now in zip([False, *s], s, strict=False)) for s in on.T]
    assert curve.touched[1, 1] == on.any(axis=0).mean()
    np.testing.assert_array_equal(curve.contacts[1, 1], np.quantile(onsets, QUANTILES))
    pairs = neighbouring_pairs(recording)
    assert curve.n_pairs == len(pairs)
    assert curve.pairs[1, 1] == sum((on[:, i] & on[:, j]).any() for i, j in pairs)


def test_inner_sensors_of_a_square_lattice_have_eight_neighbours():
    x, y = np.meshgrid(np.arange(4.0), np.arange(5.0))
    positions = np.column_stack([x.ravel(), y.ravel()])
    pairs = neighbouring_pairs(Recording(np.zeros((2, 20)), positions=positions))
    steps = np.abs(positions[:, None] - positions).max(axis=2)
    np.testing.assert_array_equal(pairs, np.argwhere(np.triu(steps == 1)))
    with pytest.raises(InputError, match="true positions"):
        neighbouring_pairs(Recording(np.zeros((2, 20))))


def test_more_hands_cover_more_and_no_method_gives_no_maps():
    sparse, dense = (
        coverage_curve("sphere", "rubbing", (100,), (3, 4), method=None, n_hands=n) for n in (1, 4)
    )
    assert dense.touched.mean() > sparse.touched.mean()
    assert np.isnan(dense.mantel_r).all()


def test_without_contacts_mantel_r_is_nan():
    curve = coverage_curve("sphere", "pressing", (1,), (1,))
    assert curve.touched.tolist() == [[0.0]]
    assert np.isnan(curve.mantel_r).all()


@pytest.mark.parametrize(
    ("lengths", "seeds", "method", "message"),
    [
        ((), (1,), None, "at least one length and one seed"),
        ((5,), (), None, "at least one length and one seed"),
        ((5, 0), (1,), None, "n_frames must be an integer of at least 1, got 0"),
        ((5,), (1,), "magic", "magic"),
    ],
)
def test_invalid_arguments_raise_an_error(lengths, seeds, method, message):
    with pytest.raises(InputError, match=message):
        coverage_curve("sphere", "rubbing", lengths, seeds, method=method)
