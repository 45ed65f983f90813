"""Even samples of recordings of unknown length."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.numerics.sampling import EvenSample


@given(st.lists(st.integers(0, 40), min_size=1, max_size=12), st.integers(1, 60), st.integers(1, 3))
def test_every_kth_frame_is_kept_however_frames_arrive(lengths, most, n_sensors):
    frames = np.arange(sum(lengths) * n_sensors).reshape(-1, n_sensors)
    sample = EvenSample(most * n_sensors)
    for part in np.split(frames, np.cumsum(lengths)[:-1]):
        sample.add(part)
    assert sample.n_frames == len(frames)
    assert len(sample.readings) <= most
    assert len(sample.readings) * 2 >= min(most, len(frames))
    np.testing.assert_array_equal(sample.readings, frames[:: sample.every])
    np.testing.assert_array_equal(sample.take(), frames[:: sample.every])


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.float32, np.int64, np.float64])
def test_readings_are_exact(dtype):
    frames = np.arange(2**24, 2**24 + 40).reshape(20, 2).astype(dtype)
    sample = EvenSample()
    sample.add(frames[:7])
    sample.add(frames[7:])
    np.testing.assert_array_equal(sample.take(), frames)
