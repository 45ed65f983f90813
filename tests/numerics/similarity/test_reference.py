"""Readings relative to the mean of all sensors: what changes, what does not, and what it is for."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from anisomap import Recording, reconstruct
from anisomap.numerics.similarity.reference import refer_to_mean
from skins import flat_skin, mantel_r

SEEDS = st.integers(0, 1000)


def field(rng, places, reach, n_frames=600):
    """Gaussian random field whose correlation falls with a squared exponential."""
    covariance = np.exp(-(cdist(places, places) ** 2) / (2 * reach**2))
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    noise = rng.standard_normal((n_frames, len(places)))
    return noise @ root.T + 0.05 * rng.standard_normal(noise.shape)


def cap(rng, n_sensors=40):
    """Random places on the upper part of a sphere, at least a tenth of its radius apart."""
    places = np.empty((0, 3))
    while len(places) < n_sensors:
        place = rng.standard_normal(3)
        place /= np.linalg.norm(place)
        if place[2] > -0.2 and (len(places) == 0 or cdist([place], places).min() > 0.25):
            places = np.vstack([places, place])
    return places


@given(SEEDS)
def test_potentials_become_deviations_from_their_mean(seed):
    rng = np.random.default_rng(seed)
    readings = field(rng, cap(rng, 12), 0.5)
    readings -= readings[:, [0]] + 0.01 * rng.standard_normal((len(readings), 1))
    referred = refer_to_mean(readings)
    amplitude = readings.std(axis=0)
    np.testing.assert_allclose((referred / amplitude).mean(axis=1), 0, atol=1e-9)
    np.testing.assert_allclose(refer_to_mean(1000 * readings + 3), 1000 * referred, atol=1e-6)


@given(SEEDS)
def test_readings_with_rest_stay_as_they_are(seed):
    rng = np.random.default_rng(seed)
    touched = np.maximum(0, field(rng, rng.uniform(0, 6, (20, 2)), 1.0) - 1)
    noisy = touched + 0.05 * rng.standard_normal(touched.shape)
    assert refer_to_mean(touched) is touched
    assert refer_to_mean(noisy) is noisy


@given(SEEDS)
def test_a_field_wider_than_the_array_is_not_reduced_to_its_edges(seed):
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(range(6), range(6)), axis=-1).reshape(-1, 2)
    readings = field(rng, places, 5.0)
    assert refer_to_mean(readings) is readings


@given(SEEDS)
def test_few_sensors_stay_as_they_are(seed):
    readings = np.random.default_rng(seed).standard_normal((100, 7))
    assert refer_to_mean(readings) is readings


def test_the_place_of_a_reference_electrode_does_not_distort_a_map():
    """Near a reference, correlations are low; far from it, all sensors are alike."""
    ours, published = [], []
    for seed in (21, 22, 23):
        rng = np.random.default_rng(seed)
        places = cap(rng)
        potentials = field(rng, places, 0.8, n_frames=3000)
        reference = int(places[:, 2].argmax())
        measured = np.delete(potentials - potentials[:, [reference]], reference, axis=1)
        measured += 0.2 * rng.standard_normal(measured.shape)
        recording = Recording(measured, positions=np.delete(places, reference, axis=0))
        ours.append(mantel_r(reconstruct(recording), recording))
        published.append(mantel_r(reconstruct(recording, "r-anisomap"), recording))
    assert np.median(ours) > 0.9 > np.median(published) + 0.1


def test_hum_of_all_sensors_does_not_distort_a_map():
    found = []
    for seed in (21, 22, 23):
        skin = flat_skin(seed=seed, n_frames=6000)
        wave = np.sin(np.arange(skin.n_frames) / 1.7)[:, None]
        humming = replace(skin, readings=skin.readings + 2 * skin.readings.std() * wave)
        found.append(mantel_r(reconstruct(humming, dimensions=2), humming))
    assert np.median(found) > 0.97
