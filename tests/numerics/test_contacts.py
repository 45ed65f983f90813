"""The contact fit: exact derivatives, known solutions, and when it is not applied."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from anisomap.errors import InputError
from anisomap.method.reconstruction import reconstruct_from
from anisomap.numerics.contacts import ContactOptions, fit_contacts
from anisomap.numerics.contacts.likelihood import (
    Contacts,
    Profile,
    Roots,
    assign_levels,
    evaluate,
    find_contacts,
    fit_profile,
    leave_one_out,
    level_log_likelihood,
    locate,
    sensor_steps,
)
from anisomap.numerics.reliability.split_half import blended_correlation
from skins import lattice, likeness

PROFILE = Profile(np.array([0.0, 0.4, 1.1]), 0.2, 1.8, 0.3)


QUICK = ContactOptions(max_readings=3000)


def pressed(places, n_frames=800, *, seed=0, binary=False):
    """Readings of sensors pressed by one compact object at random locations."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(places.min(axis=0) - 0.5, places.max(axis=0) + 0.5, (n_frames, 2))
    reach = rng.normal(1.9, 0.2, (n_frames, 1))
    inside = reach - np.linalg.norm(places - middle[:, None], axis=2)
    readings = np.maximum(inside, 0) ** 1.5
    return (readings > 0).astype(float) if binary else readings


