"""Missing readings are interpolated as by pandas."""

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.numerics.columns import fill_gaps

N_FRAMES, N_SENSORS = 24, 3

readings = st.floats(-1e6, 1e6, width=32)
holes = st.sampled_from([np.nan, np.inf, -np.inf])


@st.composite
def with_gaps(draw):
    """Readings with gaps of any length, also at the ends and of whole sensors."""
    whole = draw(arrays(draw(st.sampled_from([np.float32, np.float64])), (N_FRAMES, N_SENSORS),
                        elements=readings))  # fmt: skip
    for _ in range(draw(st.integers(0, 6))):
        begin, end = sorted(draw(st.tuples(*[st.integers(0, N_FRAMES)] * 2)))
        whole[begin:end, draw(st.integers(0, N_SENSORS - 1))] = draw(holes)
    return whole


@given(with_gaps())
def test_gaps_are_interpolated_in_time(whole):
    frame = pd.DataFrame(whole.astype(np.float64)).replace([np.inf, -np.inf], np.nan)
    expected = frame.interpolate(limit_direction="both").fillna(0).to_numpy()
    found = fill_gaps(whole)
    assert found.dtype == whole.dtype
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-3)
    known = np.isfinite(whole)
    np.testing.assert_array_equal(found[known], whole[known])


@given(arrays(np.uint8, (N_FRAMES, 2)))
def test_integers_have_no_gaps(whole):
    assert fill_gaps(whole) is whole
