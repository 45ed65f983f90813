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
from benchmarks.verdicts import faults, trust
from benchmarks.verdicts.suite import DAMAGES

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


SMALLEST = {
    "bench": (bench, ["--seeds", "1", "--sizes", "30x400"]),
    "coach": (coach, ["--seeds", "401", "--bodies", "hexagon"]),
    "dimension": (dimension, ["--seeds", "0"]),
    "faults": (faults, ["--seeds", "0", "--workers", "1"]),
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
    if name not in ("bench", "coach", "noise", "placement"):
        arguments = [*arguments, "--recordings", str(folder)]
    output = tmp_path / "out" / ("a.csv" if name == "placement" else "")
    benchmark.main([*arguments, "-o", str(output)])
    written = [*(tmp_path / "out").rglob("*.md"), *(tmp_path / "out").rglob("*.csv")]
    assert written
    assert all(path.read_text("utf-8").count("\n") > 1 for path in written)
