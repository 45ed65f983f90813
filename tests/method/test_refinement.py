"""The refinement: what it adds to scaled positions, and where paths have a share."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, diagnose, reconstruct
from anisomap.method.refinement import MIN_SENSORS, refine
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.simulation.bodies import sphere
from skins import flat_skin, lattice, likeness, mantel_r, quietly, rubbed, stages, stored


def refined(readings, dimensions=2):
    """Return the scaled positions of a skin, and their refinement."""
    known = stages(readings)
    scaled = smacof(known.metric, dimensions=dimensions).positions
    return scaled, refine(known.evidence, known.metric, scaled, CovariogramOptions())


def test_the_refinement_improves_the_scaled_map():
    ours, scaled = [], []
    for seed in range(4):
        skin = flat_skin(seed=seed, n_frames=400)
        start, found = refined(skin.readings)
        ours.append(1 - likeness(found.positions, skin.positions))
        scaled.append(1 - likeness(start, skin.positions))
    assert np.median(ours) < np.median(scaled)


def test_one_function_of_distance_leaves_paths_no_share():
    _, found = refined(flat_skin().readings)
    assert not found.distorted
    assert found.path_weight < 0.2


def test_paths_have_a_share_where_contacts_differ_from_place_to_place():
    places = lattice(8, 9)
    rng = np.random.default_rng(0)
    touch = rng.uniform(places.min(axis=0), places.max(axis=0), (2500, 2))
    reach = 1.2 + 3 * (touch[:, :1] / places[:, 0].max())  # contacts grow along the skin
    distances = np.linalg.norm(touch[:, None] - places, axis=2)
    (_, found), (_, alike) = (
        refined(np.maximum(0, 1 - distances / size)) for size in (reach, np.full_like(reach, 2))
    )
    assert found.unexplained > 2 * max(0, alike.unexplained)
    assert found.path_weight > alike.path_weight
    assert likeness(found.positions, places) > likeness(found.fit.positions, places)


def test_fingers_of_a_flat_hand_are_spread_less_than_on_the_scaled_map():
    places = np.array([(x, y) for x in range(7) for y in range(9 if x % 3 == 0 else 5)], float)
    rng = np.random.default_rng(0)
    touch = rng.choice(places, 1500) + rng.uniform(-0.5, 0.5, (1500, 2))  # never between fingers
    distances = np.linalg.norm(touch[:, None] - places, axis=2)
    scaled, found = refined(np.maximum(0, 1 - distances / 1.8))
    ours, others = (1 - likeness(p, places) for p in (found.positions, scaled))
    assert ours < 0.65 * others


@given(st.integers(0, 20))
def test_the_refinement_does_not_depend_on_the_order_of_sensors(seed):
    known = stages(flat_skin(n_frames=300).readings)
    order = np.random.default_rng(seed).permutation(42)
    start = smacof(known.metric, dimensions=2).positions
    found = refine(known.evidence, known.metric, start, CovariogramOptions())
    inside = np.ix_(order, order)
    other = stages(flat_skin(n_frames=300).readings[:, order])
    again = refine(other.evidence, known.metric[inside], start[order], CovariogramOptions())
    assert likeness(found.positions[order], again.positions) > 1 - 1e-5


def test_few_sensors_stay_as_they_were_scaled():
    scaled, found = refined(flat_skin().readings[:, : MIN_SENSORS - 1])
    assert found is None
    assert scaled.shape == (MIN_SENSORS - 1, 2)


@pytest.mark.parametrize("seed", [1, 2])
def test_compressed_maps_of_rolling_bodies_are_not_called_usable(seed):
    """Long contacts compress the map, which the readings do not show."""
    rolling = stored(f"rolling-columns-{seed}")
    made = quietly(diagnose, quietly(reconstruct, rolling, dimensions=3), rolling)
    assert mantel_r(made, rolling) < 0.9
    assert made.verdict.level != "usable"


def noisy_sphere(noise, seed):
    """Return readings of a sphere under one round contact a frame, and white noise."""
    rng = np.random.default_rng(seed)
    places = sphere().positions
    touch = rng.normal(size=(1500, 3))
    touch /= np.linalg.norm(touch, axis=1, keepdims=True)
    pressed = np.maximum(0, 1 - np.linalg.norm(touch[:, None] - places, axis=2) / 0.6)
    pressed *= rng.gamma(6, 1 / 6, (1500, 1))
    deep = np.quantile(pressed[pressed > 0], 0.9)
    readings = pressed / deep + noise * rng.normal(size=pressed.shape)
    return Recording(readings.astype(np.float32), positions=places)


@pytest.mark.parametrize(("noise", "behind"), [(0.1, 0.02), (0.2, 0.02), (0.35, 0.1)])
def test_white_noise_leaves_the_default_no_worse_than_the_published_method(noise, behind):
    ours, published = [], []
    for seed in range(5):
        skin = noisy_sphere(noise, seed)
        made = quietly(reconstruct, skin, dimensions=3)
        assert made.component_sizes[0] >= 0.95 * skin.n_sensors
        ours.append(mantel_r(made, skin))
        published.append(mantel_r(quietly(reconstruct, skin, "r-anisomap", 3), skin))
    assert np.median(ours) > np.median(published) - behind


def test_sensors_whose_links_noise_hides_are_mapped_and_noted():
    skin = noisy_sphere(0.5, 0)
    made = quietly(reconstruct, skin, dimensions=3)
    assert made.component_sizes == (skin.n_sensors,)
    (note,) = [note for note in made.notes if getattr(note, "kind", "") == "hidden-links"]
    assert note.values["total"] == skin.n_sensors
    assert quietly(diagnose, made, skin).verdict.level == "not usable"


def test_wide_contacts_of_readings_that_are_on_or_off_are_mapped():
    """Most sensors are on most of the time, so the more frequent reading is not rest."""
    places = lattice(6, 7)
    skin = Recording((rubbed(places, 2000, reach=4.5) > 0.2).astype(np.uint8), positions=places)
    assert skin.readings.mean() > 0.5
    ours = mantel_r(quietly(reconstruct, skin, dimensions=2), skin)
    assert ours > mantel_r(quietly(reconstruct, skin, "r-anisomap", 2), skin) - 0.01
    upside_down = Recording(1 - skin.readings)
    other = quietly(reconstruct, upside_down, dimensions=2)
    assert anisomap.mantel(
        other, quietly(reconstruct, skin, dimensions=2), permutations=0
    ).r == pytest.approx(1, abs=1e-6)
