"""Scale, handedness and normals of a map."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.errors import InputError
from anisomap.evaluation import align
from anisomap.placement import (
    median_spacing,
    mirrored,
    parse_length,
    scaled_to_spacing,
    surface_normals,
    to_taxels,
)
from anisomap.sensor_map import SensorMap

seeds = st.integers(0, 1000)


def some_map(seed: int, n_sensors: int = 20, dimensions: int = 3) -> SensorMap:
    return SensorMap(np.random.default_rng(seed).normal(size=(n_sensors, dimensions)))


@given(seeds, st.floats(1e-3, 1e3))
@settings(max_examples=20)
def test_scaling_sets_the_spacing_and_keeps_the_shape(seed: int, spacing: float) -> None:
    before = some_map(seed)
    after = scaled_to_spacing(before, spacing, "mm")
    assert median_spacing(after) == pytest.approx(spacing)
    assert after.units == "mm"
    factor = after.provenance["scale"]
    np.testing.assert_allclose(after.positions, factor * before.positions)


@given(seeds, st.sampled_from([2, 3]))
@settings(max_examples=20)
def test_a_mirrored_map_is_a_reflection_and_twice_is_the_map(seed: int, dimensions: int) -> None:
    before = some_map(seed, dimensions=dimensions)
    after = mirrored(before)
    assert align(after.positions, before.positions).reflected
    assert after.mirrored is True
    again = mirrored(after)
    np.testing.assert_array_equal(again.positions, before.positions)
    assert again.mirrored is False


def test_components_share_a_scale_and_have_separate_normals() -> None:
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    positions = np.vstack([grid, grid[:, ::-1] + 0.1, [[np.nan, np.nan]]])
    found = SensorMap(positions, component=[0] * 16 + [1] * 16 + [-1])
    assert median_spacing(found) == 1  # sensors of the other component are not neighbours
    assert median_spacing(scaled_to_spacing(found, 6.5, "mm")) == pytest.approx(6.5)
    normals = surface_normals(found)
    np.testing.assert_array_equal(normals[:32], np.tile([0, 0, 1], (32, 1)))
    assert np.isnan(normals[32]).all()


def test_taxels_are_in_metres_and_their_frames_have_z_along_the_normal() -> None:
    skin = to_taxels(scaled_to_spacing(some_map(3), 4.0, "mm"), "a test")
    assert skin.frame == "skin"
    frames = skin.rotations.as_matrix()
    np.testing.assert_allclose(frames[:, :, 2], skin.normals, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1)
    spaced = SensorMap(skin.positions)
    assert median_spacing(spaced) == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("6.5mm", (6.5, "mm")), (" 2 cm ", (2, "cm")), ("1e-3m", (1e-3, "m")), ("4um", (4, "um"))],
)
def test_lengths_are_read(text: str, expected: tuple[float, str]) -> None:
    assert parse_length(text) == expected


@pytest.mark.parametrize("text", ["", "6.5", "mm", "-1mm", "0m", "6.5 furlong", "1e999m", "--mm"])
def test_malformed_lengths_are_rejected(text: str) -> None:
    with pytest.raises(InputError, match="is not a length; write a positive number and a unit"):
        parse_length(text)


@pytest.mark.parametrize(
    ("sensor_map", "message"),
    [
        (some_map(0), "a test needs positions in metres, but the unit of the map is"),
        (SensorMap(np.eye(3), component=[0, 0, 1], units="mm"), "their relative poses are unknown"),
        (SensorMap(np.eye(4), units="m"), "at most 3 dimensions, got 4"),
    ],
)
def test_maps_without_poses_in_metres_are_rejected(sensor_map: SensorMap, message: str) -> None:
    with pytest.raises(InputError, match=message):
        to_taxels(sensor_map, "a test")


def test_spacings_that_are_undefined_are_rejected() -> None:
    with pytest.raises(InputError, match="spacing of the map is undefined"):
        median_spacing(SensorMap(np.zeros((3, 2))))
    with pytest.raises(InputError, match="spacing must be a positive number, got -1"):
        scaled_to_spacing(some_map(0), -1, "mm")
