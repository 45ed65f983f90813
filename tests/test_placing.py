"""Placing a map: recovery of the frame, errors, handedness, components, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

from anisomap import SensorMap, align
from anisomap.errors import InputError
from anisomap.placement import Anchors, anchors_from_map, parse_anchor, place
from skins import lattice

seeds = st.integers(0, 10_000)


def body(k, seed=0):
    """A flat lattice, or half a cylinder, in metres with a spacing of about 6 mm."""
    flat = lattice(8, 9) * 0.006
    if k == 2:
        return flat
    angle = flat[:, 0] / 0.015
    return np.column_stack([0.015 * np.cos(angle), 0.015 * np.sin(angle), flat[:, 1]])


def mapped(truth, seed, *, noise=0.0, mirror=False, **fields):
    """A noisy map in a frame and unit of its own."""
    rng = np.random.default_rng(seed)
    k = truth.shape[1]
    noisy = truth + rng.normal(0, noise, truth.shape)
    turn = special_ortho_group.rvs(k, random_state=rng)
    turn[0] *= -1 if mirror else 1
    return SensorMap(170 * noisy @ turn.T + rng.normal(size=k), **fields)


def anchors_at(truth, rows, names=None):
    return Anchors(tuple(names[i] if names else f"s{i}" for i in rows), truth[rows])


@given(seeds, st.sampled_from([2, 3]), st.booleans())
@settings(max_examples=30)
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
    shares = []
    for seed in range(40):
        truth = body(3 if seed % 2 else 2)
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(truth), 8, replace=False)
        found = place(mapped(truth, seed, noise=0.0015), anchors_at(truth, rows))
        rest = np.setdiff1d(np.arange(len(truth)), rows)
        off = np.linalg.norm(found.map.positions - truth, axis=1)[rest]
        shares.append(np.mean(off <= found.map.errors[rest]))
    assert 0.84 < np.mean(shares) < 0.97


def test_the_hand_is_right_or_the_map_is_refused():
    right = refused = 0
    for seed in range(100):
        truth = body(3 if seed % 2 else 2)
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(truth), rng.integers(3, 7), replace=False)
        try:
            mirror = bool(rng.integers(2))
            found = place(mapped(truth, seed, noise=0.0015, mirror=mirror), anchors_at(truth, rows))
        except InputError as error:
            assert "mirror image" in str(error) or "line" in str(error)  # noqa: PT017
            refused += 1
            continue
        right += found.map.mirrored is mirror
    assert right + refused == 100
    assert right > 50


def test_a_map_of_two_hands_is_refused():
    """Half of the map is mirrored in itself, as on feet, so few anchors may fit either hand."""
    truth = body(2)
    folded = truth.copy()
    half = truth[:, 1] < truth[:, 1].mean()
    folded[half, 0] = folded[:, 0].max() - folded[half, 0]
    refused = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(truth), rng.integers(3, 7), replace=False)
        sensor_map = mapped(folded, seed, noise=0.001, mirror=bool(seed % 2), uneven=True)
        try:
            place(sensor_map, anchors_at(truth, rows))
        except InputError as error:
            assert "mirror image" in str(error) or "line" in str(error)  # noqa: PT017
            refused += 1
    assert refused >= 54


def test_a_flat_map_is_not_placed_upside_down():
    flat = body(2)
    turn = special_ortho_group.rvs(3, random_state=3)
    truth = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T
    placed = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(truth), 3, replace=False)
        try:
            found = place(mapped(flat, seed, noise=0.0015), anchors_at(truth, rows))
        except InputError:
            continue
        placed += 1
        # The wrong one of two rotations would put the long way of the skin right, the other wrong.
        assert np.median(np.linalg.norm(found.map.positions - truth, axis=1)) < 0.006
    assert placed > 30


@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.parametrize("mirror", [False, True])
def test_normals_of_three_anchors_tell_the_hand(mirror, inwards):
    truth = body(3)
    rows = [10, 34, 57]
    outward = truth[rows] * [1.0, 1.0, 0.0] * (-5 if inwards else 5)
    sensor_map = mapped(truth, 4, noise=3e-4, mirror=mirror)
    names = tuple(f"s{i}" for i in rows)
    with pytest.raises(InputError, match="normals of the anchors"):
        place(sensor_map, Anchors(names, truth[rows]))
    found = place(sensor_map, Anchors(names, truth[rows], outward))
    assert found.map.mirrored is mirror
    assert np.median(np.linalg.norm(found.map.positions - truth, axis=1)) < 0.002


@pytest.mark.parametrize("mirror", [False, True])
def test_normals_tell_the_hand_of_a_flat_map(mirror):
    flat = body(2)
    truth = np.column_stack([flat, np.zeros(len(flat))])
    sensor_map, names = mapped(flat, 1, mirror=mirror), ("s0", "s8", "s66")
    assert not place(sensor_map, Anchors(names, truth[[0, 8, 66]])).map.handed
    found = place(sensor_map, Anchors(names, truth[[0, 8, 66]], np.tile([0.0, 0.0, 2.0], (3, 1))))
    assert (found.map.handed, found.map.mirrored) == (True, mirror)
    with pytest.raises(InputError, match="normals of anchors need three coordinates"):
        Anchors(names, flat[[0, 8, 66]], np.ones((3, 3)))


def test_four_anchors_are_nearly_as_good_as_all():
    ratios = []
    for seed in range(30):
        truth = body(2)
        sensor_map = mapped(truth, seed, noise=0.002)
        rows = [0, 8, 63, 71]
        found = place(sensor_map, anchors_at(truth, rows))
        rest = np.setdiff1d(np.arange(len(truth)), rows)
        off = np.linalg.norm(found.map.positions - truth, axis=1)[rest]
        ratios.append(np.sqrt(np.mean(off**2)) / align(sensor_map.positions, truth).rms)
    assert np.median(ratios) < 1.2


def test_a_smooth_field_corrects_a_bent_map_and_leaves_a_straight_one():
    gains = []
    for bend in (0.0, 6.0):
        for seed in range(6):
            truth = body(2)
            bent = truth + bend * truth[:, ::-1] ** 2
            rng = np.random.default_rng(seed)
            rows = rng.choice(len(truth), 20, replace=False)
            found = place(mapped(bent, seed, noise=3e-4), anchors_at(truth, rows))
            few = place(mapped(bent, seed, noise=3e-4), anchors_at(truth, rows[:6]))
            off, off_few = (np.sqrt(np.mean((p.map.positions - truth) ** 2)) for p in (found, few))
            gains.append(off_few / off)
            if bend:
                assert "smooth field" in found.methods[0]
    assert np.median(gains[:6]) > 0.9
    assert np.median(gains[6:]) > 2


def test_components_with_anchors_of_their_own_share_a_frame():
    truth = np.vstack([body(2) + shift for shift in np.array([[0, 0], [0.2, 0.1], [0.4, 0]])])
    n = len(truth) // 3
    names = tuple(f"n{i}" for i in range(3 * n))
    component = np.repeat([0, 1, 2], n)
    parts = [mapped(truth[component == c], c).positions for c in range(3)]
    sensor_map = SensorMap(np.vstack(parts), names=names, component=component)
    rows = [0, 8, 66, n, n + 8, n + 66, 2 * n]
    found = place(sensor_map, anchors_at(truth, rows, names))
    np.testing.assert_allclose(found.map.positions[: 2 * n], truth[: 2 * n], atol=1e-9)
    assert found.map.component_sizes == (2 * n,)
    assert found.left_out == names[2 * n :]
    assert "n144" in found.map.notes[-1]
    assert found.methods[2].startswith("not placed: ")


def test_a_flat_map_lies_in_space_where_its_anchors_are():
    flat = body(2)
    turn = special_ortho_group.rvs(3, random_state=3)
    truth = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T + [0.1, 0, 0.3]
    for mirror in (False, True):
        found = place(mapped(flat, 1, mirror=mirror), anchors_at(truth, [0, 8, 66]))
        np.testing.assert_allclose(found.map.positions, truth, atol=1e-9)


def test_stating_the_hand_places_what_would_be_refused():
    truth = body(3)
    sensor_map, three = mapped(truth, 0, mirror=True), anchors_at(truth, [0, 8, 66])
    with pytest.raises(InputError, match="map a flat skin in 2D"):
        place(sensor_map, three)
    found = place(sensor_map, three, handedness="mirrored")
    np.testing.assert_allclose(found.map.positions, truth, atol=1e-9)
    with pytest.raises(InputError, match="contradict the stated handedness"):
        place(sensor_map, anchors_at(truth, [0, 8, 66, 31, 40]), handedness="same")


def test_a_spacing_alone_gives_metres():
    found = place(mapped(body(2), 0), spacing=(6.0, "mm"))
    assert found.map.units == "m"
    assert not found.map.anchored
    assert not found.map.handed
    assert found.map.known_up_to == "rotation, translation and reflection"
    assert place(mapped(body(2), 0), spacing=(6, "mm"), handedness="same").map.handed


def test_incomplete_knowledge_is_refused_with_what_would_settle_it():
    truth = body(2)
    sensor_map = mapped(truth, 0)
    for rows, message in (
        ([0], "need at least 2 anchors, got 1"),
        ([0, 8], "a third anchor off their line"),
        ([0, 4, 8], "more anchors off their line"),
    ):
        with pytest.raises(InputError, match=message):
            place(sensor_map, anchors_at(truth, rows))
    with pytest.raises(InputError, match="on a line"):
        place(mapped(body(3), 0), anchors_at(body(3), [0, 18, 36]))
    with pytest.raises(InputError, match="nothing places the map"):
        place(sensor_map)
    with pytest.raises(InputError, match="anchor x is no sensor of the map"):
        place(sensor_map, Anchors(("x", "s1", "s2"), truth[:3]))
    with pytest.raises(InputError, match="three coordinates"):
        place(mapped(body(3), 0), anchors_at(truth, [0, 8, 66]))
    placed = place(sensor_map, anchors_at(truth, [0, 8, 66])).map
    with pytest.raises(InputError, match="in the frame of the robot already"):
        place(placed, anchors_at(truth, [0, 8, 66]))


@pytest.mark.parametrize("k", [2, 3])
@pytest.mark.parametrize(
    ("factor", "message"),
    [(0, "all the same"), (1e-200, "all the same"), (1e200, "out of range")],
)
def test_anchors_at_one_place_or_out_of_range_are_refused(k, factor, message):
    rows = [0, 8, 66, 31, 40]
    wrong = factor * body(k) + (0.3 if factor == 0 else 0)
    for stated in ({}, {"handedness": "same"}):
        with pytest.raises(InputError, match=message):
            place(mapped(body(k), 0), anchors_at(wrong, rows), **stated)


def test_a_stated_hand_does_not_tell_the_sides_of_a_flat_map():
    """Three anchors fit a distorted map in space about as well from either side."""
    flat, rows = body(2), [0, 22, 8]
    truth = np.column_stack([flat, np.zeros(len(flat))])
    for stated in ({}, {"handedness": "same"}):
        with pytest.raises(InputError, match="sides of the flat map; give more anchors off"):
            place(mapped(flat, 0, uneven=True), anchors_at(truth, rows), **stated)


def test_anchors_are_read():
    assert parse_anchor("s17=0.012,0.040,-3e-3") == ("s17", (0.012, 0.04, -0.003))
    assert parse_anchor("a=b=1,2") == ("a=b", (1.0, 2.0))
    for text in ("", "s1", "s1=", "=1,2", "s1=1", "s1=1,2,3,4", "s1=a,b", "s1=nan,1"):
        with pytest.raises(InputError, match="is not an anchor; write a sensor and its position"):
            parse_anchor(text)
    layout = SensorMap([[1.0, 2], [np.nan, 0]], names=("a", "b"), units="mm")
    found = anchors_from_map(layout)
    assert found.names == ("a",)
    np.testing.assert_allclose(found.positions, [[1e-3, 2e-3]])
    with pytest.raises(InputError, match="unit of the anchors is unknown"):
        anchors_from_map(SensorMap([[1.0, 2]]))
    with pytest.raises(InputError, match="given more than once"):
        Anchors(("a", "a"), np.zeros((2, 2)))
