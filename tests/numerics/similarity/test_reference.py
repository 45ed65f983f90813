"""Readings without the common signal: what changes, what does not, and what it is for."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from anisomap import Recording, reconstruct
from anisomap.numerics.similarity.correlation import without_common_signal
from skins import flat_skin, mantel_r, quietly

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


def sharing(seed, common, n_sensors=20):
    """Return readings of independent signals and a common one of a given variance."""
    rng = np.random.default_rng(seed)
    own, shared = rng.standard_normal((4000, n_sensors)), rng.standard_normal((4000, 1))
    return own * np.sqrt(1 - common) + shared * np.sqrt(common)


def typical(readings):
    """Return the median correlation of pairs."""
    correlation = np.corrcoef(readings, rowvar=False)
    return np.median(correlation[np.triu_indices(len(correlation), 1)])


@given(SEEDS, st.floats(0.3, 0.9))
def test_a_common_signal_is_subtracted(seed, common):
    readings = sharing(seed, common)
    left, share = without_common_signal(readings)
    assert 0 < share <= 1
    assert abs(typical(left)) < 0.2 * typical(readings)
    scaled, _ = without_common_signal(1000 * readings + 3)
    np.testing.assert_allclose(scaled, 1000 * left, atol=1e-6)


@given(SEEDS)
def test_the_share_is_that_of_the_mean_over_sensors(seed):
    """The common signal, of variance c, makes c / (c + (1 - c) / N) of the mean."""
    expected = 0.5 / (0.5 + 0.5 / 20)
    _, found = without_common_signal(sharing(seed, 0.5))
    assert found == pytest.approx(expected, abs=0.06)


@given(SEEDS)
def test_readings_of_local_contacts_stay_as_they_are(seed):
    rng = np.random.default_rng(seed)
    places, touches = rng.uniform(0, 6, (20, 2)), rng.uniform(0, 6, (600, 2))
    touched = np.maximum(0, 1.5 - cdist(touches, places))
    assert without_common_signal(touched)[0] is touched


@given(SEEDS)
def test_sensors_without_the_common_signal_keep_their_readings(seed):
    readings = sharing(seed, 0.7)
    rng = np.random.default_rng([seed, 1])
    readings[:, :2] = rng.standard_normal((len(readings), 2))
    left, share = without_common_signal(readings)
    assert share > 0.5
    own = [np.corrcoef(left[:, i], readings[:, i])[0, 1] for i in range(2)]
    assert min(own) > 0.98
    assert abs(typical(left[:, :2])) < 0.1


@given(SEEDS)
def test_few_sensors_stay_as_they_are(seed):
    readings = sharing(seed, 0.5, 7)
    assert without_common_signal(readings)[0] is readings


def test_the_place_of_a_reference_electrode_does_not_distort_a_map():
    """Near a reference, correlations are low; far from it, all sensors are alike."""
    rng = np.random.default_rng(22)
    places = cap(rng)
    potentials = field(rng, places, 0.8, n_frames=3000)
    reference = int(places[:, 2].argmax())
    measured = np.delete(potentials - potentials[:, [reference]], reference, axis=1)
    measured += 0.2 * rng.standard_normal(measured.shape)
    recording = Recording(measured, positions=np.delete(places, reference, axis=0))
    ours = mantel_r(quietly(reconstruct, recording), recording)
    published = mantel_r(quietly(reconstruct, recording, "r-anisomap"), recording)
    assert ours > 0.9 > published + 0.1


def test_hum_of_all_sensors_does_not_distort_a_map():
    skin = flat_skin(seed=22, n_frames=3000)
    wave = np.sin(np.arange(skin.n_frames) / 1.7)[:, None]
    humming = replace(skin, readings=skin.readings + 2 * skin.readings.std() * wave)
    assert mantel_r(quietly(reconstruct, humming, dimensions=2), humming) > 0.97
