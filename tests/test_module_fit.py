"""Rigid modules fitted to maps: exact recovery, noise, handedness, unplaced sensors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

from anisomap import SensorMap, align, io, reconstruct
from anisomap.errors import InputError
from anisomap.evaluation import median_spacing
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement import Anchors, modules_by_size, place, suggest_anchors
from anisomap.placement.modules import fit_modules

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
            angle = rng.uniform(0, 2 * np.pi)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            flat = np.column_stack([pads[:, :2] @ turn.T, pads[:, 2]])
            if k == 2:
                points.append(flat[:, :2] + [16 * column, 16 * row])
                continue
            tilt = 16 * column / 30.0
            frame = np.array(
                [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
            )
            points.append((flat + np.array([0, 16 * row, 30])) @ frame.T)
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
    for seed in range(5):
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
@settings(max_examples=8)
def test_labelled_pads_in_the_plane_tell_the_hand(seed):
    truth, pads = skin(seed)
    noisy = truth + np.random.default_rng(seed).normal(0, 0.8, truth.shape)
    modules = modules_of(len(truth), pads)
    right = fit_modules(SensorMap(free(noisy, seed)), modules)
    wrong = fit_modules(SensorMap(free(noisy, seed) * [-1, 1]), modules)
    assert right.evidence > 7
    assert wrong.evidence < -7
    np.testing.assert_allclose(error(right.map.positions, wrong.map.positions), 0, atol=1e-3)


def test_flat_modules_in_space_do_not_tell_the_hand_but_others_do():
    for roof in (False, True):
        truth, pads = skin(3, 3, roof=roof)
        fit = fit_modules(SensorMap(free(truth, 1) * [-1, 1, 1]), modules_of(len(truth), pads))
        assert (fit.evidence < -7) == roof
        assert abs(fit.evidence) < 1e-3 or roof


def test_sensors_without_a_position_are_placed_with_their_module():
    truth, pads = skin(0)
    positions = free(truth, 0)
    positions[[2, 11, 15, 16, 17]] = np.nan  # the last three leave 2 pads of module 3
    fit = fit_modules(SensorMap(positions), modules_of(len(truth), pads))
    known = fit.map.placed
    assert np.flatnonzero(~known).tolist() == [15, 16, 17]
    assert fit.left_out == ("15-19",)
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


def test_the_triangles_of_an_icub_improve_its_map(recordings_folder):
    recording = io.read(recordings_folder / "icub_hexagon.npz")
    template = io.read_map(recordings_folder.parent / "geometry" / "iit_triangle_10pad.npz")
    made = reconstruct(recording, "r-anisomap", 2)
    fit = fit_modules(made, modules_by_size(made.names, 12).with_template(template))
    truth = np.asarray(recording.positions, dtype=float)
    free_errors = align(made.positions, truth).errors
    assert np.median(error(fit.map.positions, truth)) < np.median(free_errors)


@pytest.mark.slow
def test_four_suggested_anchors_and_the_triangles_place_the_torso(recordings_folder):
    """No constant was fitted to the torso of this iCub."""
    recording = io.read(recordings_folder / "icub_torso.npz")
    template = io.read_map(recordings_folder.parent / "geometry" / "iit_triangle_10pad.npz")
    truth = np.asarray(recording.positions, dtype=float) / 1000
    made = reconstruct(recording, dimensions=2)
    rows = made.indices(suggest_anchors(made, 4))
    anchors = Anchors(tuple(made.names[i] for i in rows), truth[rows])
    modules = modules_by_size(made.names, 12).with_template(template)
    rest = np.setdiff1d(np.arange(len(truth)), rows)
    alone, rigid = place(made, anchors), place(made, anchors, modules=modules)
    off_alone, off_rigid = (
        np.linalg.norm(placed.map.positions - truth, axis=1)[rest] for placed in (alone, rigid)
    )
    best = align(made.positions, truth)
    assert np.sqrt(np.mean(off_alone**2)) < 1.5 * best.rms
    assert np.median(off_rigid) < median_spacing(truth) / 2
    assert np.mean(off_rigid <= rigid.map.errors[rest]) > 0.8
    assert alone.map.mirrored == rigid.map.mirrored == best.reflected
