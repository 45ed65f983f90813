"""Statistics of all pairs of sensors."""

import numpy as np
import pytest

import anisomap
from anisomap.base.defaults import DEFAULT_BINS
from anisomap.evidence import compare
from skins import flat_skin


def changes_of(readings):
    recording = anisomap.Recording(readings)
    found = compare(
        [recording], "blended-correlation", bins=DEFAULT_BINS, with_noise=True
    ).rank_changes
    return found[np.triu_indices(len(found), 1)]


@pytest.mark.parametrize("held", [2, 3])
def test_changes_of_held_readings_are_not_missed(held):
    """A logger that is faster than the sensors repeats readings, beyond 10,000 frames too."""
    readings = flat_skin(n_frames=6000).readings
    once, repeated = changes_of(readings), changes_of(np.repeat(readings, held, axis=0))
    assert np.abs(once).max() > 0.1
    assert np.corrcoef(once, repeated)[0, 1] > 0.9
