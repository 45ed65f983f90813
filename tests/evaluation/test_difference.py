"""Differences between two maps: invariance, false alarms, and the sensors that moved."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ortho_group

from anisomap import SensorMap
from anisomap.errors import InputError
from anisomap.evaluation import compare_maps
from anisomap.numerics.procrustes import fit_similarity, fit_similarity_robustly
from skins import lattice, moved_freely

seeds = st.integers(0, 10_000)
few = settings(max_examples=15)


def two_maps(seed, *, noise=0.05, rows=9, columns=10):
    """Return a lattice and a noisy, smoothly bent copy in another frame."""
    rng = np.random.default_rng(seed)
    before = lattice(rows, columns)
    bent = before + 0.02 * before[:, ::-1] ** 2 / columns
    after = moved_freely(bent + rng.normal(0, noise, before.shape), rng)
    return before, after, rng


@given(seeds, st.sampled_from([2, 3]), st.booleans())
@few
def test_a_fit_of_given_handedness_recovers_a_transform(seed, k, reflected):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(6, k))
    turn = ortho_group.rvs(k, random_state=rng)
    turn[0] *= 1 if (np.linalg.det(turn) < 0) == reflected else -1
    target = 2.5 * points @ turn.T + 1
    fit = fit_similarity(points, target, rng.uniform(0.1, 1, 6), reflection=reflected)
    np.testing.assert_allclose(fit.apply(points), target, atol=1e-9)
    other = fit_similarity(points, target, reflection=not reflected)
    assert other.reflected is not reflected
    assert np.abs(other.apply(points) - target).max() > 1e-3


@given(seeds)
@few
def test_weights_count_points_repeatedly(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, 7, 3))
    counts = rng.integers(1, 4, 7)
    weighted = fit_similarity(x, y, counts.astype(float))
    repeated = fit_similarity(np.repeat(x, counts, axis=0), np.repeat(y, counts, axis=0))
    np.testing.assert_allclose(weighted.apply(x), repeated.apply(x), atol=1e-9)


@given(seeds, st.floats(0.05, 0.3))
@few
def test_a_robust_fit_is_not_bent_by_points_that_moved(seed, share):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 3))
    target = moved_freely(points, rng)
    far = rng.permutation(60)[: int(share * 60)]
    target[far] += rng.normal(0, 20, (len(far), 3))
    fit = fit_similarity_robustly(points, target)
    still = np.setdiff1d(np.arange(60), far)
    assert np.abs(fit.apply(points[still]) - target[still]).max() < 1e-3


def test_maps_that_differ_by_chance_do_not_differ():
    alarms = sum(
        compare_maps(SensorMap(before), SensorMap(after)).moved.any()
        for before, after, _ in map(two_maps, range(40))
    )
    assert alarms <= 3  # 0.4 expected at a level of 1 %; P(more than 3) < 0.001
    same = compare_maps(SensorMap(lattice()), SensorMap(lattice()))
    assert not same.found
    assert same.smallest < 2e-3
    rounded = lattice()
    rounded[0] += 5e-4  # in files of three decimals
    assert not compare_maps(SensorMap(lattice()), SensorMap(rounded)).found


@pytest.mark.parametrize("seed", range(3))
def test_swapped_sensors_are_named_with_their_distance(seed):
    before, after, rng = two_maps(seed)
    a = int(rng.integers(len(before)))
    apart = np.linalg.norm(before - before[a], axis=1)
    b = int(rng.choice(np.flatnonzero(apart > 2)))
    after[[a, b]] = after[[b, a]]
    found = compare_maps(SensorMap(before, units="mm"), SensorMap(after))
    assert np.flatnonzero(found.moved).tolist() == sorted((a, b))
    assert found.distance[a] == pytest.approx(apart[b], abs=0.5)
    assert found.smallest < found.distance[[a, b]].min()
    assert (found.distance[~found.moved] <= found.smallest).all()
    assert found.units == "mm"
    assert found.found


@given(seeds)
@settings(max_examples=5)
def test_the_comparison_does_not_depend_on_frames_or_order(seed):
    before, after, rng = two_maps(3)
    after[17] += 9
    names = [f"n{i}" for i in range(len(before))]
    plain = compare_maps(SensorMap(before, names=names), SensorMap(after, names=names))
    order = rng.permutation(len(before))
    other = compare_maps(
        SensorMap(before, names=names),
        SensorMap(
            moved_freely(after, np.random.default_rng(seed))[order], names=[names[i] for i in order]
        ),
    )
    np.testing.assert_allclose(other.distance, plain.distance, atol=1e-6)
    assert other.moved.tolist() == plain.moved.tolist()


def test_sensors_appear_and_are_lost():
    before, after, _ = two_maps(0)
    names = [f"n{i}" for i in range(len(before))]
    after[5] = np.nan
    first = SensorMap(before[:-1], names=names[:-1])
    health = np.where(np.arange(1, len(after)) == 4, "dead", "ok")  # it keeps its place
    second = SensorMap(after[1:], names=names[1:], health=health)
    found = compare_maps(first, second)
    assert [found.names[i] for i in np.flatnonzero(found.lost)] == ["n0", "n4", "n5"]
    assert [found.names[i] for i in np.flatnonzero(found.appeared)] == [names[-1]]
    assert not found.moved.any()
    assert np.isnan(found.distance[[0, 5, -1]]).all()
    back = compare_maps(second, first)
    assert "n4" in [back.names[i] for i in np.flatnonzero(back.appeared)]  # it recovered


def test_components_are_aligned_apart():
    before, after, _ = two_maps(1)
    component = (before[:, 0] > 4.6).astype(int)
    rng = np.random.default_rng(5)
    after[component == 1] = moved_freely(after[component == 1], rng, 1.0)
    maps = [SensorMap(points, component=component) for points in (before, after)]
    found = compare_maps(*maps)
    assert np.isfinite(found.distance).all()
    assert not found.moved.any()
    small = [SensorMap(m.positions, component=[1] * 5 + [0] * (len(before) - 5)) for m in maps]
    assert "fewer than 8 sensors: 5" in compare_maps(*small).notes[0]


def test_maps_that_cannot_be_compared_are_refused():
    before, after, _ = two_maps(2)
    with pytest.raises(InputError, match="cannot be matched with 3 by order"):
        compare_maps(SensorMap(before), SensorMap(after[:3], names="abc"))
    with pytest.raises(InputError, match="common sensors in one component"):
        compare_maps(SensorMap(before[:5]), SensorMap(after[:5]))
    named = SensorMap(after, names=[f"other{i}" for i in range(len(after))])
    assert compare_maps(SensorMap(before), named).notes == (
        "the maps share no sensor name: matched by order",
    )
