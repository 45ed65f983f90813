"""The chain of refinements, and its steps on skins that need them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import anisomap
from anisomap import MethodOptions, Recording, diagnose, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.method.named import METHODS
from anisomap.method.refinements import EXACT, Proposal, by_covariogram, by_heights, refine
from anisomap.numerics.contacts import ContactOptions
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from skins import flat_skin, lattice, mantel_r, quietly, seeing_patch, stages, stored, swept

EVEN = MethodOptions(even_spacing=True)
WITHOUT_CONTACTS = MethodOptions(contacts=ContactOptions(min_explained=2))


def mapped(recording, **arguments):
    """Make a map whose doubts are looked at here, rather than raised."""
    return quietly(reconstruct, recording, **arguments)


@cache
def rolled(name="columns-1"):
    """Return a recording of a rolling cylinder, and its map."""
    recording = stored(f"rolling-{name}")
    return recording, mapped(recording)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_rolling_cylinder_keeps_its_length(seed):
    recording, plain = rolled(f"columns-{seed}")
    published = mantel_r(reconstruct(recording, "r-anisomap", 3), recording)
    assert mantel_r(plain, recording) > 0.9 > published + 0.3
    assert plain.provenance["contact_heights"] is True
    assert any("heights of contacts" in note for note in plain.notes)

    declared = mapped(recording, options=EVEN)
    assert mantel_r(declared, recording) > 0.97
    assert declared.provenance["even_spacing"] is True
    assert "contact_heights" not in declared.provenance
    assert any("declared, not measured" in note for note in declared.notes)


def test_a_rolling_cylinder_is_mapped_in_more_dimensions_than_space_has():
    recording, _ = rolled()
    made = mapped(recording, dimensions=4)
    assert made.provenance["contact_heights"] is True
    assert mantel_r(made, recording) > 0.8


def test_rolling_cylinders_without_columns_keep_their_length():
    found, published = [], []
    for seed in (301, 302, 303):
        recording, made = rolled(f"fibonacci-{seed}")
        assert made.provenance["contact_heights"] is True
        found.append(mantel_r(made, recording))
        published.append(mantel_r(reconstruct(recording, "r-anisomap", 3), recording))
    assert np.median(found) > 0.9 > np.median(published) + 0.3


@pytest.mark.parametrize("seed", [301, 302])
def test_heights_that_do_not_resolve_a_gap_are_said_to(seed):
    recording, found = rolled(f"random-{seed}")
    assert (
        mantel_r(found, recording) > 0.9
        or quietly(diagnose, found, recording).verdict.level != "usable"
    )


def test_a_skin_swept_by_a_long_bar_keeps_its_width():
    places = lattice(8, 8) + np.random.default_rng(301).uniform(-0.3, 0.3, (64, 2))
    recording = Recording(swept(places, seed=301), positions=places)
    found = mapped(recording, dimensions=2)
    assert mantel_r(found, recording) > 0.95
    assert mantel_r(reconstruct(recording, "r-anisomap", 2), recording) < 0.85
    assert found.provenance["contact_heights"] is True
    assert not found.uneven


def test_a_thresholded_sweep_is_a_curve_that_is_not_trusted():
    places = lattice(8, 8) + np.random.default_rng(301).uniform(-0.3, 0.3, (64, 2))
    pressed = Recording((swept(places, seed=301) > 2).astype(np.uint8))
    found = mapped(pressed, dimensions=2)
    assert found.provenance["curved"] is True
    assert quietly(diagnose, found, pressed).verdict.level != "usable"
    assert any("must not be trusted" in note for note in found.notes)


def test_heights_do_not_depend_on_units():
    rolling, first = rolled()
    gains = 2.0 ** np.random.default_rng(0).integers(-3, 4, rolling.n_sensors)
    second = mapped(Recording(rolling.readings * gains - 3))
    assert anisomap.mantel(first, second, permutations=0).r == pytest.approx(1, abs=1e-6)


def test_without_peak_heights_the_map_is_usable_for_neighbours_at_most():
    rolling, _ = rolled()
    touched = replace(rolling, readings=(rolling.readings > 0).astype(np.uint8))
    found = mapped(touched)
    assert "contact_heights" not in found.provenance
    judged = quietly(diagnose, found, touched)
    assert judged.uneven
    assert judged.verdict.level != "usable"


def left_alone(readings, dimensions):
    """Tell whether heights of contacts leave the covariogram map as it is."""
    known = stages(readings)
    start = smacof(known.metric, dimensions=dimensions).positions
    options = MethodOptions()
    fitted = by_covariogram(known.pairs, known.metric, start, options)
    proposal = by_heights(known.pairs, known.metric, fitted.positions, options)
    return proposal.precision == 0 and not proposal.notes


def test_heights_change_rolling_cylinders_and_not_bombarded_spheres():
    assert left_alone(stored("bombarded-sphere-1").readings, 3)
    assert not left_alone(stored("rolling-columns-1").readings, 3)


def walked(places, seed, n_steps=50):
    """Return readings of a sole that rolls from heel to toe, with another load in each step."""
    rng = np.random.default_rng(seed)
    along, across = ((places - places.min(axis=0)) / np.ptp(places, axis=0)).T
    time = np.tile(np.linspace(0, 1.4, 40), n_steps)[:, None]
    load, sway = (np.repeat(rng.normal(x, 0.2, n_steps), 40)[:, None] for x in (1, 0.5))
    pressure = 1 - ((along - time) / 0.35) ** 2 - ((across - sway) / 0.9) ** 2
    return load * np.maximum(0, pressure) * (time < 1)


def test_heights_of_steps_do_not_change_soles():
    assert all(left_alone(walked(lattice(10, 10), seed), 2) for seed in range(3))


@pytest.mark.parametrize("skin", [flat_skin, seeing_patch])
def test_heights_do_not_change_flat_skins(skin):
    assert all(left_alone(skin(seed=seed).readings, 2) for seed in range(3))


@pytest.mark.slow
def test_heights_do_not_change_uneven_maps_of_self_touching_skins():
    found = []
    for seed in (301, 302, 303):
        touched = anisomap.simulate("plane", "self-touch", n_frames=1000, seed=seed)
        made = mapped(touched)
        assert "contact_heights" not in made.provenance
        found.append(mantel_r(made, touched))
    assert np.median(found) > 0.75


def error_left(skin, dimensions, options=None):
    """Return the error of a map beside that of the covariogram alone, as shares of Mantel r."""
    ours, alone = (
        1 - mantel_r(mapped(skin, dimensions=dimensions, options=each), skin)
        for each in (options, WITHOUT_CONTACTS)
    )
    return ours / alone


def test_declared_even_spacing_improves_evenly_spaced_skins():
    # Contacts are not fitted where even spacing is declared.
    left = [error_left(flat_skin(seed=seed, n_frames=400), 2, EVEN) for seed in range(5)]
    assert np.median(left) < 0.9


def test_contacts_improve_flat_skins():
    left = [error_left(flat_skin(seed=seed, n_frames=400), 2) for seed in range(3)]
    assert np.median(left) < 0.7


@pytest.mark.slow
def test_contacts_improve_closed_skins():
    assert error_left(stored("bombarded-sphere-1"), 3) < 0.9


def proposing(shift, precision):
    """Return a step that proposes the map moved by `shift`."""
    return lambda _pairs, _metric, positions, _options: Proposal(positions + shift, precision)


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(0.01, 9)), min_size=1, max_size=5))
def test_proposals_for_one_start_are_averaged_by_precision(proposed):
    origin = np.zeros((4, 2))
    steps = {
        str(i): (lambda *_, s=shift, p=precision: Proposal(origin + s, p))
        for i, (shift, precision) in enumerate(proposed)
    }
    shifts, precisions = np.array(proposed).T
    refined = refine(None, origin, origin, steps, MethodOptions())
    np.testing.assert_allclose(refined.positions, np.average(shifts, weights=precisions), atol=1e-9)
    assert refined.precision == pytest.approx(precisions.sum())


def test_nothing_is_added_to_a_map_that_was_replaced():
    steps = {"first": proposing(1, 1.0), "exact": proposing(2, EXACT), "last": proposing(4, 9.0)}
    refined = refine(None, np.zeros((4, 2)), np.zeros((4, 2)), steps, MethodOptions())
    np.testing.assert_array_equal(refined.positions, 3)
    assert dict(refined.weights) == {"first": 1.0, "exact": 1.0}


def test_a_proposal_without_precision_leaves_its_notes_only():
    steps = {
        "first": proposing(1, 1.0),
        "note": lambda *_: Proposal(np.full((4, 2), 9.0), notes=("a caveat",), distorted=True),
    }
    refined = refine(None, np.zeros((4, 2)), np.zeros((4, 2)), steps, MethodOptions())
    np.testing.assert_array_equal(refined.positions, 1)
    assert refined.notes == ("a caveat",)
    assert refined.distorted


@pytest.mark.parametrize("method", [name for name in METHODS if name != "covariogram"])
def test_methods_without_even_spacing_refuse_it(method):
    with pytest.raises(
        InputError, match=f"{method} does not support even spacing; use covariogram"
    ):
        reconstruct(flat_skin(), method, 2, options=EVEN)


def test_even_spacing_needs_readings_of_all_sensors():
    skin = flat_skin()
    similarity = stages(skin.readings).similarity
    runs = [skin.select(range(30)), skin.select(range(12, 42))]
    for call in (
        lambda: reconstruct_from(dimensions=2, similarity=similarity, options=EVEN),
        lambda: reconstruct(runs, dimensions=2, options=EVEN),
    ):
        with pytest.raises(InputError, match="readings of all sensors"):
            call()


def test_runs_with_all_sensors_accept_even_spacing():
    skin = flat_skin()
    runs = [replace(skin, readings=part) for part in np.split(skin.readings, [600])]
    with pytest.warns(AnisomapWarning, match="declared, not measured"):
        found = reconstruct(runs, dimensions=2, options=EVEN)
    np.testing.assert_allclose(
        found.positions, mapped(skin, dimensions=2, options=EVEN).positions, atol=1e-9
    )


@pytest.mark.parametrize(
    ("n_frames", "n_sensors"), [(30, 42), (1500, 6)], ids=["few frames", "few sensors"]
)
def test_unused_even_spacing_is_noted(n_frames, n_sensors):
    skin = flat_skin(n_frames=1500).select(range(n_sensors))
    found = mapped(replace(skin, readings=skin.readings[:n_frames]), dimensions=2, options=EVEN)
    assert found.provenance["even_spacing"] is False
    assert any("too few sensors or frames" in note for note in found.notes)


def test_maps_that_rest_on_heights_of_contacts_are_not_usable_as_a_whole():
    """Other maps are compressed, and nothing but the heights tells which is right."""
    rolling, made = rolled()
    verdict = quietly(diagnose, made, rolling).verdict
    assert verdict.level != "usable"
    assert any("a second map" in reason for reason in verdict.reasons)
