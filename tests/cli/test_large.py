"""Recordings beyond the limit of memory are sampled evenly in time, and say so."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import anisomap
from anisomap import io, route
from skins import flat_skin, lattice

SKIN = flat_skin(n_frames=4000)
HOW = io.ReadOptions()


@pytest.fixture
def parts(tmp_path):
    """A skin in three files, sensors in another order in each, with their times."""
    order, paths = np.random.default_rng(0), []
    recording = anisomap.Recording(
        SKIN.readings, names=[f"pad {n}" for n in range(42)], times=np.arange(4000) / 50
    )
    for i, rows in enumerate(np.split(np.arange(4000), [1500, 2100])):
        sensors = order.permutation(42) if i else np.arange(42)
        part = recording.select(sensors)
        part = anisomap.Recording(part.readings[rows], names=part.names, times=part.times[rows])
        paths.append(tmp_path / f"part{i}{'.csv' if i == 2 else '.npz'}")
        anisomap.write(part, paths[-1])
    return paths


def test_a_sampled_recording_is_mapped_and_judged(parts):
    limit = 42 * 600
    with pytest.warns(anisomap.AnisomapWarning, match="one frame in 8 was used"):
        runs = route.read_runs(parts, HOW, max_readings=limit)
    assert sum(run.readings.size for run in runs) <= limit
    for run, path in zip(runs, parts, strict=True):
        whole = io.read(path)
        np.testing.assert_array_equal(run.readings, whole.readings[::8])
        np.testing.assert_allclose(run.times, whole.times[::8])
        assert run.rate_hz == pytest.approx(50 / 8)
    examined = route.examine(route.complete(runs, "error"))
    judged = route.judge(examined, *route.make_map(examined, "covariogram", 2))
    assert judged.provenance["frames_sampled_every"] == 8
    assert judged.provenance["frames"] == sum(run.n_frames for run in runs)
    assert any("one frame in 8 was used" in note for note in judged.notes)
    assert judged.verdict.level == "usable"
    assert anisomap.score(judged, SKIN.positions, permutations=0).mantel.r > 0.98


def test_samples_of_several_recordings_are_numbered_by_a_preset(tmp_path):
    """Of an iCub's port with an absent triangle and gaps."""
    whole = np.zeros((2400, 48), dtype=np.float32)
    pads = [i for i in range(48) if i % 12 not in (6, 10) and i // 12 != 2]
    whole[:, pads] = np.round(SKIN.readings[:2400] * 50)[:, : len(pads)]
    whole[40:60, 3] = np.nan
    paths = [tmp_path / f"robot{i}.npz" for i in range(2)]
    for path, readings in zip(paths, np.split(whole, [1300]), strict=True):
        anisomap.write(anisomap.Recording(readings), path)
    how = io.ReadOptions(preset="icub")
    with pytest.warns(anisomap.AnisomapWarning, match="one frame in 4"):
        runs = route.read_runs(paths, how, max_readings=48 * 700)
    run = route.complete(runs, "interpolate")
    assert run.n_sensors == 30
    assert run.names[-1] == "b0.t3.k11"
    assert run.n_frames == 600
    made, _ = route.make_map(route.examine(run), "r-anisomap", 2)
    assert made.provenance["frames_sampled_every"] == 4


@pytest.mark.parametrize("repair", [[], ["--repair"]])
def test_maps_of_samples_say_so_on_the_screen_and_in_files(run_map, tmp_path, repair):
    readings = np.tile(SKIN.readings, (2, 1))
    anisomap.write(anisomap.Recording(readings, positions=SKIN.positions), "long.npz")
    words = ["long.npz", "--memory", 1, *repair, "-o", "map.json", "-m", "r-anisomap"]
    made = run_map(*words, "-d", 2, "--permutations", 9)
    assert "one frame in 2 was used" in made.err
    written = anisomap.read_map(tmp_path / "map.json")
    assert written.provenance["frames_sampled_every"] == 2
    assert any("one frame in 2 was used" in note for note in written.notes)
    assert anisomap.score(written, SKIN.positions, permutations=0).mantel.r > 0.95


@pytest.mark.slow
def test_a_log_tells_the_stages_of_long_maps_with_the_time_left(run, skin_npz, tmp_path):
    places = lattice(32, 32)
    contacts = np.random.default_rng(0).uniform(-1, 33, (1500, 2))
    readings = np.maximum(0, 3 - cdist(contacts, places))
    anisomap.write(anisomap.Recording(readings), tmp_path / "wide.npz")
    said = run("map", "wide.npz", "-d", 2, "--no-verdict", "-o", "map.csv").err
    told = [line for line in said.splitlines() if not line.startswith("warning")]
    begun = ["comparing all pairs", "scaling 1024 sensors", "fitting", "fitting", "scaling paths"]
    assert len(told) == len(begun)
    assert all(line.startswith(stage) for line, stage in zip(told, begun, strict=True))
    assert all(line.endswith(" s left") for line in told[2:])
    assert "scaling" not in run("map", skin_npz, "-d", 2, "--no-verdict", "-o", "map.csv").err
