"""Every benchmark runs in its smallest setting; the independent simulator has all of its kinds."""

import sys

import numpy as np
import pytest
from benchmarks.accuracy import dimension, limits, noise, quality, steps
from benchmarks.live import coach
from benchmarks.placing import placement
from benchmarks.skins.independent import BODIES, STIMULATIONS, Case, make
from benchmarks.skins.readout import TRANSDUCERS
from benchmarks.speed import bench
from benchmarks.verdicts import faults, kinds, trust
from benchmarks.verdicts.suite import DAMAGES
from scipy.signal import lfilter

import anisomap
from skins import flat_skin

PLAIN = Case("plate:n=49", "poke", n_frames=400, seed=3)
KINDS = [
    *(Case(f"{body}:n=40", "poke", n_frames=200) for body in BODIES),
    *(Case("plate:n=36", touch, n_frames=200) for touch in STIMULATIONS),
    *(Case("plate:n=36", "poke", how, n_frames=200) for how in TRANSDUCERS),
    *(Case("plate:n=36", "poke", damage=damage, n_frames=200) for damage in DAMAGES),
]


@pytest.mark.parametrize("case", KINDS, ids=str)
def test_kinds_of_recordings_are_drawn_from_seeds(case):
    first, again = make(case), make(case)
    np.testing.assert_array_equal(first.readings, again.readings)
    assert len(first.positions) == first.n_sensors
    assert (np.ptp(first.complete("interpolate").readings, axis=0) > 0).mean() > 0.5


def test_positions_follow_wires_that_are_exchanged_all_the_time():
    before, after = make(PLAIN), make(Case(**{**vars(PLAIN), "damage": "swapped"}))
    wires = [int((one == before.readings.T).all(axis=1).argmax()) for one in after.readings.T]
    assert np.any(np.diff(wires) < 0)
    np.testing.assert_array_equal(after.positions, before.positions[wires])


def _farthest(recording):
    """Return the largest distance from the middle of a map over the median one."""
    made = anisomap.reconstruct(recording.complete("interpolate"), dimensions=2)
    positions = made.positions[made.component == 0]
    radii = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    return radii.max() / np.median(radii)


@pytest.mark.parametrize(
    "damage",
    [
        "",
        "gaps",
        *(pytest.param(each, marks=pytest.mark.slow) for each in DAMAGES if each != "gaps"),
    ],
)
@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")
def test_no_sensor_runs_away_from_the_map(damage):
    for touch in ("poke", "sway"):
        assert _farthest(make(Case("plate:n=36", touch, "linear", damage, 400, 5))) < 100


@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")
def test_sensors_that_blip_in_one_frame_do_not_run_away():
    rng, n_frames = np.random.default_rng(2), 3000

    def slow(count, memory):
        drawn = rng.normal(size=(2 * n_frames, count))
        return lfilter([1], [1, -memory], drawn, axis=0)[n_frames:]

    y, x = (np.mgrid[:6, :6].reshape(2, -1) - 2.5) / 6
    sway = slow(2, 0.997) / 13
    load = 4 + 30 * np.exp(-3 * (x**2 + y**2))
    mat = load * (1 + 0.3 * (sway[:, :1] * x + sway[:, 1:] * y))
    mat += rng.normal(0, 0.3, mat.shape)
    blips = np.zeros((n_frames, 2))
    blips[n_frames // 2 + 1] = 3  # a frame that is left out, since frames repeat
    readings = np.hstack([mat, 20 + 0.2 * slow(60, 0.9995), blips])
    assert _farthest(anisomap.Recording(np.round(np.maximum(readings, 0)))) < 100


SMALLEST = {
    "bench": (bench, ["--seeds", "1", "--sizes", "30x400"]),
    "coach": (coach, ["--seeds", "401", "--bodies", "hexagon"]),
    "dimension": (dimension, ["--seeds", "0"]),
    "faults": (faults, ["--seeds", "0", "--workers", "1"]),
    "kinds": (kinds, ["--seeds", "1", "--workers", "1"]),
    "limits": (limits, ["--workers", "1"]),
    "noise": (noise, ["--seeds", "1", "--workers", "1"]),
    "placement": (placement, ["--bodies", "sphere", "--draws", "3"]),
    "quality": (quality, ["--seeds", "0", "--workers", "1"]),
    "steps": (steps, ["--seeds", "0", "--workers", "1"]),
    "trust": (trust, ["--seeds", "1", "--workers", "1"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALLEST)
def test_tables_are_written(name, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "umap", None)  # compiling it takes some 10 s
    monkeypatch.setattr(noise, "LEVELS", (0.1,))
    monkeypatch.setattr(coach, "LENGTHS", (80,))
    folder = tmp_path / "recordings"
    folder.mkdir()
    anisomap.write(flat_skin(n_frames=600), folder / "retina_skin.npz")
    benchmark, arguments = SMALLEST[name]
    monkeypatch.setattr(placement, "SEEDS", placement.SEEDS[:1])
    if name not in ("bench", "coach", "kinds", "noise", "placement"):
        arguments = [*arguments, "--recordings", str(folder)]
    output = tmp_path / "out" / ("a.csv" if name == "placement" else "")
    benchmark.main([*arguments, "-o", str(output)])
    written = [*(tmp_path / "out").rglob("*.md"), *(tmp_path / "out").rglob("*.csv")]
    assert written
    assert all(path.read_text("utf-8").count("\n") > 1 for path in written)
