"""Bodies: sensors on the surface, and invalid arguments."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.simulation import Body, find_body, solids
from anisomap.simulation.bodies import BODIES, CYLINDER_PLACEMENTS, sphere


@pytest.mark.parametrize("name", BODIES)
def test_sensors_are_on_the_surface_and_normals_point_outwards(name, bodies):
    body = bodies[name]
    assert body.name == name
    np.testing.assert_allclose(body.distance(body.positions), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(body.normals, axis=1), 1)
    step = 1e-3 * body.reach
    above = body.distance(body.positions + step * body.normals)
    below = body.distance(body.positions - step * body.normals)
    # The distance from the surface is at most the step along the normal, and equal to it except
    # near edges.
    assert (above > 0).all()
    assert (below < 0).all()
    assert max(above.max(), -below.min()) <= step * (1 + 1e-9)
    np.testing.assert_allclose([np.median(above), -np.median(below)], step, rtol=1e-6)
    assert np.linalg.norm(body.positions, axis=1).max() <= body.reach + 1e-9


@given(st.integers(min_value=12, max_value=800))
@settings(max_examples=30)
def test_sensors_are_spread_evenly_over_the_sphere(n_sensors):
    positions = sphere(n_sensors).positions
    # Upper bound of the spacing of n points: a triangular lattice, with an area of sqrt(3)/2
    # spacing^2 per point.
    densest = np.sqrt(4 * np.pi / n_sensors * 2 / np.sqrt(3))
    nearest = KDTree(positions).query(positions, k=2)[0][:, 1]
    assert nearest.min() > 0.8 * densest
    assert nearest.std() < 0.05 * nearest.mean()
    assert np.linalg.norm(positions.mean(axis=0)) < 0.1
    spread = positions.T @ positions / n_sensors
    np.testing.assert_allclose(spread, np.eye(3) / 3, atol=0.05)


@pytest.mark.parametrize("n_sensors", [0, -3, 2.5, True])
def test_the_number_of_sensors_must_be_a_positive_integer(n_sensors):
    with pytest.raises(InputError, match="n_sensors"):
        sphere(n_sensors)
    with pytest.raises(ValueError, match="read-only"):
        sphere().positions[0] = 0


def test_a_sensor_off_the_surface_raises_an_error_with_its_name_and_distance():
    positions = np.array([[1.0, 0, 0], [0, 1.25, 0]])
    with pytest.raises(InputError, match=r"sensor s1 is 0\.25 m off"):
        Body(
            name="ball",
            positions=positions,
            normals=positions,
            solids=[solids.ball(1.0)],
        )


@pytest.mark.parametrize("placement", CYLINDER_PLACEMENTS)
def test_placements_of_a_cylinder_cover_its_side(placement):
    body = find_body("cylinder", 500, placement=placement)
    assert body.distance(body.positions) == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(np.hypot(*body.positions[:, :2].T), body.solids[0].size[0])
    # Uniform around and along: the mean direction and the mean height of any cover are near 0.
    np.testing.assert_allclose(body.positions.mean(axis=0), 0, atol=0.12)
    assert np.ptp(body.positions[:, 2]) > 0.95 * 2
    again, other = (find_body("cylinder", 500, placement=placement, seed=s) for s in (0, 1))
    np.testing.assert_array_equal(again.positions, body.positions)
    assert np.array_equal(other.positions, body.positions) == (placement != "random")


@pytest.mark.parametrize(
    ("body", "options", "message"),
    [
        ("cylinder", {"placement": "spiral"}, "columns, fibonacci, random"),
        ("sphere", {"placement": "random"}, "the body sphere has no option placement"),
        (sphere(), {"placement": "random"}, "cannot be given with the body sphere"),
    ],
)
def test_unknown_options_of_bodies_are_refused(body, options, message):
    with pytest.raises(InputError, match=message):
        find_body(body, **options)
