"""Refinement of uneven maps by contact peaks and by declared even spacing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import anisomap
from anisomap import MethodOptions, Recording, diagnose, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.methods import METHODS
from anisomap.numerics.contacts import ContactOptions
from anisomap.numerics.scaling.stress_minimisation import smacof
from anisomap.stages.contact_average import average_with_contacts
from anisomap.stages.refinement import Refined, RefinementFacts, refine_by_covariogram
from skins import flat_skin, lattice, mantel_r, quietly, seeing_patch, stages, stored, swept

EVEN = MethodOptions(even_spacing=True)
WITHOUT_CONTACTS = MethodOptions(contacts=ContactOptions(min_explained=2))
UNTRUSTED = "do not trust the map's scale along one direction"


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
    assert plain.provenance["contact_peaks"] is True
    assert any("peak heights of contacts" in note for note in plain.notes)

    declared = mapped(recording, options=EVEN)
    assert mantel_r(declared, recording) > 0.97
    assert declared.provenance["even_spacing"] is True
    assert "contact_peaks" not in declared.provenance
    assert any("declared, not measured" in note for note in declared.notes)


def test_rolling_cylinders_without_columns_keep_their_length():
    found, published = [], []
    for seed in (301, 302, 303):
        recording, made = rolled(f"fibonacci-{seed}")
        assert made.provenance["contact_peaks"] is True
        found.append(mantel_r(made, recording))
        published.append(mantel_r(reconstruct(recording, "r-anisomap", 3), recording))
    assert np.median(found) > 0.9 > np.median(published) + 0.3


@pytest.mark.parametrize("seed", [301, 302, 303])
def test_heights_that_do_not_resolve_a_gap_are_said_to(seed):
    recording, found = rolled(f"random-{seed}")
    assert mantel_r(found, recording) > 0.9 or (
        found.uneven
        and quietly(diagnose, found, recording).verdict.level != "usable"
        and any("do not trust" in note for note in found.notes)
    )


def test_a_skin_swept_by_a_long_bar_keeps_its_width():
    places = lattice(8, 8) + np.random.default_rng(301).uniform(-0.3, 0.3, (64, 2))
    recording = Recording(swept(places, seed=301), positions=places)
    found = mapped(recording, dimensions=2)
    assert mantel_r(found, recording) > 0.95
    assert mantel_r(reconstruct(recording, "r-anisomap", 2), recording) < 0.85
    assert found.provenance["contact_peaks"] is True
    assert not found.uneven


def test_a_thresholded_sweep_is_a_curve_that_is_not_trusted():
    places = lattice(8, 8) + np.random.default_rng(301).uniform(-0.3, 0.3, (64, 2))
    pressed = Recording((swept(places, seed=301) > 2).astype(np.uint8))
    found = mapped(pressed, dimensions=2)
    assert found.provenance["curved"] is True
    assert quietly(diagnose, found, pressed).verdict.level != "usable"
    assert any("must not be trusted" in note for note in found.notes)


def test_contact_peaks_do_not_depend_on_units():
    rolling, first = rolled()
    gains = 2.0 ** np.random.default_rng(0).integers(-3, 4, rolling.n_sensors)
    second = mapped(Recording(rolling.readings * gains - 3))
    assert anisomap.mantel(first, second, permutations=0).r == pytest.approx(1, abs=1e-6)


def test_without_peak_heights_the_map_is_uneven_and_usable_locally_at_most():
    rolling, _ = rolled()
    touched = replace(rolling, readings=(rolling.readings > 0).astype(np.uint8))
    found = mapped(touched)
    assert "contact_peaks" not in found.provenance
    assert any(UNTRUSTED in note for note in found.notes)
    assert quietly(diagnose, found, touched).verdict.level != "usable"


def left_alone(readings, dimensions):
    """Tell whether the covariogram's places are the same with readings as without."""
    known = stages(readings)
    start = smacof(known.metric, dimensions=dimensions).positions
    with_readings, without = (
        refine_by_covariogram(pairs, known.metric, start)
        for pairs in (known.pairs, replace(known.pairs, readings=None))
    )
    assert known.pairs.readings is not None
    return (
        with_readings.positions.tobytes() == without.positions.tobytes()
        and not with_readings.notes
        and with_readings.facts == RefinementFacts()
    )


def test_contact_peaks_change_rolling_cylinders_and_not_bombarded_spheres():
    assert left_alone(stored("bombarded-sphere-1").readings, 3)
    assert not left_alone(stored("rolling-columns-1").readings, 3)


@pytest.mark.parametrize("skin", [flat_skin, seeing_patch])
def test_contact_peaks_do_not_change_flat_skins(skin):
    assert all(left_alone(skin(seed=seed).readings, 2) for seed in range(3))


@pytest.mark.slow
def test_contact_peaks_do_not_change_uneven_maps_of_self_touching_skins():
    found = []
    for seed in (301, 302, 303):
        touched = anisomap.simulate("plane", "self-touch", n_frames=2000, seed=seed)
        made = mapped(touched)
        assert "contact_peaks" not in made.provenance
        assert made.uneven
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


def test_contacts_that_differ_between_places_are_not_fitted():
    facts = RefinementFacts(path_weight=0.1)
    skin = flat_skin()
    pairs = stages(skin.readings).pairs
    given = Refined(skin.positions, facts)
    assert average_with_contacts(pairs, given) is given
    assert average_with_contacts(pairs, replace(given, facts=RefinementFacts())) is not given


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
    assert any("a map by paths along similar sensors" in reason for reason in verdict.reasons)