def some_contacts(dimensions, seed=0):
    """Positions, contacts with simulated levels, and their states."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-2, 2, (12, dimensions))
    states = np.column_stack([rng.uniform(-1, 1, (5, dimensions)), rng.uniform(1, 2, 5)])
    sensors = np.concatenate([rng.permutation(12)[:10] for _ in range(5)])
    of = np.repeat(np.arange(5), 10)
    inside = states[of, -1] - np.linalg.norm(places[sensors] - states[of, :-1], axis=1)
    levels = (inside[:, None] + rng.logistic(0, 0.3, (50, 1)) >= PROFILE.thresholds).sum(axis=1)
    return places, Contacts(sensors, levels, of, np.arange(0, 50, 10), 3), states


def one_contact(sensors, levels):
    return Contacts(sensors, levels, np.zeros(len(sensors), int), np.zeros(1, int), 3)


@given(st.integers(0, 3), st.floats(-2, 3))
def test_slopes_equal_finite_differences(level, inside):
    def score(u):
        return float(level_log_likelihood([level], [u], PROFILE)[0][0])

    _, slope, curvature = level_log_likelihood([level], [inside], PROFILE)
    difference = (score(inside + 1e-5) - score(inside - 1e-5)) / 2e-5
    assert slope[0] == pytest.approx(difference, rel=1e-5, abs=1e-6)
    assert curvature[0] >= 0


def test_the_probabilities_of_all_levels_sum_to_one():
    inside = np.linspace(-3, 4, 50)
    total = sum(
        np.exp(level_log_likelihood(np.full(50, level), inside, PROFILE)[0]) for level in range(4)
    )
    np.testing.assert_allclose(total, 1, atol=1e-9)


def test_a_profile_is_recovered_from_its_readings():
    rng = np.random.default_rng(0)
    inside = rng.uniform(-1.5, 2.5, 40_000)
    reached = inside + rng.logistic(0, PROFILE.softness, len(inside))
    levels = (reached[:, None] >= PROFILE.thresholds).sum(axis=1)
    start = Profile(np.array([-0.3, 0.8, 1.0]), 0.5, 1.8, 0.3)
    learned = fit_profile(levels, inside, np.ones(len(inside)), start)
    # The share of outliers that the model expects is not there, which sharpens it a little.
    np.testing.assert_allclose(learned.thresholds, PROFILE.thresholds, atol=0.03)
    assert learned.softness == pytest.approx(PROFILE.softness, rel=0.15)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_gradients_by_contacts_equal_finite_differences(dimensions):
    places, contacts, states = some_contacts(dimensions)
    found = evaluate(contacts, places, states, PROFILE)
    shape = states.shape
    expected = approx_fprime(
        states.ravel(),
        lambda p: evaluate(contacts, places, p.reshape(shape), PROFILE).scores.sum(),
        1e-6,
    )
    np.testing.assert_allclose(found.gradients.ravel(), expected, atol=1e-4)
    assert (np.linalg.eigvalsh(found.precisions) > 0).all()


@pytest.mark.parametrize("dimensions", [2, 3])
def test_sensors_step_up_the_likelihood_of_contacts_that_follow_them(dimensions):
    """For a narrow prior, a step is its variance times the gradient with contacts re-optimised."""
    places, contacts, states = some_contacts(dimensions)
    located = locate(contacts, places, states, PROFILE, steps=500)
    assert np.abs(located.gradients).max() < 0.05
    kept = np.array([1.0, 1.0, 0.0, 0.5, 1.0])
    still = np.zeros(places.shape)
    step = sensor_steps(contacts, located, Roots.of(contacts, located), kept, still, prior_sd=1e-3)
    expected = approx_fprime(
        places.ravel(),
        lambda p: float(
            kept
            @ locate(contacts, p.reshape(places.shape), located.states, PROFILE, steps=50).scores
        ),
        1e-5,
    )
    # Steps are damped by a hundredth.
    found = step.ravel() * 1.01e6
    np.testing.assert_allclose(found, expected, atol=0.04 * np.abs(expected).max())


@pytest.mark.parametrize("dimensions", [2, 3])
def test_steps_of_sensors_solve_the_schur_complement(dimensions):
    places, contacts, states = some_contacts(dimensions)
    fitted = evaluate(contacts, places, states, PROFILE)
    size, width = places.size, dimensions + 1
    whole = np.zeros((size + states.size,) * 2)
    gradients = np.zeros(len(whole))
    for m, (sensor, contact) in enumerate(zip(contacts.sensors, contacts.owners, strict=True)):
        row = np.zeros(len(whole))
        row[sensor * dimensions : (sensor + 1) * dimensions] = -fitted.directions[:-1, m]
        at = size + contact * width
        row[at : at + width] = fitted.directions[:, m]
        whole += fitted.curvatures[m] * np.outer(row, row)
        gradients += fitted.slopes[m] * row
    for contact in range(5):
        at = slice(size + contact * width, size + (contact + 1) * width)
        whole[at, at] = fitted.precisions[contact]  # with the prior of the radii
        gradients[at] = fitted.gradients[contact]
    back = np.linalg.solve(whole[size:, size:], whole[size:, :size])
    curvature = whole[:size, :size] - whole[:size, size:] @ back
    gradient = gradients[:size] - back.T @ gradients[size:]
    strays = np.random.default_rng(0).normal(size=places.shape)
    roots = Roots.of(contacts, fitted)
    step = sensor_steps(contacts, fitted, roots, np.full(5, 0.3), strays, prior_sd=0.5)
    own = 0.01 * (0.3 * np.diag(whole)[:size] + 4)
    damped = 0.3 * curvature + 4 * np.eye(size) + np.diag(own)
    target = 0.3 * gradient - 4 * strays.ravel()
    missed = damped @ step.ravel() - target
    assert np.linalg.norm(missed) <= 0.03 * np.linalg.norm(target)


def test_leave_one_out_predictions_approximate_refits():
    # Readings of a true contact: one Newton step is enough where the score is nearly a parabola.
    rng = np.random.default_rng(0)
    places = rng.uniform(-2, 2, (60, 2))
    soft = Profile(np.array([0.0, 0.5, 1.0]), 0.5, 1.8, 0.3)
    reached = 1.8 - np.linalg.norm(places, axis=1) + rng.logistic(0, 0.5, 60)
    levels = (reached[:, None] >= soft.thresholds).sum(axis=1)
    contacts = one_contact(np.arange(60), levels)
    start = np.array([[0.0, 0.0, 1.8]])
    fitted = locate(contacts, places, start, soft, steps=100)
    quick = leave_one_out(fitted, Roots.of(contacts, fitted))
    for m in range(0, 60, 5):
        rest = np.delete(np.arange(60), m)
        without = one_contact(rest, levels[rest])
        y = locate(without, places, fitted.states, soft, steps=100).states[0]
        exact = y[2] - np.linalg.norm(places[m] - y[:2])
        assert quick[m] == pytest.approx(exact, abs=0.05)
        assert abs(quick[m] - exact) <= 0.5 * abs(fitted.inside[m] - exact) + 0.01


def test_simultaneous_contacts_are_separated():
    places = lattice(8, 12)
    centres = np.array([[2.0, 3.0], [9.0, 3.0]])
    depth = np.maximum(1.7 - np.linalg.norm(places - centres[:, None], axis=2), 0).sum(axis=0)
    levels = assign_levels(np.vstack([depth, np.zeros((9, 96))]), 8, max_gain_spread=0.3)
    found = find_contacts(levels, places, min_sensors=3)
    assert len(found.starts) == 2
    for contact in range(2):
        mine = found.owners == contact
        touched = found.sensors[mine & (found.levels > 0)]
        near = np.linalg.norm(places[touched] - centres[:, None], axis=2)
        assert (near.argmin(axis=0) == near[:, 0].argmin()).all()
        assert (depth[found.sensors[mine & (found.levels == 0)]] == 0).all()


@pytest.mark.parametrize(("binary", "left"), [(False, 0.5), (True, 0.9)])
def test_the_contact_fit_improves_on_the_covariogram(binary, left):
    places = lattice(7, 8)
    for seed in range(2):
        readings = pressed(places, seed=seed, binary=binary)
        # Maps from a similarity alone do not use contacts.
        rough = reconstruct_from(similarity=blended_correlation(readings), dimensions=2).positions
        found = fit_contacts(readings, rough)
        assert found.used
        assert not found.reason
        assert 1 - likeness(found.positions, places) < left * (1 - likeness(rough, places))


def test_unequal_gains_hardly_change_the_map():
    places = lattice(7, 8)
    readings = pressed(places)
    gains = 5.0 ** np.random.default_rng(0).uniform(-0.5, 0.5, 56)
    rough = places + np.random.default_rng(1).normal(0, 0.2, places.shape)
    unequal = ContactOptions(max_readings=3000, max_gain_spread=100)
    plain = fit_contacts(readings, rough, QUICK)
    spread, blind = (fit_contacts(readings * gains, rough, o) for o in (QUICK, unequal))
    assert spread.used
    lost, ignored = (
        likeness(plain.positions, places) - likeness(other.positions, places)
        for other in (spread, blind)
    )
    assert lost < 0.001 < ignored
    assert np.corrcoef(np.log(spread.gains), np.log(gains))[0, 1] > 0.95


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10))
def test_the_fit_is_equivariant_to_labels_and_units(seed):
    rng = np.random.default_rng(seed)
    places = lattice(7, 7)
    readings = pressed(places, 300, seed=seed)
    rough = places + rng.normal(0, 0.2, places.shape)
    options = ContactOptions(n_steps=2)
    found = fit_contacts(readings, rough, options)
    order = rng.permutation(49)
    other = fit_contacts(5 - 7 * readings[:, order], 3 * rough[order] + 8, options)
    assert found.used
    assert other.used
    assert other.n_contacts == found.n_contacts
    np.testing.assert_allclose(other.positions, 3 * found.positions[order] + 8, atol=1e-4)


def test_a_map_of_coincident_sensors_is_not_refined():
    found = fit_contacts(np.eye(9)[:, :5], np.zeros((5, 2)))
    assert not found.used
    assert "coincide" in found.reason


def test_noise_is_not_fitted():
    rng = np.random.default_rng(0)
    places = lattice(8, 8)
    noise = (rng.uniform(size=(400, 64)) < 0.2).astype(float)
    found = fit_contacts(noise, places, QUICK)
    assert not found.used
    assert found.explained < 0.35
    np.testing.assert_array_equal(found.positions, places)
    assert "explains" in found.reason


def test_readings_that_never_rest_are_not_fitted():
    found = fit_contacts(np.random.default_rng(0).normal(size=(500, 64)), lattice(8, 8))
    assert not found.used
    assert found.at_rest < 0.2
    assert "at rest" in found.reason


def test_an_untouched_skin_has_no_contacts():
    found = fit_contacts(np.zeros((50, 64)), lattice(8, 8))
    assert not found.used
    assert found.n_contacts == 0
    assert "0 contacts" in found.reason


@pytest.mark.parametrize(
    ("readings", "positions", "message"),
    [
        (np.zeros(5), np.zeros((5, 2)), r"got \(5,\)"),
        (np.zeros((9, 5)), np.zeros((4, 2)), r"shape \(5, k\)"),
        (np.full((9, 5), np.nan), np.eye(5), "finite"),
        (np.zeros((9, 5)), np.full((5, 2), np.inf), "finite"),
        (np.zeros((9, 2)), np.eye(2), "at least 3 sensors"),
    ],
)
def test_invalid_arguments_are_refused(readings, positions, message):
    with pytest.raises(InputError, match=message):
        fit_contacts(readings, positions)


@pytest.mark.parametrize(
    "options",
    [{"n_levels": 0}, {"n_levels": 200}, {"contact_weight": 0}, {"contact_weight": np.nan},
     {"prior_sd": 0}, {"prior_sd": np.inf}, {"n_steps": -1}, {"min_sensors": 1},
     {"max_readings": 0}, {"max_gain_spread": np.nan}],
)  # fmt: skip
def test_invalid_options_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        ContactOptions(**options)


@given(st.integers(0, 99), st.sampled_from([np.uint8, np.float64]))
def test_levels_are_quantiles_of_the_readings_above_rest(seed, dtype):
    rng = np.random.default_rng(seed)
    touched = rng.random((200, 6)) < 0.3
    readings = (touched * rng.integers(20, 200, touched.shape)).astype(dtype)
    found = assign_levels(readings, 4, max_gain_spread=9.0)
    edges = np.quantile(readings[touched], [0.25, 0.5, 0.75])
    expected = np.where(touched, 1 + np.searchsorted(edges, readings), 0)
    np.testing.assert_array_equal(found.values, expected)
    assert found.max_level == 4
    assert found.at_rest == pytest.approx(np.mean(~touched))
