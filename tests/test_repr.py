"""What a notebook shows of recordings and maps: short, and escaped."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from anisomap import Recording, SensorMap

HOSTILE = "<script>alert(1)</script>"


@given(st.integers(1, 400), st.integers(1, 300))
def test_reprs_are_short_and_name_the_size(n_frames, n_sensors):
    recording = Recording(np.zeros((n_frames, n_sensors)), rate_hz=50)
    shown = repr(recording)
    assert len(shown) < 200
    assert f"{n_frames} frames, {n_sensors} sensors, 50 Hz" in shown


def test_the_repr_of_a_map_tells_its_size_method_and_components():
    positions = np.vstack([np.eye(3), 9 + np.eye(3)[:2], np.full((1, 3), np.nan)])
    made = SensorMap(positions, component=[0, 0, 0, 1, 1, -1], method="isomap", stress=0.25)
    shown = repr(made)
    assert len(shown) < 200
    for part in ("5 of 6 sensors placed", "3D", "2 components", "isomap", "Stress-1=0.250"):
        assert part in shown


def test_notebooks_show_escaped_tables():
    recording = Recording(np.eye(4), source=HOSTILE)
    made = SensorMap(np.eye(3), notes=[HOSTILE], method=HOSTILE)
    for table in (recording._repr_html_(), made._repr_html_()):
        assert table.startswith("<table>")
        assert "<script>" not in table
        assert "&lt;script&gt;" in table
