"""Reconstruction from a recording: quality, components, notes, refusals."""

import pickle
import warnings
from functools import cache

import numpy as np
import pytest

import anisomap
from anisomap import Recording, SensorMap, diagnose, reconstruct, score
from anisomap.errors import AnisomapWarning, InputError
from anisomap.large import reconstruct_on_device
from anisomap.method.evidence import SIMILARITIES, Evidence
from anisomap.method.named import METHODS, PAPER_METHODS, MethodOptions
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.placement import median_spacing
from skins import flat_map, flat_skin, lattice, mantel_r, quietly, rubbed, seeing_patch


@cache
def short_map(method):
    """Return the map of a short recording, for tests that change the recording."""
    return reconstruct(flat_skin(n_frames=800), method, 2)


@pytest.mark.parametrize("method", ["r-anisomap", "spearman-anisomap", "co-activation-anisomap"])
def test_a_rubbed_flat_skin_is_reconstructed(method):
    found = [mantel_r(flat_map(method, seed=seed), flat_skin(seed=seed)) for seed in range(4)]
    assert np.median(found) > 0.95


@pytest.mark.filterwarnings("ignore:the map looks flat")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [2, 3])
def test_every_method_makes_a_map_far_above_its_null(method, dimensions):
    # All sensors have the same entropy here, which information distance stands and falls with.
    skin = seeing_patch(n_frames=600)
    sensor_map = reconstruct(skin, method, dimensions)
    assert sensor_map.positions.shape == (42, dimensions)
    assert sensor_map.method == method
    found = score(sensor_map, skin.positions, permutations=100).mantel
    assert found.r > found.quantiles()[1.0]
    assert 0 < sensor_map.stress < 1


def test_only_information_distance_is_much_worse_in_space_than_in_the_plane():
    # McGregor et al. (2011), Figures 3 and 7: it bends flat maps into spheres.
    loss = {
        method: np.mean([mantel_r(quietly(reconstruct, skin, method, 2), skin)
                         - mantel_r(quietly(reconstruct, skin, method, 3), skin)
                         for skin in (seeing_patch(seed=seed, n_frames=600) for seed in range(3))])
        for method in PAPER_METHODS
    }  # fmt: skip
    assert loss.pop("information-distance") > 0.1
    assert max(loss.values()) < 0.03


@pytest.mark.parametrize("method", METHODS)
def test_relabelling_the_sensors_only_relabels_the_map(method):
    order = np.random.default_rng(1).permutation(42)
    relabelled = reconstruct(flat_skin(n_frames=800).select(order), method, 2)
    assert anisomap.mantel(
        short_map(method).positions[order], relabelled.positions, permutations=0
    ).r == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_units_of_readings_do_not_matter_to_a_map(method):
    gains = 2.0 ** np.random.default_rng(0).integers(-4, 5, 42)
    other = Recording(flat_skin(n_frames=800).readings * gains)
    second = reconstruct(other, method, 2)
    found = anisomap.mantel(short_map(method), second, permutations=0).r
    assert found == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_the_same_recording_gives_the_same_bytes(method):
    again = reconstruct(flat_skin(n_frames=800), method, 2)
    assert again.positions.tobytes() == short_map(method).positions.tobytes()


def test_arrays_and_lists_of_frames_are_recordings():
    readings = flat_skin().readings
    for given in (readings, np.asfortranarray(readings), readings.tolist()):
        made = reconstruct(given, "r-anisomap", 2)
        np.testing.assert_allclose(made.positions, flat_map("r-anisomap").positions, atol=1e-9)


def test_dead_sensors_are_left_out_and_listed():
    readings = np.array(flat_skin().readings)
    readings[:, [4, 17]] = [0, 3]
    with pytest.warns(AnisomapWarning, match=r"never varied.*: 1 of 42 \(s4\)$|stuck .*\(s17\)"):
        sensor_map = diagnose(reconstruct(readings, "r-anisomap", 2), readings)
    np.testing.assert_array_equal(np.flatnonzero(~sensor_map.placed), [4, 17])
    assert np.isnan(sensor_map.positions[[4, 17]]).all()
    assert (sensor_map.health[4], sensor_map.health[17]) == ("silent", "stuck")
    assert sensor_map.notes


def test_excluded_sensors_are_mapped_and_dropped_ones_are_not():
    skin = flat_skin()
    made = flat_map("r-anisomap")
    scored = score(made, skin.positions, exclude=["s3", 5], permutations=0)
    np.testing.assert_array_equal(scored.excluded, [3, 5])
    assert scored.mantel.n_sensors == 40
    with pytest.raises(InputError, match="no sensor 'nobody'"):
        score(made, skin.positions, exclude=["nobody"])
    dropped = reconstruct(skin, "r-anisomap", 2, drop=["s3", 5])
    without = reconstruct(skin.select(np.setdiff1d(np.arange(42), [3, 5])), "r-anisomap", 2)
    np.testing.assert_allclose(dropped.positions[dropped.placed], without.positions, atol=1e-9)


