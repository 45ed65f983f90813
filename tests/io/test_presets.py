"""Sensors, names and positions of robots with a known numbering, and of grids."""

import numpy as np
import pytest

from anisomap import Recording, io
from anisomap.errors import InputError
from anisomap.io.presets import apply_preset


def skin(n_boards: int = 2, *, rest: float = 0.0, source: str = "") -> Recording:
    """Create a recording in which all values vary, except triangle 3 of board 1."""
    readings = rest + np.random.default_rng(0).integers(-9, 1, (50, 192 * n_boards))
    if n_boards > 1:
        readings[:, 192 + 36 : 192 + 48] = 255
    return Recording(readings, source=source)


def test_names_state_board_triangle_and_pad() -> None:
    recording = skin()
    found = apply_preset(recording, "icub")
    assert found.n_sensors == (2 * 16 - 1) * 10
    for name, column in zip(found.names, found.readings.T, strict=True):
        board, triangle, k = (int(part[1:]) for part in name.split("."))
        at = 192 * board + 12 * triangle + k
        np.testing.assert_array_equal(column, recording.readings[:, at])
        assert k not in (6, 10)
        assert (board, triangle) != (1, 3)


@pytest.mark.parametrize(("rest", "state"), [(240.0, "raw"), (0.0, "compensated")])
def test_raw_and_compensated_skin(rest: float, state: str) -> None:
    assert apply_preset(skin(rest=rest), "icub").metadata["skin"].startswith(state)


@pytest.mark.parametrize("source", ["left_hand", "run/right_hand_comp"])
def test_hands_are_recognised_by_the_port(source: str) -> None:
    found = apply_preset(skin(1, source=source), "icub")
    assert found.names == apply_preset(skin(1), "icub-hand").names
    assert found.n_sensors == 60 + 44
    assert {f"palm.{k}" for k in (11, 23, 35, 43)}.isdisjoint(found.names)
    assert {"thumb.0", "thumb.6", "palm.6", "palm.47"} <= set(found.names)
    np.testing.assert_array_equal(found.readings[:, -1], skin(1).readings[:, 143])


def test_joined_ports_are_numbered_separately() -> None:
    arm, hand = skin(2), skin(1)
    names = [f"left_arm/s{i}" for i in range(384)] + [f"left_hand/s{i}" for i in range(192)]
    found = apply_preset(Recording(np.hstack([arm.readings, hand.readings]), names=names), "icub")
    assert found.n_sensors == (2 * 16 - 1) * 10 + 60 + 44
    assert found.names[0] == "left_arm/b0.t0.k0"
    assert found.names[-1] == "left_hand/palm.47"
    np.testing.assert_array_equal(found.readings[:, -1], hand.readings[:, 143])


def test_recordings_that_do_not_fit_a_preset_are_rejected() -> None:
    with pytest.raises(InputError, match="multiple of 12"):
        apply_preset(Recording(np.eye(13)), "icub")
    with pytest.raises(InputError, match="192 values, got 24"):
        apply_preset(Recording(np.eye(24)), "icub-hand")
    with pytest.raises(InputError, match="known presets: icub, icub-hand"):
        apply_preset(Recording(np.eye(24)), "nao")
    with pytest.raises(InputError, match="no sensor of preset icub varies"):
        apply_preset(Recording(np.ones((3, 24))), "icub")


@pytest.mark.parametrize("grid", [(-1, -2), (0, 3), (1, 2, 3), (2.0, 3), 6, "2x3", ((1, 2), 3)])
def test_a_grid_that_is_none_is_named(grid):
    with pytest.raises(InputError, match=r"^grid must be numbers of rows and columns"):
        io.ReadOptions(grid=grid)
