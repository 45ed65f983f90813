"""Modules of a skin: by numbers, lists and templates; rigid modules fitted to maps."""

import numpy as np
import pytest
from benchmarks.skins.corrections import read_corrected
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import special_ortho_group

from anisomap import SensorMap, align, io, reconstruct
from anisomap.errors import FileError, InputError
from anisomap.evaluation import median_spacing
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement import (
    NO_MODULE,
    Anchors,
    fit_modules,
    modules_by_name,
    modules_by_size,
    place,
    suggest_anchors,
)

PADS = np.array([[0.0, 0], [6, 0], [3, 5], [9, 5], [6, 10]])
seeds = st.integers(0, 1000)


def skin(seed, k=2, rows=3, columns=4, roof=False):
    """Modules of 5 pads side by side, turned at random; in 3D on a cylinder."""
    rng = np.random.default_rng(seed)
    pads = np.column_stack([PADS, [0, 0, 0, 0, 2.0 if roof else 0]])
    pads -= pads.mean(axis=0)
    points = []
    for row in range(rows):
        for column in range(columns):
            turned = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).apply(pads)
            if k == 2:
                points.append(turned[:, :2] + [16 * column, 16 * row])
            else:
                around = Rotation.from_euler("y", 16 * column / 30)
                points.append(around.apply(turned + np.array([0, 16 * row, 30])))
    return np.vstack(points), pads


def modules_of(n_sensors, pads):
    names = [f"s{i}" for i in range(n_sensors)]
    template = SensorMap(pads, units="mm")
    return modules_by_size(names, len(pads), first=0).with_template(template)


def free(points, seed):
    """Turn, scale and shift."""
    rng = np.random.default_rng(seed)
    turn = special_ortho_group.rvs(points.shape[1], random_state=rng)
    return 0.3 * points @ turn.T + rng.normal(size=points.shape[1])


def error(found, truth, *, reflection=False):
    fit = fit_similarity(found, truth, scaling=False, reflection=reflection)
    return np.linalg.norm(fit.apply(found) - truth, axis=1)


@given(seeds, st.sampled_from([2, 3]))
@settings(max_examples=8)
def test_an_exact_map_gets_the_unit_of_the_template(seed, k):
    truth, pads = skin(seed, k)
    fit = fit_modules(SensorMap(free(truth, seed)), modules_of(len(truth), pads))
    assert fit.map.units == "mm"
    assert error(fit.map.positions, truth).max() < 1e-5


@pytest.mark.parametrize("k", [2, 3])
def test_modules_are_rigid_and_better_than_sensors_alone(k):
    ratios = []
    in_k = np.pad(skin(0)[1], ((0, 0), (0, k)))[:, :k]
    for seed in range(3):
        truth, pads = skin(seed, k)
        rng = np.random.default_rng(seed)
        noisy = truth + rng.normal(0, 1.0, truth.shape)
        fit = fit_modules(SensorMap(free(noisy, seed)), modules_of(len(truth), pads))
        best = fit_similarity(noisy, truth).apply(noisy)
        ratios.append(
            np.median(align(fit.map.positions, truth).errors)
            / np.median(np.linalg.norm(best - truth, axis=1))
        )
        for found in fit.map.positions.reshape(-1, *in_k.shape):
            assert error(in_k, found).max() < 1e-9
    assert np.median(ratios) < 1


@given(seeds)
@settings(max_examples=4)
def test_labelled_pads_in_the_plane_tell_the_hand(seed):
    truth, pads = skin(seed)
    noisy = truth + np.random.default_rng(seed).normal(0, 0.8, truth.shape)
    modules = modules_of(len(truth), pads)
    right = fit_modules(SensorMap(free(noisy, seed)), modules)
    wrong = fit_modules(SensorMap(free(noisy, seed) * [-1, 1]), modules)
    assert right.evidence > 7
    assert wrong.evidence < -7
    np.testing.assert_allclose(error(right.map.positions, wrong.map.positions), 0, atol=1e-3)


@pytest.mark.parametrize("roof", [False, True])
def test_flat_modules_in_space_do_not_tell_the_hand_but_others_do(roof):
    truth, pads = skin(3, 3, roof=roof)
    fit = fit_modules(SensorMap(free(truth, 1) * [-1, 1, 1]), modules_of(len(truth), pads))
    assert fit.evidence < -7 if roof else abs(fit.evidence) < 1e-3


def test_sensors_without_a_position_are_placed_with_their_module():
    truth, pads = skin(0)
    positions = free(truth, 0)
    positions[[2, 11, 15, 16, 17]] = np.nan  # the last three leave 2 pads of module 3
    fit = fit_modules(SensorMap(positions), modules_of(len(truth), pads))
    known = fit.map.placed
    assert np.flatnonzero(~known).tolist() == [15, 16, 17]
    assert error(fit.map.positions[known], truth[known]).max() < 1e-3


def test_maps_without_modules_are_refused():
    truth, pads = skin(0)
    modules = modules_by_size([f"s{i}" for i in range(len(truth))], 5, first=0)
    with pytest.raises(InputError, match="positions of the pads"):
        fit_modules(SensorMap(truth), modules)
    positions = np.full_like(truth, np.nan)
    positions[::5] = truth[::5]
    with pytest.raises(InputError, match="no module has 3 sensors"):
        fit_modules(SensorMap(positions), modules_of(len(truth), pads))
    bent = pads + np.arange(5)[:, None] * [0, 0, 1.0]
    with pytest.raises(InputError, match="need a map of three dimensions"):
        fit_modules(SensorMap(truth), modules_of(len(truth), bent))