def two_skins():
    """Two patches that are never touched together."""
    positions = np.vstack([lattice(4, 5), np.add(lattice(3, 4), [100, 0])])
    first = rubbed(positions[:20], 1200, seed=1) * (np.arange(1200)[:, None] < 700)
    second = rubbed(positions[20:], 1200, seed=2) * (np.arange(1200)[:, None] >= 700)
    return Recording(np.hstack([first, second]), positions=positions)


def test_components_without_regularisation_are_separate_maps():
    skin = two_skins()
    with pytest.warns(AnisomapWarning, match="2 separate components"):
        sensor_map = reconstruct(skin, "r-anisomap", 2, options=MethodOptions(regularisation=0))
    np.testing.assert_array_equal(sensor_map.component, [0] * 20 + [1] * 12)
    for piece, truth in zip(sensor_map.split(), (lattice(4, 5), lattice(3, 4)), strict=True):
        assert score(piece, truth, permutations=0).mantel.r > 0.95
        np.testing.assert_allclose(piece.positions.mean(axis=0), 0, atol=1e-9)
    found = score(sensor_map, skin.positions, permutations=0)
    assert found.mantel.n_sensors == 20
    assert "12 of 32 sensors not compared: outside the largest component" in found.notes


def test_skins_that_were_touched_independently_are_separate_maps():
    first, second = (flat_skin(seed=seed).readings for seed in (0, 1))
    with pytest.warns(AnisomapWarning, match="2 separate components"):
        sensor_map = reconstruct(Recording(np.hstack([first, second[:, :30]])), dimensions=2)
    np.testing.assert_array_equal(sensor_map.component, [0] * 42 + [1] * 30)
    for piece, places in zip(sensor_map.split(), (lattice(), lattice()[:30]), strict=True):
        assert score(piece, places, permutations=0).mantel.r > 0.95


@pytest.mark.parametrize("size", [6, 30])
def test_components_have_the_same_unit(size):
    skin, patch = flat_skin(), flat_skin(seed=9)
    both = Recording(np.hstack([skin.readings, patch.readings[:, :size]]))
    made = quietly(reconstruct, both, dimensions=2)
    spacings = [median_spacing(piece) for piece in made.split() if piece.n_sensors > 3]
    assert len(spacings) == 2
    assert max(spacings) < 2 * min(spacings)


@pytest.mark.parametrize("unit", [1e-100, 1e29])
def test_readings_of_extreme_magnitude_are_mapped(unit):
    usual = flat_map(n_frames=300)
    extreme = quietly(reconstruct, flat_skin(n_frames=300).readings * unit, dimensions=2)
    assert anisomap.mantel(usual, extreme, permutations=0).r > 0.999


def test_changed_options_of_the_fit_are_in_the_provenance():
    options = MethodOptions(covariogram=CovariogramOptions(repulsion=0.2))
    made = reconstruct(flat_skin(n_frames=800), dimensions=2, options=options)
    assert made.provenance["covariogram_repulsion"] == 0.2
    assert not any(key.startswith("covariogram_") for key in flat_map().provenance)


def test_good_recordings_carry_no_note():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert flat_map().notes == ()
        assert diagnose(flat_map(), flat_skin()).notes == ()


def test_maps_can_be_pickled():
    sensor_map = flat_map()
    again = pickle.loads(pickle.dumps(sensor_map))
    assert again.positions.tobytes() == sensor_map.positions.tobytes()
    assert again.provenance == sensor_map.provenance


