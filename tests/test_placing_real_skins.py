"""Placed maps of a real skin: the torso of an iCub, to which no constant was fitted."""

import numpy as np
import pytest

from anisomap import align, io, reconstruct
from anisomap.evaluation import median_spacing
from anisomap.placement import Anchors, modules_by_size, place, suggest_anchors


@pytest.mark.slow
def test_four_suggested_anchors_and_the_triangles_place_the_torso(recordings_folder):
    recording = io.read(recordings_folder / "icub_torso.npz")
    template = io.read_map(recordings_folder.parent / "geometry" / "iit_triangle_10pad.npz")
    truth = np.asarray(recording.positions, dtype=float) / 1000
    made = reconstruct(recording, dimensions=2)
    names = suggest_anchors(made, 4)
    rows = made.indices(names)
    anchors = Anchors(tuple(made.names[i] for i in rows), truth[rows])
    modules = modules_by_size(made.names, 12).with_template(template)
    rest = np.setdiff1d(np.arange(len(truth)), rows)
    alone, rigid = place(made, anchors), place(made, anchors, modules=modules)
    off_alone, off_rigid = (
        np.linalg.norm(placed.map.positions - truth, axis=1)[rest] for placed in (alone, rigid)
    )
    best = align(made.positions, truth)
    assert np.sqrt(np.mean(off_alone**2)) < 1.1 * best.rms
    assert np.median(off_rigid) < median_spacing(truth) / 2
    assert np.mean(off_rigid <= rigid.map.errors[rest]) > 0.85
    assert alone.map.mirrored == rigid.map.mirrored == best.reflected
