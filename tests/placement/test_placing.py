"""Placing a map: frame, errors, handedness, components, scale, meshes, refusals."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.placing.placement import outline
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

import anisomap
from anisomap import SensorMap, align, evaluation, reconstruct
from anisomap.errors import InputError
from anisomap.map_verdict import Verdict
from anisomap.notes import Note
from anisomap.numerics.surfaces import Mesh, TriangleSearch
from anisomap.placement import (
    Anchors,
    anchors_from_map,
    median_spacing,
    mirrored,
    parse_anchor,
    parse_length,
    place,
    scaled_to_spacing,
    spacing_on_skin,
    surface_normals,
    to_taxels,
)
from anisomap.placement.placing import errors_of_sensors, headline, judgement
from anisomap.simulation import find_body, simulate, solids
from anisomap.simulation.bodies import covered
from skins import flat_map, lattice

seeds = st.integers(0, 1000)


def body(k):
    """A flat lattice, or half a cylinder, in metres with a spacing of about 6 mm."""
    flat = lattice(8, 9) * 0.006
    if k == 2:
        return flat
    angle = flat[:, 0] / 0.015
    return np.column_stack([0.015 * np.cos(angle), 0.015 * np.sin(angle), flat[:, 1]])


def in_space(flat):
    return np.column_stack([flat, np.zeros(len(flat))])


def mapped(truth, seed, *, noise=0.0, mirror=False, **fields):
    """A noisy map in a frame and unit of its own."""
    rng = np.random.default_rng(seed)
    k = truth.shape[1]
    noisy = truth + rng.normal(0, noise, truth.shape)
    turn = special_ortho_group.rvs(k, random_state=rng)
    turn[0] *= -1 if mirror else 1
    return SensorMap(170 * noisy @ turn.T + rng.normal(size=k), **fields)


def anchors_at(truth, rows):
    return Anchors(tuple(f"s{i}" for i in rows), truth[rows])


def placed_or_refused(sensor_map, truth, rows, **options):
    """Return None if the anchors do not tell the hand, or the side of a flat map."""
    try:
        return place(sensor_map, anchors_at(truth, rows), **options)
    except InputError as error:
        assert re.search("mirror image|line|sides", str(error))  # noqa: PT017
        return None


def some_rows(truth, seed, count):
    return np.random.default_rng(seed).choice(len(truth), count, replace=False)


def off(found, truth):
    return np.linalg.norm(found.map.positions - truth, axis=1)


@given(seeds, st.sampled_from([2, 3]), st.booleans())
@settings(max_examples=20)
def test_anchors_recover_the_frame_of_an_exact_map(seed, k, mirror):
    truth = body(k)
    rows = [0, 8, 66, 31, 40] if k == 3 else [0, 8, 66]
    found = place(mapped(truth, seed, mirror=mirror), anchors_at(truth, rows))
    np.testing.assert_allclose(found.map.positions, truth, atol=1e-9)
    assert (found.map.units, found.map.anchored, found.map.handed) == ("m", True, True)
    assert found.map.mirrored is mirror
    np.testing.assert_allclose(found.residuals, 0, atol=1e-9)
    assert np.isnan(found.left_out_errors).all() == (len(rows) < 5)


def test_nine_of_ten_sensors_are_within_their_errors():
    """And anchors are nearly as good as knowing all sensors."""
    shares, ratios = [], []
    for seed in range(24):
        truth = body(3 if seed % 2 else 2)
        rows = some_rows(truth, seed, 8)
        sensor_map = mapped(truth, seed, noise=0.0015)
        found = place(sensor_map, anchors_at(truth, rows))
        rest = np.setdiff1d(np.arange(len(truth)), rows)
        errors = off(found, truth)[rest]
        shares.append(np.mean(errors <= found.map.errors[rest]))
        ratios.append(np.sqrt(np.mean(errors**2)) / align(sensor_map.positions, truth).rms)
    standard_error = np.std(shares) / len(shares) ** 0.5
    assert np.mean(shares) == pytest.approx(0.9, abs=4 * standard_error)
    assert np.median(ratios) < 1.5


def test_the_hand_is_right_or_the_map_is_refused():
    right = []
    for seed in range(40):
        truth = body(3 if seed % 2 else 2)
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(truth), rng.integers(3, 7), replace=False)
        mirror = bool(rng.integers(2))
        sensor_map = mapped(truth, seed, noise=0.0015, mirror=mirror)
        if found := placed_or_refused(sensor_map, truth, rows):
            right.append(found.map.mirrored is mirror)
    assert all(right)
    assert len(right) > 10


def test_a_map_of_two_hands_is_refused():
    """Half of the map is mirrored in itself, as on feet, so few anchors may fit either hand."""
    truth = body(2)
    folded = truth.copy()
    half = truth[:, 1] < truth[:, 1].mean()
    folded[half, 0] = folded[:, 0].max() - folded[half, 0]
    placed = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(truth), rng.integers(3, 7), replace=False)
        sensor_map = mapped(folded, seed, noise=0.001, mirror=bool(seed % 2), distorted=True)
        placed.append(placed_or_refused(sensor_map, truth, rows) is not None)
    assert np.mean(placed) < 0.25


def test_a_flat_map_is_not_placed_upside_down():
    """The wrong one of two rotations puts the long way of the skin right, the other wrong."""
    flat = body(2)
    truth = in_space(flat) @ special_ortho_group.rvs(3, random_state=3).T
    errors = []
    for seed in range(40):
        sensor_map = mapped(flat, seed, noise=0.0015)
        if found := placed_or_refused(sensor_map, truth, some_rows(truth, seed, 3)):
            errors.append(np.median(off(found, truth)))
    assert max(errors) < 0.01
    assert len(errors) > 5


@pytest.mark.parametrize("mirror", [False, True])
def test_a_flat_map_lies_in_space_where_its_anchors_are(mirror):
    flat, rows = body(2), [0, 8, 66]
    turn = special_ortho_group.rvs(3, random_state=3)
    truth = in_space(flat) @ turn.T + [0.1, 0, 0.3]
    found = place(mapped(flat, 1, mirror=mirror), anchors_at(truth, rows))
    np.testing.assert_allclose(found.map.positions, truth, atol=1e-9)
    assert not found.map.handed


def test_a_smooth_field_corrects_a_bent_map_and_leaves_a_straight_one():
    truth = body(2)
    gains = {0.0: [], 6.0: []}
    for bend, found in gains.items():
        bent = truth + bend * truth[:, ::-1] ** 2
        for seed in range(6):
            rows = some_rows(truth, seed, 20)
            sensor_map = mapped(bent, seed, noise=3e-4)
            many, few = (place(sensor_map, anchors_at(truth, rows[:n])) for n in (20, 6))
            assert bend == 0 or "smooth field" in many.methods[0]
            found.append(np.linalg.norm(off(few, truth)) / np.linalg.norm(off(many, truth)))
    assert np.median(gains[0.0]) > 0.8
    assert np.median(gains[6.0]) > 1.5


def test_components_with_anchors_of_their_own_share_a_frame():
    truth = np.vstack([body(2) + shift for shift in np.array([[0, 0], [0.2, 0.1], [0.4, 0]])])
    n = len(truth) // 3
    component = np.repeat([0, 1, 2], n)
    parts = [mapped(truth[component == c], c).positions for c in range(3)]
    sensor_map = SensorMap(np.vstack(parts), component=component)
    found = place(sensor_map, anchors_at(truth, [0, 8, 66, n, n + 8, n + 66, 2 * n]))
    np.testing.assert_allclose(found.map.positions[: 2 * n], truth[: 2 * n], atol=1e-9)
    assert found.map.component_sizes == (2 * n,)
    assert found.left_out == sensor_map.names[2 * n :]
    assert "s144" in found.map.notes[-1]
    assert found.methods[2].startswith("not placed: ")


def test_stating_the_hand_places_what_would_be_refused():
    truth = body(3)
    sensor_map, three = mapped(truth, 0, mirror=True), anchors_at(truth, [0, 8, 66])
    with pytest.raises(InputError, match="map a flat skin in 2D"):
        place(sensor_map, three)
    found = place(sensor_map, three, handedness="mirrored")
    np.testing.assert_allclose(found.map.positions, truth, atol=1e-9)
    with pytest.raises(InputError, match="in the frame of the robot already"):
        place(found.map, three)
    with pytest.raises(InputError, match="contradict the stated handedness"):
        place(sensor_map, anchors_at(truth, [0, 8, 66, 31, 40]), handedness="same")


def test_a_spacing_alone_gives_metres():
    found = place(mapped(body(2), 0), spacing=(6.0, "mm")).map
    assert (found.units, found.anchored, found.handed) == ("m", False, False)
    assert found.known_up_to == "rotation, translation and reflection"
    assert place(mapped(body(2), 0), spacing=(6, "mm"), handedness="same").map.handed
    with pytest.raises(InputError, match="spacing must be positive, got -1"):
        place(mapped(body(2), 0), spacing=(-1, "mm"))


FLAT, CURVED = body(2), body(3)
FIVE = [0, 8, 66, 31, 40]


@pytest.mark.parametrize(
    ("truth", "anchors", "message"),
    [
        (FLAT, anchors_at(FLAT, [0]), "need at least 2 anchors, got 1"),
        (FLAT, anchors_at(FLAT, [0, 8]), "a third anchor off their line"),
        (FLAT, anchors_at(FLAT, [0, 4, 8]), "more anchors off their line"),
        (CURVED, anchors_at(CURVED, [0, 18, 36]), "on a line"),
        (FLAT, None, "the map has no scale"),
        (FLAT, Anchors(("x", "s1", "s2"), FLAT[:3]), "names are s0 .*unknown sensors: x"),
        (CURVED, anchors_at(FLAT, [0, 8, 66]), "three coordinates"),
        *(
            (truth, anchors_at(factor * truth + shift, FIVE), message)
            for truth in (FLAT, CURVED)
            for factor, shift, message in ((0, 0.3, "same position"), (1e-200, 0, "same position"))
        ),
    ],
)  # fmt: skip
def test_incomplete_knowledge_is_refused_with_what_would_settle_it(truth, anchors, message):
    with pytest.raises(InputError, match=message):
        place(mapped(truth, 0), anchors)


@pytest.mark.parametrize("stated", ["", "same"])
def test_a_stated_hand_does_not_tell_the_sides_of_a_flat_map(stated):
    """Three anchors fit a distorted map in space about as well from either side."""
    anchors = anchors_at(in_space(FLAT), [0, 22, 8])
    with pytest.raises(InputError, match="sides of the flat map; give more anchors off"):
        place(mapped(FLAT, 0, distorted=True), anchors, handedness=stated)


def test_anchors_are_read():
    assert parse_anchor("s17=0.012,0.040,-3e-3") == ("s17", (0.012, 0.04, -0.003))
    assert parse_anchor("a=b=1,2") == ("a=b", (1.0, 2.0))
    for text in ("s1", "=1,2", "s1=1", "s1=1,2,3,4", "s1=a,b", "s1=nan,1"):
        with pytest.raises(InputError, match="is not an anchor in metres"):
            parse_anchor(text)
    layout = SensorMap([[1.0, 2], [np.nan, 0]], names=("a", "b"), units="mm")
    found = anchors_from_map(layout)
    assert found.names == ("a",)
    np.testing.assert_allclose(found.positions, [[1e-3, 2e-3]])
    with pytest.raises(InputError, match="unit of the anchors is unknown"):
        anchors_from_map(SensorMap([[1.0, 2]]))
    with pytest.raises(InputError, match="given more than once"):
        Anchors(("a", "a"), np.zeros((2, 2)))


def some_map(seed, n_sensors=20, dimensions=3):
    return SensorMap(np.random.default_rng(seed).normal(size=(n_sensors, dimensions)))


@given(seeds, st.sampled_from([2, 3]), st.floats(1e-3, 1e3))
@settings(max_examples=20)
def test_scaling_and_reflection_keep_the_shape(seed, dimensions, spacing):
    before = some_map(seed, dimensions=dimensions)
    after = scaled_to_spacing(before, spacing, "mm")
    assert median_spacing(after) == pytest.approx(spacing)
    assert after.units == "mm"
    np.testing.assert_allclose(after.positions, after.provenance["scale"] * before.positions)
    image = mirrored(before)
    assert align(image.positions, before.positions).reflected
    again = mirrored(image)
    assert (image.mirrored, again.mirrored) == (True, False)
    np.testing.assert_array_equal(again.positions, before.positions)


@pytest.mark.parametrize(("body", "dimensions"), [("hexagon", 2), ("sphere", 3)])
def test_lengths_are_right_despite_the_errors_of_a_map(body, dimensions):
    ratios = []
    for seed in range(3):
        skin = simulate(body, "rubbing", n_frames=2000, seed=seed)
        spacing = evaluation.median_spacing(skin.positions)
        made = reconstruct(skin, dimensions=dimensions)
        scaled = scaled_to_spacing(made, spacing, "mm")
        placed = place(made, spacing=(spacing, "mm")).map
        assert spacing_on_skin(scaled) == pytest.approx(spacing)
        assert 1000 * spacing_on_skin(placed) == pytest.approx(placed.provenance["spacing"])
        ratios.append(align(scaled.positions, skin.positions).scale)
    assert np.median(ratios) == pytest.approx(1, abs=0.2)


def test_components_share_a_scale_and_have_separate_normals():
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    positions = np.vstack([grid, grid[:, ::-1] + 0.1, [[np.nan, np.nan]]])
    found = SensorMap(positions, component=[0] * 16 + [1] * 16 + [-1])
    assert median_spacing(found) == 1  # sensors of the other component are not neighbours
    assert median_spacing(scaled_to_spacing(found, 6.5, "mm")) == pytest.approx(6.5)
    with pytest.raises(InputError, match="spacing of the map is undefined"):
        median_spacing(SensorMap(np.zeros((3, 2))))
    normals = surface_normals(found)
    np.testing.assert_array_equal(normals[:32], np.tile([0, 0, 1], (32, 1)))
    assert np.isnan(normals[32]).all()


def test_taxels_are_in_metres_and_their_frames_have_z_along_the_normal():
    skin = to_taxels(scaled_to_spacing(some_map(3), 4.0, "mm"), "a test")
    assert skin.frame == "skin"
    frames = skin.rotations.as_matrix()
    np.testing.assert_allclose(frames[:, :, 2], skin.normals, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1)
    spaced = SensorMap(skin.positions)
    assert median_spacing(spaced) == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("6.5mm", (6.5, "mm")), (" 2 cm ", (2, "cm")), ("1e-3m", (1e-3, "m")), ("4um", (4, "um"))]
    + [(text, None) for text in ("", "6.5", "-1mm", "6.5 furlong", "1e999m")],
)
def test_lengths_are_read_or_refused(text, expected):
    if expected is not None:
        assert parse_length(text) == expected
        return
    with pytest.raises(InputError, match="is not a length"):
        parse_length(text)


@pytest.mark.parametrize(
    ("sensor_map", "message"),
    [
        (some_map(0), "a test needs positions in metres, but the unit of the map is"),
        (SensorMap(np.eye(3), component=[0, 0, 1], units="mm"), "needs one connected component"),
        (SensorMap(np.eye(4), units="m"), "at most 3 dimensions, got 4"),
    ],
)
def test_maps_without_poses_in_metres_are_rejected(sensor_map, message):
    with pytest.raises(InputError, match=message):
        to_taxels(sensor_map, "a test")


def mapped_body(found, seed):
    """A map of a body with a noise of a fifth of a spacing, mirrored at random."""
    mirror = bool(np.random.default_rng(seed + 1).integers(2))
    return mapped(found.positions, seed, noise=0.2 * found.spacing, mirror=mirror)


@pytest.mark.parametrize("name", ["cylinder", pytest.param("y-shape", marks=pytest.mark.slow)])
def test_three_anchors_place_a_map_on_its_mesh_or_it_is_refused(name):
    found = find_body(name)
    mesh = outline(found)
    surface = TriangleSearch(mesh)
    errors, inside = [], []
    for seed in range(5):
        sensor_map, rows = mapped_body(found, seed), some_rows(found.positions, seed, 3)
        placement = placed_or_refused(sensor_map, found.positions, rows, mesh=mesh)
        if placement is None:
            continue
        placed = placement.map
        assert placed.mirrored == align(sensor_map.positions, found.positions).reflected
        nearest, _ = surface.nearest(placed.positions)
        np.testing.assert_allclose(placed.positions, nearest, atol=1e-2 * found.spacing)
        errors.append(np.median(off(placement, found.positions)) / found.spacing)
        inside.append(np.einsum("nd,nd->n", placed.normals, found.normals))
    assert np.median(errors) < 0.6
    assert np.median(np.concatenate(inside)) > 0.9


def test_a_mesh_that_does_not_fit_is_refused():
    found = find_body("sphere")
    mesh, made = outline(found), mapped_body(found, 0)
    rows = [0, 20, 41, 55, 13]
    anchors = anchors_at(found.positions, rows)
    flat = SensorMap(made.positions[:, :2])
    for sensor_map, known, vertices, faces, message in (
        (made, anchors, 1000 * mesh.vertices, mesh.faces, "check the unit and frame of the mesh"),
        (made, None, mesh.vertices, mesh.faces, "give at least 3 anchors"),
        (made, anchors, mesh.vertices, np.empty((0, 3), int), "triangles with finite vertices"),
        # The areas overflow.
        (made, anchors, 1e200 * mesh.vertices, mesh.faces, "of a mesh must be at most"),
        (flat, Anchors(anchors.names, anchors.positions[:, :2]), mesh.vertices, mesh.faces,
         "anchors on a mesh must have three coordinates"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            place(sensor_map, known, mesh=Mesh(vertices, faces))


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(find_body("hand"), marks=pytest.mark.slow),
        covered("tube", [solids.cylinder(0.5, 1.0)], 100),
    ],
    ids=lambda body: body.name,
)
def test_a_mesh_straightens_a_map_that_is_bent_smoothly(found):
    """A similarity leaves most of a bend; the surface tells it."""
    mesh = outline(found)
    size = np.abs(found.positions).max()
    bent = found.positions * [1, 1.2, 0.9] + 0.15 * found.positions[:, [2, 0, 1]] ** 2 / size
    left = np.median(align(bent, found.positions).errors) / found.spacing
    errors = []
    for seed in range(4):
        rows = some_rows(found.positions, seed, 3)
        known = {"mesh": mesh, "handedness": "same"}
        if placement := placed_or_refused(SensorMap(bent), found.positions, rows, **known):
            errors.append(np.median(off(placement, found.positions)) / found.spacing)
    assert np.median(errors) < 0.5 * left


ERRORS = (0.2, 0.1, 0.6, 0.16, 0.12, 0.32, 0.9, 0.8, 1.0, 0.25)


@pytest.fixture
def judged():
    reasons = (Note("chance", size=0.24, much=False), "touched once")
    made = flat_map()
    spread = np.broadcast_to(0.01 * np.eye(2), (made.n_sensors, 2, 2))
    return replace(made, verdict=Verdict("usable", *ERRORS, reasons=reasons), covariances=spread)


def test_every_error_is_in_millimetres_once_the_scale_is_known(judged, tmp_path):
    assert "0.20 spacings (0.10 to 0.60)" in headline(judged)
    scaled = scaled_to_spacing(judged, 6.5, "mm")
    told = judgement(scaled)
    assert told[0] == "Usable: positions are accurate to about 1.3 mm (0.65 to 3.9)."
    assert "Maps of resampled recordings differ by 1.56 mm." in told
    assert "Touched once." in told
    assert "assume a median distance of 6.5 mm" in told[-1]
    assert not any("spacings" in one.replace("radius of 5 spacings", "") for one in told)
    assert judgement(scaled_to_spacing(judged, 0.0065, "m")) == told
    anisomap.write(scaled, tmp_path / "map.json")
    stated = json.loads((tmp_path / "map.json").read_text())["verdict"]
    assert stated["expected_error_mm"] == pytest.approx(6.5 * stated["expected_error"])
    again = anisomap.read_map(tmp_path / "map.json")
    assert again.verdict.expected_error == 0.2
    assert judgement(again) == told


def test_the_error_of_a_sensor_holds_nine_of_ten(judged):
    drawn = np.random.default_rng(0).multivariate_normal([0, 0], judged.covariances[0], 20_000)
    within = np.linalg.norm(drawn, axis=1) <= errors_of_sensors(judged)[0]
    assert within.mean() == pytest.approx(0.9, abs=0.01)
