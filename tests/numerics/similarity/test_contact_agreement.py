"""Agreement of pairs of sensors over distinct contacts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.metrics import cohen_kappa_score

from anisomap import Recording
from anisomap.numerics.similarity.contact_agreement import (
    MIN_CONTACTS,
    contact_agreement,
    distinct_contacts,
    shows_single_contacts,
)

switches = arrays(
    np.bool_, st.tuples(st.integers(1, 30), st.integers(2, 8)), elements=st.booleans()
)


def pressed(seed, *, n_bodies=1, n_frames=1500, side=8):
    """Press round bodies of different radii on a square lattice, one or several at a time."""
    generator = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    readings = np.zeros((n_frames, len(places)), dtype=bool)
    for _ in range(n_bodies):
        centres = generator.uniform(-0.5, side - 0.5, (n_frames, 1, 2))
        radii = generator.uniform(0.8, 2.2, (n_frames, 1))
        readings |= np.linalg.norm(places - centres, axis=2) < radii
    return places, readings


@given(switches)
def test_agreement_is_a_correlation_matrix_without_order_or_duration(readings):
    agreement = contact_agreement(readings)
    assert np.array_equal(agreement, agreement.T)
    assert (np.diag(agreement) == 1).all()
    assert (np.abs(agreement) <= 1).all()
    again = np.concatenate([readings[::-1], readings])
    assert contact_agreement(again) == pytest.approx(agreement, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_agreement_equals_cohens_kappa_if_contacts_are_equally_large(seed):
    generator = np.random.default_rng(seed)
    readings = np.zeros((60, 9), dtype=int)
    for frame in readings:
        frame[generator.choice(9, 3, replace=False)] = 1
    contacts = distinct_contacts(readings)
    agreement = contact_agreement(readings)
    for i, j in ((0, 1), (2, 7)):
        oracle = cohen_kappa_score(contacts[:, i], contacts[:, j])
        assert agreement[i, j] == pytest.approx(oracle, abs=1e-12)


@given(switches)
def test_contacts_are_distinct_and_have_two_sensors(readings):
    contacts = distinct_contacts(readings)
    assert len(np.unique(contacts, axis=0)) == len(contacts)
    assert (contacts.sum(axis=1) >= 2).all()


def test_the_rarer_value_of_the_skin_is_contact():
    _, readings = pressed(3)
    assert np.array_equal(distinct_contacts(readings), distinct_contacts(1.0 - readings))


def test_a_sensor_without_contacts_agrees_with_none():
    _, readings = pressed(4)
    readings[:, 5] = False
    others = np.delete(contact_agreement(readings)[5], 5)
    assert not others.any()


def test_on_off_readings_have_two_values_per_sensor():
    _, readings = pressed(5)
    scaled = readings * np.linspace(1, 3, readings.shape[1]) - 2
    assert Recording(scaled).on_off
    scaled[700, 3] += 0.5
    assert not Recording(scaled).on_off


@pytest.mark.parametrize("seed", range(3))
def test_single_contacts_are_told_from_several_bodies(seed):
    assert shows_single_contacts(pressed(seed)[1])
    assert not shows_single_contacts(pressed(seed, n_bodies=4)[1])
    assert not shows_single_contacts(pressed(seed, n_frames=MIN_CONTACTS // 2)[1])


@pytest.mark.parametrize("seed", range(3))
def test_touches_of_one_sensor_lower_phi_but_not_agreement(seed):
    _, readings = pressed(seed)
    poked = np.concatenate([readings, np.tile(np.eye(readings.shape[1], dtype=bool), (20, 1))])
    assert np.array_equal(contact_agreement(poked), contact_agreement(readings))
    phi, phi_poked = np.corrcoef(readings.T), np.corrcoef(poked.T)
    assert phi_poked[0, 1] < phi[0, 1] - 0.02