@pytest.mark.slow
def test_few_anchors_and_the_triangles_place_the_torso(recordings_folder):
    """No constant was fitted to the torso of this iCub. Anchors: four suggested, and six drawn."""
    recording = read_corrected(recordings_folder / "icub_torso.npz")
    template = io.read_map(recordings_folder.parent / "geometry" / "iit_triangle_10pad.npz")
    truth = np.asarray(recording.positions, dtype=float) / 1000
    made = reconstruct(recording, dimensions=2)
    best, half = align(made.positions, truth), median_spacing(truth) / 2
    modules = modules_by_size(made.names, 12).with_template(template)
    drawn = [np.random.default_rng(seed).choice(len(truth), 6, replace=False) for seed in range(3)]
    medians = []
    for rows in (made.indices(suggest_anchors(made, 4)), *drawn):
        anchors = Anchors(tuple(made.names[i] for i in rows), truth[rows])
        placed = place(made, anchors), place(made, anchors, modules=modules)
        off = [np.linalg.norm(each.map.positions - truth, axis=1) for each in placed]
        alone, rigid = (np.delete(each, rows) for each in off)
        medians.append(np.median(rigid))
        assert np.sqrt(np.mean(alone**2)) < 1.5 * best.rms
        assert np.mean(rigid <= np.delete(placed[1].map.errors, rows)) > 0.8
        assert placed[0].map.mirrored == placed[1].map.mirrored == best.reflected
    assert medians[0] < 2 * half
    assert np.median(medians[1:]) < half


TACTILE = (0, 1, 2, 3, 4, 5, 7, 8, 9, 11)  # of the 12 numbers of a triangle of the iCub


@given(st.sampled_from([0, 1]), st.sets(st.integers(0, 30), min_size=1), st.randoms())
def test_numbers_divide_sensors_into_modules(first, blocks, random):
    names = [f"taxel{12 * block + pad + first}" for block in sorted(blocks) for pad in TACTILE]
    random.shuffle(names)
    modules = modules_by_size(names, 12)
    assert modules.n_modules == len(blocks)
    for name, index, pad in zip(names, modules.index, modules.pads, strict=True):
        number = int(name.removeprefix("taxel")) - first
        assert (sorted(blocks)[index], pad) == divmod(number, 12)
    for module in range(len(blocks)):
        members = modules.members(module)
        assert modules.pads[members].tolist() == list(TACTILE)


def test_sensors_without_a_number_are_on_no_module():
    modules = modules_by_size(["a", "s0", "s1", "s2"], 2, first=0)
    assert modules.index.tolist() == [NO_MODULE, 0, 0, 1]
    assert modules.pads.tolist() == [NO_MODULE, 0, 1, 0]
    assert modules.labels == ("0-1", "2-3")


def test_a_template_gives_the_offsets_by_the_numbers_of_its_pads():
    template = SensorMap([[2.0, 0], [0, 1]], names=("P2", "P0"), units="mm")
    modules = modules_by_size(["x", "s0", "s2", "s5"], 3, first=0).with_template(template)
    np.testing.assert_array_equal(modules.offsets, [[np.nan, np.nan], [0, 1], [2, 0], [2, 0]])
    assert modules.units == "mm"
    with pytest.raises(InputError, match="pad 1 of module 0-2, but the template has no such pad"):
        modules_by_size(["s0", "s1"], 3, first=0).with_template(template)
    with pytest.raises(InputError, match="the template needs a unit"):
        modules.with_template(SensorMap([[1.0, 2]]))


def test_lists_of_modules_are_read(tmp_path):
    path = tmp_path / "modules.csv"
    path.write_text("sensor,module,pad\nb,left,1\na,left,0\nc,right,0\nunknown,right,1\n")
    modules = io.read_modules(path, ["a", "b", "c", "d"])
    assert modules.index.tolist() == [0, 0, 1, NO_MODULE]
    assert modules.pads.tolist() == [0, 1, 0, NO_MODULE]
    assert modules.labels == ("left", "right")
    path.write_text("sensor,module\nb,left\na,left\n")
    assert io.read_modules(path, ["a", "b"]).pads.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sensor,pad\na,0\n", "must have a header with the columns sensor, module"),
        ("sensor,module,pad\na,left\n", "line 2 has 2 instead of 3 fields"),
        ("sensor,module,pad\na,left,-1\n", "line 2: pad '-1' must be a whole number from 0"),
        ("sensor,module\na,left\na,right\n", "line 3: sensor 'a' is listed twice"),
        ("sensor,module,pad\na,left,0\nb,left,0\n", "2 sensors share pad 0 of module left"),
    ],
)
def test_damaged_lists_are_reported_with_their_place(tmp_path, text, message):
    path = tmp_path / "modules.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        io.read_modules(path, ["a", "b"])


def test_ambiguous_and_impossible_divisions_are_refused():
    for names, size, message in (
        (["s1", "s2"], 3, "may start at number 0 or 1"),
        (["a", "b"], 3, "no name has one"),
        (["a1", "b1"], 3, "repeated numbers: 1"),
        (["a1"], 1, "at least 2 pads, got 1"),
    ):
        with pytest.raises(InputError, match=message):
            modules_by_size(names, size)
    with pytest.raises(InputError, match="a pad for all sensors, or for none"):
        modules_by_name(["a"], {"a": ("left", None), "b": ("left", 1)})
