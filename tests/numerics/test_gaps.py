"""Missing readings in chunks: results equal those for one array."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap import Recording
from anisomap.errors import InputError
from anisomap.numerics.gaps import drop_incomplete_frames, interpolate_gaps, require_no_gaps

N_FRAMES, N_SENSORS = 24, 3

some = settings(max_examples=25)
readings = st.floats(-1e6, 1e6, width=32)
holes = st.sampled_from([np.nan, np.inf, -np.inf])
cuts = st.lists(st.integers(0, N_FRAMES), max_size=12).map(sorted)
windows = st.integers(1, 2 * N_FRAMES * N_SENSORS)


@st.composite
def with_gaps(draw):
    """Readings with gaps of any length, also at the ends and of whole sensors."""
    whole = draw(arrays(draw(st.sampled_from([np.float32, np.float64])), (N_FRAMES, N_SENSORS),
                        elements=readings))  # fmt: skip
    for _ in range(draw(st.integers(0, 6))):
        begin, end = sorted(draw(st.tuples(*[st.integers(0, N_FRAMES)] * 2)))
        whole[begin:end, draw(st.integers(0, N_SENSORS - 1))] = draw(holes)
    return whole


class Chunked:
    """Chunked readings that count the iterations started."""

    def __init__(self, whole, cut):
        self.chunks = [part for part in np.split(whole, cut) if len(part)]
        self.times = 0

    def __call__(self):
        self.times += 1
        return iter(self.chunks)


@given(with_gaps(), cuts, windows)
@some
def test_gaps_are_interpolated_as_in_one_array(whole, cut, window):
    chunks = Chunked(whole, cut)
    found = interpolate_gaps(chunks, window)
    expected = Recording(whole).complete("interpolate").readings
    for passes in range(2):
        np.testing.assert_array_equal(np.concatenate(list(found())), expected)
        # The ends of all gaps that the window does not hold are found in one further iteration.
        assert chunks.times <= passes + (1 if window >= N_FRAMES * N_SENSORS else 2)


def test_only_the_following_window_is_read_ahead():
    whole = np.ones((1000, 1), dtype=np.float32)
    whole[5:900] = np.nan
    whole[900:] = 3
    read = []

    def chunks():
        for i, row in enumerate(whole):
            read.append(i)
            yield row[None]

    found = interpolate_gaps(chunks, 10)()
    next(found)
    assert len(read) == 20 + 1000
    read.clear()
    ahead = 0
    for part in found:
        assert len(part) <= 10
        ahead += len(part)
        assert len(read) <= ahead + 10


@given(with_gaps(), cuts)
@some
def test_incomplete_frames_are_dropped_as_in_one_array(whole, cut):
    found = drop_incomplete_frames(Chunked(whole, cut))
    try:
        expected = Recording(whole).complete("drop-frames").readings
    except InputError:
        with pytest.raises(InputError, match="every frame has a missing reading"):
            list(found())
        return
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate(list(found())), expected)


@given(with_gaps(), cuts)
@some
def test_the_error_names_the_first_missing_reading(whole, cut):
    missing = np.argwhere(~np.isfinite(whole))
    if not len(missing):
        np.testing.assert_array_equal(
            np.concatenate(list(require_no_gaps(Chunked(whole, cut))())), whole
        )
        return
    frame, sensor = missing[0]
    with pytest.raises(InputError, match=f"sensor {sensor} in frame {frame} is NaN or infinite"):
        list(require_no_gaps(Chunked(whole, cut))())


@given(arrays(np.uint8, (N_FRAMES, 2)), cuts, windows)
@some
def test_integers_have_no_gaps(whole, cut, window):
    for opened in (
        interpolate_gaps(Chunked(whole, cut), window),
        drop_incomplete_frames(Chunked(whole, cut)),
    ):
        found = np.concatenate(list(opened()))
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, whole)
