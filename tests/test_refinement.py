"""Refinement of uneven maps by contact peaks and by declared even spacing."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from anisomap.stages.contact_average import average_with_contacts
from anisomap.stages.refinement import Refined, RefinementFacts, refine_by_covariogram

import anisomap
from anisomap import MethodOptions, Recording, diagnose, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.methods import METHODS
from anisomap.numerics.contacts import ContactOptions
from anisomap.numerics.scaling.stress_minimisation import smacof
from anisomap.simulation import find_body
from skins import flat_skin, lattice, mantel_r, seeing_patch, stages, swept

EVEN = MethodOptions(even_spacing=True)
WITHOUT_CONTACTS = MethodOptions(contacts=ContactOptions(min_explained=2))
UNTRUSTED = "do not trust the map's scale along one direction"


def mapped(recording, **arguments):
    """Make a map whose doubts are looked at here, rather than raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        return reconstruct(recording, **arguments)


def rolled(seed, n_sensors=60, placement="columns"):
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    options = {"seed": seed} if placement == "random" else {}
    body = find_body("cylinder", n_sensors, placement=placement, **options)
    return anisomap.simulate(body, "locomotion", n_frames=2000, seed=seed)


@pytest.fixture(scope="module")
def rolling():
    return rolled(1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_rolling_cylinder_keeps_its_length(seed, rolling):
    recording = rolling if seed == 1 else rolled(seed)
    plain = mapped(recording)
    assert mantel_r(plain, recording) > 0.9 > mantel_r(reconstruct(recording, "r-anisomap", 3),
                                                      recording) + 0.3  # fmt: skip
    assert plain.provenance["contact_peaks"] is True
    assert any("peak heights of contacts" in note for note in plain.notes)

    declared = mapped(recording, options=EVEN)
    assert mantel_r(declared, recording) > 0.97
    assert declared.provenance["even_spacing"] is True
    assert "contact_peaks" not in declared.provenance
    assert any("declared, not measured" in note for note in declared.notes)


@pytest.mark.parametrize(
    ("n_sensors", "seed"), [(60, 301), (60, 302), (60, 303), (120, 302), (120, 303)]
)
@pytest.mark.slow
def test_a_rolling_cylinder_without_columns_keeps_its_length(n_sensors, seed):
    recording = rolled(seed, n_sensors, "fibonacci")
    found = mapped(recording)
    assert mantel_r(found, recording) > 0.9
    assert found.provenance["contact_peaks"] is True
    assert mantel_r(reconstruct(recording, "r-anisomap", 3), recording) < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("seed", [301, 302, 303])
def test_heights_that_do_not_resolve_a_gap_are_said_to(seed):
    recording = rolled(seed, 30, "random")
    found = mapped(recording)
    assert mantel_r(found, recording) > 0.9 or (
        found.uneven
        and diagnose(found, recording).verdict.level != "usable"
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
    assert diagnose(found, pressed).verdict.level != "usable"
    assert any("must not be trusted" in note for note in found.notes)


@pytest.mark.slow
def test_contact_peaks_do_not_depend_on_units(rolling):
    gains = 2.0 ** np.random.default_rng(0).integers(-3, 4, rolling.n_sensors)
    first, second = mapped(rolling), mapped(Recording(rolling.readings * gains - 3))
    assert anisomap.mantel(first, second, permutations=0).r == pytest.approx(1, abs=1e-6)


def test_without_peak_heights_the_map_is_marked_as_uneven(rolling):
    touched = replace(rolling, readings=(rolling.readings > 0).astype(np.uint8))
    found = mapped(touched)
    assert "contact_peaks" not in found.provenance
    assert any(UNTRUSTED in note for note in found.notes)


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


def test_contact_peaks_do_not_change_a_bombarded_sphere():
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    assert left_alone(anisomap.simulate("sphere", n_frames=2000, seed=1).readings, 3)


@pytest.mark.parametrize("skin", [flat_skin, seeing_patch])
@pytest.mark.parametrize("seed", range(4))
def test_contact_peaks_do_not_change_flat_skins(skin, seed):
    assert left_alone(skin(seed=seed).readings, 2)


def test_contact_peaks_are_used_for_a_rolling_cylinder(rolling):
    assert not left_alone(rolling.readings, 3)


@pytest.mark.parametrize("seed", [304, 305])
def test_contact_peaks_confirm_uneven_maps_of_self_touching_skins(seed):
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    touched = anisomap.simulate("plane", "self-touch", n_frames=2000, seed=seed)
    found = mapped(touched)
    assert "contact_peaks" not in found.provenance
    assert any(UNTRUSTED in note for note in found.notes)
    assert mantel_r(found, touched) > 0.85


def test_declared_even_spacing_improves_evenly_spaced_skins():
    # Beside the covariogram alone: contacts are not fitted where even spacing is declared.
    gained = []
    for seed in range(4):
        skin = flat_skin(seed=seed, n_frames=400)
        declared, plain = (
            mantel_r(mapped(skin, dimensions=2, options=options), skin)
            for options in (EVEN, WITHOUT_CONTACTS)
        )
        gained.append(declared - plain)
    assert min(gained) > 0


@pytest.mark.slow
def test_contacts_improve_flat_and_closed_skins():
    for body, scenario, dimensions in (
        ("hexagon", "bombardment", 2),
        ("cylinder", "bombardment", 3),
        ("torus", "rubbing", 3),
    ):
        left = []
        for seed in (311, 312):
            skin = anisomap.simulate(body, scenario, n_frames=1000, seed=seed)
            with_contacts, without = (
                1 - mantel_r(mapped(skin, dimensions=dimensions, options=options), skin)
                for options in (None, WITHOUT_CONTACTS)
            )
            left.append(with_contacts / without)
        assert max(left) < 0.9, (body, scenario)


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


def test_uneven_maps_are_usable_locally_at_most(rolling):
    touched = replace(rolling, readings=(rolling.readings > 0).astype(np.uint8))
    assert diagnose(mapped(touched), touched).verdict.level != "usable"


def test_maps_that_rest_on_heights_of_contacts_are_usable_locally(rolling):
    """Other maps are compressed, and nothing but the heights tells which is right."""
    verdict = diagnose(mapped(rolling), rolling).verdict
    assert verdict.level == "usable locally"
    assert any("a map by paths along similar sensors" in reason for reason in verdict.reasons)
