"""Theorems about the evidence for places: likelihoods, symmetries, repeats and agreement."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import Evidence, Move, coded, neighbour_spacing
from anisomap.layout.judging import agreement, agreement_gains, own_agreement
from anisomap.layout.modules import blocks_of_size, orientations, rigid_repeats
from anisomap.layout.readings import reading_statistics
from skins import rubbed, triangles

TRUTH = triangles(columns=2, rows=1)
seeds = st.integers(0, 10_000)


@pytest.fixture(scope="module")
def statistics():
    return reading_statistics(rubbed(TRUTH, 900, seed=420), np.random.default_rng(0))


@pytest.fixture(scope="module")
def evidence(statistics):
    usable = np.ones(len(TRUTH), dtype=bool)
    usable[7] = False
    return Evidence.of(statistics.similarity, TRUTH, usable, 1.0)


def total(evidence):
    """Sum the log-likelihood over pairs, one by one."""
    distances = cdist(evidence.positions, evidence.positions)
    pairs = [
        (i, j)
        for i in range(len(distances))
        for j in range(i)
        if evidence.usable[i] and evidence.usable[j]
    ]
    falloff = evidence.falloff
    return sum(
        float(falloff.table[falloff.bins(distances[i, j]), coded(evidence.similarity[i, j])])
        for i, j in pairs
    )


def random_move(evidence, seed):
    rng = np.random.default_rng(seed)
    sensors = rng.choice(len(TRUTH), int(rng.integers(1, 8)), replace=False)
    return Move(sensors, evidence.positions[sensors] + rng.normal(0, 3, (len(sensors), 2)))


@given(seeds)
@settings(max_examples=10)
def test_a_gain_is_the_difference_of_all_pairs_and_undone_by_the_return(evidence, seed):
    move = random_move(evidence, seed)
    expected = total(evidence.moved(move)) - total(evidence)
    assert evidence.gain(move) == pytest.approx(expected, abs=1e-3)
    back = Move(move.sensors, evidence.positions[move.sensors])
    assert evidence.moved(move).gain(back) == pytest.approx(-evidence.gain(move), abs=1e-6)


def test_similarity_falls_with_distance(evidence):
    falloff = evidence.falloff
    assert (np.diff(falloff.level) <= 1e-12).all()
    assert (falloff.spread > 0).all()
    assert falloff.level[0] > falloff.level[-1] + 0.3
    assert falloff.bins(np.array([0.0, 1.0, 1e9])).tolist() == [0, 0, len(falloff.level) - 1]


@given(seeds, st.sampled_from([2, 3]))
@settings(max_examples=20)
def test_spacing_ignores_the_frame_and_doubled_places(seed, k):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, k))
    turn = np.linalg.qr(rng.normal(size=(k, k)))[0]
    expected = neighbour_spacing(points)
    assert neighbour_spacing(5 * points @ turn + 3) == pytest.approx(5 * expected)
    assert neighbour_spacing(np.vstack([points, points[:9]])) == pytest.approx(expected)
    assert neighbour_spacing(np.zeros((4, k))) == 0


@pytest.mark.parametrize(
    ("name", "points", "expected"),
    [
        ("triangle", TRUTH[:10], 11),
        ("square", np.array([[x, y] for x in range(4) for y in range(4)], float), 7),
        ("rectangle", np.array([[x, y] for x in range(4) for y in range(2)], float), 3),
        ("scalene", np.array([[0.0, 0], [1, 0], [3, 0], [0, 1], [2, 1.8]]), 0),
        ("two", np.eye(2), 0),
    ],
)
def test_orientations_form_a_group(name, points, expected):
    found = [one for one in orientations(points) if not one.backwards]
    assert len(found) == expected + 1
    places = [one.places for one in found if one.fits]
    for one in found:
        moved = one.places
        np.testing.assert_allclose(cdist(moved, moved), cdist(points, points), atol=1e-9)
        sides = [np.linalg.det((p - p.mean(axis=0))[:2]) for p in (points, moved)]
        if abs(sides[0]) > 1e-9:
            assert one.reflected == (sides[0] * sides[1] < 0)
        if not one.fits:
            continue
        # One after another is among them, too.
        order = cdist(moved, points).argmin(axis=1)
        for other in places:
            assert min(np.abs(other[order] - p).max() for p in places) < 1e-9


@given(seeds, st.integers(5, 9))
@settings(max_examples=10)
def test_modules_are_found_by_their_repeats(seed, size):
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=(size, 2))
    placed = []
    for k in range(6):
        turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
        placed.append(shape @ turn + [20 * k, 0])
    points = np.vstack(placed)
    first = int(rng.integers(0, 50))
    numbers = first + np.arange(len(points))
    assert rigid_repeats(points, numbers) == (size, first % size)
    start, share = blocks_of_size(points, numbers, size)
    assert (start, share) == (first % size, 1)
    assert rigid_repeats(rng.normal(size=points.shape), numbers) == (0, 0)


def test_agreement_is_a_mean_of_similarities(evidence):
    everyone = np.arange(len(TRUTH))
    alone = np.array([agreement(evidence, np.array([i]), TRUTH[[i]])[0] for i in everyone])
    usable = evidence.usable
    np.testing.assert_allclose(alone[usable], own_agreement(evidence)[usable], atol=1e-6)
    assert (np.abs(alone[usable]) <= 1).all()
    # Sensors that move together are not neighbours of each other.
    assert np.isnan(agreement(evidence, everyone, TRUTH)).all()


def test_sensors_that_return_to_their_places_agree_better(evidence):
    swap = np.array([0, 30])  # far from each other
    misplaced = evidence.moved(Move(swap, evidence.positions[swap[::-1]]))
    gains = agreement_gains(misplaced, Move(swap, TRUTH[swap]))
    assert gains.min() > np.nanmedian(own_agreement(evidence)) / 2
    assert agreement_gains(evidence, Move(swap, TRUTH[swap])).size == 0


def test_adjacent_sensors_read_alike(statistics):
    off = ~np.eye(len(TRUTH), dtype=bool)
    np.testing.assert_array_equal(statistics.similarity, statistics.similarity.T)
    near = (cdist(TRUTH, TRUTH) < 1.2) & off
    assert statistics.similarity[near].mean() > 0.3
    assert statistics.tested.all()
    part = statistics.select(np.array([3, 1]))
    assert part.similarity[0, 1] == statistics.similarity[3, 1]
