"""Coverage by place: contacts are counted rightly, and the next places are where they lack."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap import InputError, Recording, SensorMap
from anisomap.health import next_places, touch_coverage
from anisomap.health.touch_coverage import ENOUGH_CONTACTS, needed_evidence, neighbouring_sensors
from anisomap.numerics.signals import count_contacts, count_joint_contacts


def lattice(rows, columns):
    return np.array([(x, y) for x in range(rows) for y in range(columns)], dtype=float)


def pressed(places, touches, radius=1.6):
    """Readings of sensors at `places`: one frame per touch, with a frame of rest after each."""
    depth = np.maximum(0, radius - np.linalg.norm(touches[:, None] - places, axis=2))
    return np.repeat(depth, 2, axis=0) * (np.arange(2 * len(touches)) % 2 == 0)[:, None]


def runs_of(series):
    return sum(on for on, _ in groupby(series))


def test_a_sensor_at_an_absurd_place_has_neighbours_in_the_map() -> None:
    """A damaged file may hold any finite coordinates, whose squares overflow."""
    places = np.vstack([lattice(2, 2), [[1e70, 0]]])
    pairs = neighbouring_sensors(places)
    assert pairs.max() < len(places)


activity = arrays(bool, st.tuples(st.integers(1, 12), st.integers(2, 5)))


@given(activity)
def test_contacts_are_runs_of_active_frames(active):
    n = active.shape[1]
    pairs = np.array([(i, j) for i in range(n) for j in range(i)])
    assert count_contacts(active).tolist() == [runs_of(column) for column in active.T]
    assert count_joint_contacts(active, pairs).tolist() == [
        runs_of(active[:, i] & active[:, j]) for i, j in pairs
    ]


def test_neighbours_of_a_square_lattice_include_its_diagonals():
    pairs = neighbouring_sensors(lattice(5, 4))
    straight, diagonal = 5 * 3 + 4 * 4, 2 * 4 * 3
    assert len(pairs) == straight + diagonal
    lengths = np.linalg.norm(np.diff(lattice(5, 4)[pairs], axis=1), axis=2)
    assert lengths.max() < 1.5


def test_sensors_of_different_pieces_or_without_a_place_are_no_neighbours():
    places = np.vstack([lattice(3, 3), lattice(3, 3) + 0.5, [[np.nan, np.nan]]])
    component = np.repeat([0, 1, -1], [9, 9, 1])
    pairs = neighbouring_sensors(places, component)
    assert pairs.max() < 18
    assert np.array_equal(component[pairs[:, 0]], component[pairs[:, 1]])


@pytest.mark.parametrize("seed", range(5))
def test_the_first_place_is_the_corner_that_was_not_touched(seed):
    rng = np.random.default_rng(seed)
    places = lattice(10, 10)
    touches = rng.uniform(-0.5, 9.5, (1500, 2))
    spared = rng.permutation(np.array([(1, 1), (1, 8), (8, 1), (8, 8)]))[0]
    touches = touches[np.linalg.norm(touches - spared, axis=1) > 3]
    turned = 3 * places @ np.linalg.qr(rng.normal(size=(2, 2)))[0]
    found = touch_coverage(SensorMap(turned), pressed(places, touches))
    first = found.places[0]
    nearest = np.linalg.norm(places[list(first.sensors)] - spared, axis=1)
    assert nearest.max() <= 3
    assert all(found.need[i] > 0 for i in first.sensors)
    # Pairs that were not touched together lie there, too.
    assert found.never_together.size
    assert np.linalg.norm(places[found.never_together] - spared, axis=2).max() <= 3


def test_touching_the_places_that_are_named_leaves_none_to_touch():
    rng = np.random.default_rng(3)
    places = lattice(8, 8)
    touches = rng.uniform((0, 0), (5, 7), (300, 2))
    sensor_map = SensorMap(places)
    for _ in range(20):
        found = touch_coverage(sensor_map, pressed(places, touches))
        if not found.places:
            break
        strokes = [
            place.centre + rng.uniform(-1.5, 1.5, (2 * ENOUGH_CONTACTS, 2))
            for place in found.places
        ]
        touches = np.vstack([touches, *strokes])
    assert not found.places
    assert np.median(found.contacts) >= ENOUGH_CONTACTS


@given(st.integers(0, 2**32 - 1))
def test_places_share_no_sensor_and_come_in_order_of_need(seed):
    rng = np.random.default_rng(seed)
    points, need = rng.normal(size=(40, 3)), rng.uniform(size=40) * (rng.uniform(size=40) < 0.5)
    places = next_places(points, need, n_places=6)
    listed = [i for place in places for i in place.sensors]
    assert len(listed) == len(set(listed))
    assert all(np.diff([place.need for place in places]) <= 1e-9)
    for place in places:
        assert place.need == pytest.approx(need[list(place.sensors)].sum())
        assert place.radius == pytest.approx(
            np.linalg.norm(points[list(place.sensors)] - place.centre, axis=1).max()
        )


def test_evidence_is_complete_only_with_enough_joint_contacts():
    pairs = np.array([(0, 1), (1, 2)])
    full = [ENOUGH_CONTACTS] * 3
    assert not needed_evidence(full, pairs, [ENOUGH_CONTACTS, ENOUGH_CONTACTS]).any()
    apart = needed_evidence(full, pairs, [ENOUGH_CONTACTS, 0])
    assert apart.tolist() == [0, 0.5, 1]
    pieces = needed_evidence(full, pairs, full[:2], component=[0, 0, 1])
    assert pieces.tolist() == [0, 0, 1]


def test_runs_that_lack_sensors_add_up_by_name():
    rng = np.random.default_rng(1)
    places = lattice(5, 5)
    whole = Recording(pressed(places, rng.uniform(0, 4, (200, 2))))
    sensor_map = SensorMap(places)
    together = touch_coverage(sensor_map, whole)
    order = rng.permutation(25)
    first = replace(whole, readings=whole.readings[:200])
    second = replace(whole, readings=whole.readings[200:]).select(order[:20])
    found = touch_coverage(sensor_map, [first, second])
    kept = np.isin(np.arange(25), order[:20])
    assert np.array_equal(found.contacts[kept], together.contacts[kept])
    assert (found.contacts[~kept] <= together.contacts[~kept]).all()
    with pytest.raises(InputError, match="must have the same sensors"):
        touch_coverage(sensor_map, whole.select(order[:20]))


def test_missing_readings_are_no_contact():
    readings = np.array(pressed(lattice(4, 4), np.random.default_rng(0).uniform(0, 3, (100, 2))))
    readings[:, 5] = np.nan
    found = touch_coverage(SensorMap(lattice(4, 4)), readings)
    assert found.untouched.tolist() == [5]
    assert 5 in found.places[0].sensors
