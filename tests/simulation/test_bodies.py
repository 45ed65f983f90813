"""Bodies: sensors on their surface, spread over it, and distances along it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist, squareform

from anisomap.errors import InputError
from anisomap.simulation import Body, body_from_points, find_body, simulate, solids
from anisomap.simulation.bodies import BODIES, covered, cylinder, great_circles, hand, sphere
from anisomap.simulation.solids import sample_surface, spread


@pytest.fixture(scope="module")
def bodies():
    """All bodies by name, made once."""
    return {name: make() for name, make in BODIES.items()}


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
@settings(max_examples=12)
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


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ([[1.0, 0, 0], [0, 1.25, 0]], r"sensor s1 is 0\.25 m off"),
        ([[1.0, 0, 0], [np.nan, 0, 0]], "sensor 1 of ball needs a position"),
        ([[1.0, 0]], r"must be \(N, 3\)"),
        ([], r"must be \(N, 3\)"),
    ],
)
def test_sensors_off_the_surface_raise_an_error(positions, message):
    with pytest.raises(InputError, match=message):
        Body("ball", positions, positions, [solids.ball(1.0)])


def test_the_patch_of_72_pads_holds_the_60_that_sense_pressure():
    sensing, whole = find_body("hexagon"), find_body("hexagon", 72)
    assert whole.n_sensors == 72
    kept = [whole.names.index(name) for name in sensing.names]
    np.testing.assert_allclose(whole.positions[kept], sensing.positions)
    with pytest.raises(InputError, match="must be 60 or 72"):
        find_body("hexagon", 61)


def test_points_are_uniform_on_the_exposed_surface():
    rng = np.random.default_rng(0)
    parts = [solids.box((1, 1, 1)), solids.ball(0.8, (1, 0, 0))]
    points, normals = sample_surface(parts, 40_000, rng)
    distances = np.array([part.distance(points) for part in parts])
    np.testing.assert_allclose(distances.min(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    on_ball = np.abs(distances[1]) < 1e-9
    # Half of the ball lies inside the box and covers a disc of one face.
    ball, box = 2 * np.pi * 0.8**2, 24 - np.pi * 0.8**2
    assert on_ball.mean() == pytest.approx(ball / (ball + box), abs=0.01)
    upper = ~on_ball & (points[:, 2] > 1 - 1e-9)
    assert upper.mean() == pytest.approx(4 / (ball + box), abs=0.01)


def test_spread_sensors_keep_their_distance_and_leave_no_gap():
    parts = [solids.ball(1.0)]
    points, _ = spread(parts, 150, np.random.default_rng(1))
    nearest = KDTree(points).query(points, k=2)[0][:, 1].min()
    everywhere, _ = sample_surface(parts, 20_000, np.random.default_rng(2))
    widest = KDTree(points).query(everywhere)[0].max()
    # Maximal Poisson disc: the minimum spacing is at least the covering radius, up to sampling.
    assert widest <= nearest * 1.1


def test_sensors_are_where_they_may_be():
    body = covered("half", [solids.ball(1.0)], 50, lambda points: points[:, 0] > 0.2)
    assert (body.positions[:, 0] > 0.2).all()
    with pytest.raises(InputError, match="too small for"):
        covered("none", [solids.ball(1.0)], 50, lambda points: points[:, 0] > 2)


def test_shortest_paths_agree_with_closed_forms():
    pairs = np.triu_indices(30, 1)
    ball = sphere(30)
    found = replace(ball, geodesic=None).surface_distances
    np.testing.assert_allclose(found[pairs], great_circles(ball.positions)[pairs], rtol=0.02)
    tube = cylinder()
    x, y, z = tube.positions.T
    turn = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x)[:, None] - np.arctan2(y, x)))))
    side = np.hypot(0.5 * turn, z[:, None] - z)
    found = tube.surface_distances
    # Paths over an end of the cylinder can be shorter, except between the two middle rows.
    middle = np.abs(z) < 0.5
    near = np.ix_(middle, middle)
    np.testing.assert_allclose(found[near], side[near], rtol=0.02, atol=1e-12)
    assert (found <= side * 1.02 + 1e-12).all()


def test_surface_distances_go_around_a_hole():
    half, edge = 0.35, 0.3  # of the hole, and of the frame around it
    sides = [(half + edge, edge / 2, 0.1), (edge / 2, half, 0.1)]
    beside = half + edge / 2
    at = [[(0, beside, 0), (0, -beside, 0)], [(beside, 0, 0), (-beside, 0, 0)]]
    boxes = [solids.box(s, c) for s, both in zip(sides, at, strict=True) for c in both]
    body = covered("frame", boxes, 100, lambda points: points[:, 2] > 0.1 - 1e-9)
    found = body.surface_distances
    ratio = found / np.maximum(squareform(pdist(body.positions)), 1e-9)
    far = squareform(pdist(body.positions)) > 0.85
    assert ratio.max() > 1.3
    assert ratio[far].min() < 1.03  # beside the hole, the shortest path is straight


def test_a_body_from_points_leaves_all_sensors_exposed():
    for positions in (part.positions + np.array([3, 2, 1]) for part in (sphere(), hand(60))):
        body = body_from_points(positions)
        np.testing.assert_allclose(body.distance(body.positions), 0, atol=1e-9)
        np.testing.assert_allclose(body.positions + body.origin, positions, atol=1e-12)
    ball = sphere(200)
    estimated = body_from_points(ball.positions).normals
    assert (np.einsum("nd,nd->n", estimated, ball.normals) > np.cos(np.radians(12))).all()
    assert body_from_points(ball.positions).surface_distances is None
    far = sphere().positions + np.array([10, 20, 30])
    recording = simulate(body_from_points(far), "rubbing", n_frames=40)
    np.testing.assert_allclose(recording.positions, far, atol=1e-12)


@pytest.mark.slow
def test_a_robot_leg_is_simulated_from_positions(recordings_folder):
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    path = recordings_folder.parent / "geometry" / "icub_left_leg_upper.npz"
    if not path.exists():
        pytest.skip("needs the geometry of the robot")
    with np.load(path, allow_pickle=False) as part:
        positions = part["positions"]
    recording = simulate(body_from_points(positions, name="leg", units="m"), n_frames=500)
    np.testing.assert_allclose(recording.positions, positions, atol=1e-12)
    assert recording.n_sensors == 680
    assert recording.varying().mean() > 0.95
    assert float(recording.metadata["energy_drift"]) < 0.02


def test_invalid_positions_raise_an_error():
    for positions in (np.zeros((3, 3)), np.zeros((9, 2))):
        with pytest.raises(InputError, match=r"\(N, 3\) with N at least 4"):
            body_from_points(positions)
    with pytest.raises(InputError, match="sensors 0 and 3 coincide"):
        body_from_points(np.vstack([np.eye(3), [[1, 0, 0]]]))
