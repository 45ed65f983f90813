"""Covariances of positions: their estimation, their calibration, and where they are shown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import special_ortho_group
from threadpoolctl import threadpool_info, threadpool_limits

import anisomap
from anisomap import SensorMap, diagnose, reconstruct
from anisomap.errors import InputError
from anisomap.evaluation import align
from anisomap.placement import mirrored, scaled_to_spacing
from anisomap.sensor_map import ellipses, radius
from anisomap.verdict.chance import (
    aligned_to_mean,
    covariances,
    deviations_from_mean,
    error_in_spacings,
)
from skins import flat_map, flat_skin, lattice

quiet = pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")


def inside(errors, found, level=0.95):
    """Share of errors within their ellipses."""
    distances = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(found), errors)
    return np.mean(distances < radius(errors.shape[1], level) ** 2)


def covariances_of(maps, positions):
    return covariances(deviations_from_mean(maps, positions), positions)


def moved(points, seed):
    """Turn, scale, reflect and translate points."""
    rng = np.random.default_rng(seed)
    turn = special_ortho_group(points.shape[1]).rvs(random_state=seed) * rng.choice([-1, 1])
    return rng.uniform(0.1, 9) * points @ turn + rng.normal(size=points.shape[1])


@pytest.mark.parametrize("dimensions", [2, 3])
def test_ellipses_hold_the_truth_of_gaussian_errors(dimensions):
    """Every map is the truth with errors of known covariances, in a frame of its own."""
    rng = np.random.default_rng(dimensions)
    truth = 4 * rng.normal(size=(50, dimensions))
    spread = 0.1 * rng.uniform(0.5, 2, (50, dimensions))
    shares = []
    for _ in range(12):
        made = truth + spread * rng.normal(size=truth.shape)
        maps = [moved(made + spread * rng.normal(size=truth.shape), i) for i in range(8)]
        found = covariances_of(np.array(maps), made)
        shares.append(inside(align(truth, made).aligned - made, found))
    assert 0.9 < np.mean(shares) < 0.99


@given(st.integers(0, 50))
def test_covariances_do_not_depend_on_the_frames_of_the_maps(seed):
    rng = np.random.default_rng(seed)
    truth = 3 * rng.normal(size=(12, 3))
    maps = truth + 0.1 * rng.normal(size=(6, 12, 3))
    # The unit of the differences is that of the first map.
    elsewhere = np.array([maps[0], *(moved(one, seed + i) for i, one in enumerate(maps[1:]))])
    np.testing.assert_allclose(
        covariances_of(maps, truth), covariances_of(elsewhere, truth), rtol=0.1, atol=1e-4
    )


def test_one_lost_sensor_does_not_turn_the_others():
    rng = np.random.default_rng(0)
    truth = lattice(5, 5).astype(float)
    maps = truth + 0.02 * rng.normal(size=(8, 25, 2))
    maps[:, 3] += 4 * rng.normal(size=(8, 2))
    spread = aligned_to_mean(maps).std(axis=0).mean(axis=1)
    assert np.delete(spread, 3).max() < 0.1
    assert spread[3] > 1


def test_equal_maps_have_no_error():
    truth = lattice(4, 4).astype(float)
    found = covariances_of(np.array([truth] * 3), truth)
    np.testing.assert_allclose(found, 0, atol=1e-20)
    assert error_in_spacings(found, truth) == pytest.approx(0, abs=1e-9)
    assert error_in_spacings(found, np.zeros((16, 2))) == np.inf
    spheres = np.broadcast_to(0.02 * np.eye(2), (16, 2, 2))
    assert error_in_spacings(spheres, truth) == pytest.approx(0.2)


@quiet
@pytest.mark.slow
def test_ellipses_hold_the_mean_of_maps_of_other_recordings():
    """Where the truth of a map without systematic error is: the mean map of other recordings."""
    skins = [flat_skin(seed=seed, n_frames=800) for seed in range(10)]
    made = [reconstruct(skin, dimensions=2) for skin in skins]
    others = np.mean([align(m.positions, skins[0].positions).aligned for m in made], axis=0)
    shares, ratios = [], []
    for skin, one in zip(skins[:5], made, strict=False):
        judged = diagnose(one, skin)
        found, repeatability = judged.covariances, judged.verdict.repeatability
        errors = align(others, one.positions).aligned - one.positions
        shares.append(inside(errors, found))
        spacing = anisomap.evaluation.median_spacing(one.positions)
        ratios.append(repeatability * spacing / np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    assert 0.85 < np.mean(shares) <= 1
    assert 0.6 < np.median(ratios) < 1.8


@quiet
def test_a_seed_repeats_and_longer_recordings_have_smaller_ellipses():
    size = {}
    for n_frames in (300, 1500):
        made, skin = flat_map(n_frames=n_frames), flat_skin(n_frames=n_frames)
        first = diagnose(made, skin, rng=1)
        size[n_frames] = first.verdict.repeatability
    again = diagnose(made, skin, rng=1)
    np.testing.assert_array_equal(first.covariances, again.covariances)
    assert size[1500] < 0.7 * size[300]


@quiet
def test_resamples_of_small_maps_leave_linear_algebra_on_one_thread():
    recording = flat_skin(seed=2, n_frames=400)
    made, threads = reconstruct(recording, dimensions=2), []

    def count(_share):
        threads.extend(one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas")

    with threadpool_limits(2, user_api="blas"):
        diagnose(made, recording, progress=count)
    assert set(threads) == {1}


@quiet
def test_small_components_have_no_ellipses():
    first, second = (flat_skin(seed=seed).readings for seed in (0, 1))
    both = np.hstack([first, second[:, :9]])
    found = diagnose(reconstruct(both, dimensions=2), both)
    assert found.component_sizes == (42, 9)
    assert np.isfinite(found.covariances[:42]).all()
    assert np.isnan(found.covariances[42:]).all()
    few = diagnose(flat_map(n_frames=300), flat_skin(n_frames=300), with_verdict=False)
    assert few.covariances is None


def sphere(units="mm"):
    rng = np.random.default_rng(3)
    factors = 0.1 * rng.normal(size=(12, 3, 3))
    return SensorMap(
        rng.normal(size=(12, 3)), covariances=factors @ factors.transpose(0, 2, 1), units=units
    )


def test_covariances_are_checked_symmetric_and_read_only():
    skin = sphere()
    assert not skin.covariances.flags.writeable
    np.testing.assert_array_equal(skin.covariances, skin.covariances.transpose(0, 2, 1))
    np.testing.assert_array_equal(skin.select([3, 1]).covariances, skin.covariances[[3, 1]])
    with pytest.raises(InputError, match=r"covariances must have shape \(2, 3, 3\)"):
        SensorMap(np.eye(3)[:2], covariances=np.ones((2, 2, 2)))


def test_covariances_follow_the_positions():
    skin = sphere()
    scaled = scaled_to_spacing(skin, 2.0, "mm")
    factor = scaled.provenance["scale"]
    np.testing.assert_allclose(scaled.covariances, factor**2 * skin.covariances)
    flipped = mirrored(skin).covariances
    np.testing.assert_allclose(flipped[:, 0, 1:], -skin.covariances[:, 0, 1:])
    np.testing.assert_allclose(flipped[:, 1:, 1:], skin.covariances[:, 1:, 1:])


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_ellipses_hold_their_share(dimensions):
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(dimensions, dimensions))
    covariance = factor @ factor.T
    lengths, directions = ellipses(covariance[None])
    drawn = rng.normal(size=(20_000, dimensions)) @ factor.T
    assert (np.diff(lengths[0]) <= 0).all()
    np.testing.assert_allclose(directions[0] @ directions[0].T, np.eye(dimensions), atol=1e-12)
    scaled = drawn @ directions[0].T / lengths[0]
    assert np.mean(np.sum(scaled**2, axis=1) < 1) == pytest.approx(0.95, abs=0.006)
    assert np.isnan(ellipses(np.full((1, 2, 2), np.nan))[0]).all()