UNTOUCHED = Recording(-np.eye(50)[:, :4])
HOLED = np.array(flat_skin(n_frames=50).readings)
HOLED[7, 3] = np.nan


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"recording": Recording(np.zeros((9, 5)))}, "got 0 of 5"),
        ({"recording": Recording(np.eye(9)[:, :2])}, "got 2 of 2"),
        ({"recording": UNTOUCHED}, "but 3 are needed"),
        ({"method": "pca"}, "choose from covariogram"),
        ({"recording": "skin.csv"}, r"read the file first: anisomap.read\('skin.csv'\)"),
        ({"recording": SensorMap(np.eye(9)[:, :3])}, "a recording is required here, got a map"),
        ({"drop": "s99"}, "no sensor 's99'"),
        ({"drop": ["nobody"]}, "no sensor 'nobody'"),
        ({"recording": Recording(np.full((9, 5), np.nan))}, "got 0 of 5"),
        ({"recording": Recording(HOLED)}, "sensors: s3; frames: 7"),
        *(
            ({"recording": nonsense}, r"shape \(T, N\) \(frames x sensors\)")
            for nonsense in (3, np.zeros(7))
        ),
        *(({"recording": nonsense}, "must be real numbers") for nonsense in (None, {})),
    ],
)
def test_invalid_arguments_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        reconstruct(**{"recording": flat_skin(), **arguments})


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("entropy_bins", 1, "at least 2, got 1"),
        ("entropy_bins", 2.5, "an integer"),
        ("n_neighbours", 0, "at least 1, got 0"),
        ("min_sensors", 0, "at least 1"),
        ("regularisation", -1, "regularisation must be"),
        ("regularisation", "1", "regularisation must be"),
        ("independent_frames", 0, "positive"),
    ],
)
def test_options_out_of_range_are_refused(option, value, message):
    with pytest.raises(InputError, match=message):
        MethodOptions(**{option: value})


def test_registries_are_consistent():
    assert set(PAPER_METHODS) <= set(METHODS)
    used = {method.similarity for method in METHODS.values()}
    used |= {method.contact_similarity for method in METHODS.values()} - {None}
    assert used == set(SIMILARITIES)
    for entry in [*METHODS.values(), *SIMILARITIES.values()]:
        assert entry.summary


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [1, 2, 3, "auto"])
def test_frames_that_cannot_place_sensors_are_said_at_once(method, dimensions):
    readings = np.random.default_rng(0).random((6, 9))
    least = 4 if dimensions == "auto" else dimensions + 2
    with pytest.raises(InputError, match=f"requires {least} frames, got {least - 1}"):
        anisomap.reconstruct(readings[: least - 1], method, dimensions)


def all_alike(n_frames, n_sensors, noise=0.0):
    """Return readings that differ in offset and gain only, but for noise."""
    rng = np.random.default_rng(3)
    course = np.maximum(0, rng.normal(size=(n_frames, 1)))
    gains = rng.uniform(0.5, 2, n_sensors) * rng.choice([-1, 1], n_sensors)
    readings = course * gains + rng.uniform(-5, 5, n_sensors)
    return readings + noise * rng.normal(size=readings.shape)


@pytest.mark.parametrize("method", ["covariogram", "r-anisomap", "i-anisomap"])
@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_sensors_that_all_read_the_same_are_refused(method, noise):
    with pytest.raises(InputError, match="all sensors have the same readings"):
        reconstruct(all_alike(500, 12, noise), method)


ROUTES = {
    "memory": reconstruct,
    "similarity": lambda x, *how: anisomap.reconstruct_from(
        similarity=np.corrcoef(x.T), method=how[0], dimensions=how[1]
    ),
    "blocks": lambda x, *how: reconstruct(blocks_of(x), *how),
    "device": reconstruct_on_device,
}


def blocks_of(readings):
    array = pytest.importorskip("dask.array", reason="needs the extra 'cluster'")
    return array.from_array(readings, chunks=(800, 100))


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("n_sensors", [12, 200])
def test_sensors_that_all_read_the_same_are_refused_on_every_route(route, n_sensors):
    with pytest.raises(InputError, match="all sensors have the same readings"):
        quietly(ROUTES[route], all_alike(5000, n_sensors), "r-anisomap", 2)


def test_a_long_pause_in_the_middle_of_a_recording_is_no_fault_of_it():
    readings = flat_skin().readings
    rest = np.repeat(readings[:1] * 0, 9000, axis=0)
    paused = np.concatenate([readings[:1000], rest, readings[1000:]])
    assert quietly(reconstruct, paused, "r-anisomap", 2).placed.all()


def test_two_sensors_that_read_the_same_are_mapped():
    readings = np.array(flat_skin().readings)
    readings[:, 1] = readings[:, 0]
    assert quietly(reconstruct, readings, "r-anisomap", 2).placed.all()


def changes_of(readings):
    recording = anisomap.Recording(readings)
    found = Evidence.of(
        recording, "blended-correlation", bins=DEFAULT_BINS, with_variance=True
    ).rank_changes
    return found[np.triu_indices(len(found), 1)]


@pytest.mark.parametrize("held", [2, 3])
def test_changes_of_held_readings_are_not_missed(held):
    """A logger that is faster than the sensors repeats readings, beyond 10,000 frames too."""
    readings = flat_skin(n_frames=6000).readings
    once, repeated = changes_of(readings), changes_of(np.repeat(readings, held, axis=0))
    assert np.abs(once).max() > 0.1
    assert np.corrcoef(once, repeated)[0, 1] > 0.9
