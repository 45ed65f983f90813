"""Readings in closed form: balls, against brute force."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from anisomap.simulation.sensing import read_balls

coordinates = st.floats(-2, 2, width=32)
lengths = st.floats(0.01, 1.5)
sensors = arrays(np.float64, st.tuples(st.integers(1, 5), st.just(3)), elements=coordinates)
frames = arrays(
    np.float64, st.tuples(st.integers(1, 3), st.integers(1, 6), st.just(3)), elements=coordinates
)


@given(sensors, frames, lengths, lengths)
def test_readings_agree_with_the_closed_form_of_each_pair(
    sensors: Any, frames: Any, ball: float, detection: float
) -> None:
    readings = read_balls(sensors, frames, ball, detection)
    for t, centres in enumerate(frames):
        for i, sensor in enumerate(sensors):
            deepest = 0.0
            for centre in centres:
                distance = sum((a - b) ** 2 for a, b in zip(sensor, centre, strict=True)) ** 0.5
                deepest = max(deepest, detection + ball - distance)
            assert abs(readings[t, i] - deepest) <= 1e-6 * (detection + ball)


def test_readings_agree_with_a_sampled_ball() -> None:
    rng = np.random.default_rng(3)
    ball, detection = 0.3, 0.44
    skin = rng.standard_normal((200_000, 3))
    skin *= ball / np.linalg.norm(skin, axis=1, keepdims=True)
    for _ in range(20):
        centre = rng.uniform(0.3, 0.45, size=3)
        nearest = np.linalg.norm(centre + skin, axis=1).min()
        reading = read_balls(np.zeros((1, 3)), centre[None, None], ball, detection)[0, 0]
        assert abs(reading - max(0.0, detection - nearest)) < 1e-4


@given(sensors, frames, lengths, lengths)
def test_readings_are_the_maximum_over_balls(
    sensors: Any, frames: Any, ball: float, detection: float
) -> None:
    alone = [
        read_balls(sensors, frames[:, j : j + 1], ball, detection) for j in range(frames.shape[1])
    ]
    np.testing.assert_array_equal(
        read_balls(sensors, frames, ball, detection), np.max(alone, axis=0)
    )


@given(sensors, frames, st.integers(0, 2**32 - 1))
def test_readings_are_invariant_to_rigid_motion(sensors: Any, frames: Any, seed: int) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    np.testing.assert_allclose(
        read_balls(sensors @ turn.T + 1, frames @ turn.T + 1, 0.3, 0.44),
        read_balls(sensors, frames, 0.3, 0.44),
        atol=1e-6,
    )


@given(sensors, st.lists(lengths, min_size=2, max_size=4), st.data())
def test_readings_of_different_radii_agree_with_each_alone(
    sensors: Any, radii: Any, data: Any
) -> None:
    frames = data.draw(arrays(np.float64, (2, len(radii), 3), elements=coordinates))
    each = [
        read_balls(sensors, frames[:, j : j + 1], radius, 0.44) for j, radius in enumerate(radii)
    ]
    np.testing.assert_allclose(
        read_balls(sensors, frames, radii, 0.44), np.max(each, axis=0), atol=1e-6
    )
