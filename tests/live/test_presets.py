"""Robots with a known numbering of sensors: every value is recorded, and sensors are mapped."""

import numpy as np
import pytest

import anisomap
from anisomap import io, route
from anisomap.live import ExaminationOptions, LiveSession, workers
from anisomap.live.batches import Batch
from anisomap.live.recorder import JournalWriter
from anisomap.live.workers import examine
from live_processes import Given, wait_for_maps
from skins import lattice, rubbed

PORT = "YARP port /icub/skin/right_hand"
PADS = [96 + i for i in range(48) if i not in (11, 23, 35, 43)]
NAMES = [f"palm.{i - 96}" for i in PADS]
OPTIONS = {"method": "r-anisomap", "dimensions": 2, "preset": "icub"}


@pytest.fixture(scope="module")
def hand():
    """Return readings of a hand without fingers, in which values that are no pads vary too."""
    readings = np.full((400, 192), 255.0)
    readings[:, 96:144] = np.random.default_rng(0).random((400, 48))
    readings[:, PADS] = rubbed(lattice(4, 11), 400)
    return readings


@pytest.mark.slow
def test_a_session_maps_and_names_the_pads_of_a_port(hand, tmp_path):
    options = ExaminationOptions(**OPTIONS)
    source = Given(Batch(hand), description=PORT)
    with LiveSession(source, tmp_path / "r.csv", options) as session:
        wait_for_maps(session, lambda maps: maps.quick)
        quick = session.maps.quick
        command = session.command
    # The final map of the session is made by the same function, in another process.
    final = examine(tmp_path / "r.csv", len(hand), options, final=True)
    assert [quick.names[i] for i in PADS] == NAMES
    assert quick.left_out == tuple(sorted(set(range(192)) - set(PADS)))
    assert np.isfinite(quick.positions[PADS]).all()
    assert list(final.sensor_map.names) == NAMES
    assert "--preset icub" in command
    np.testing.assert_array_equal(anisomap.read(tmp_path / "r.csv").readings, hand)
    read = io.read(tmp_path / "r.csv", options=io.ReadOptions(preset="icub"))
    again = anisomap.reconstruct(read, "r-anisomap", 2)
    np.testing.assert_allclose(final.sensor_map.positions, again.positions, atol=1e-6)


@pytest.mark.parametrize("limit", ["none", "of a map", "of a map in between"])
def test_pads_are_named_however_much_is_read(hand, tmp_path, monkeypatch, limit):
    """Above some limits, recordings are read in blocks, or in parts."""
    writer = JournalWriter(tmp_path / "r.csv", [f"s{i}" for i in range(192)], PORT)
    writer.add(np.arange(len(hand)) / 50, hand)
    writer.close()
    if limit == "of a map":
        monkeypatch.setattr(route, "LARGE_BYTES", 0)
        monkeypatch.setattr(route, "PROBED_BYTES", 0)
    monkeypatch.setattr(workers, "MAX_INTERIM_READINGS", 192 * 300)
    options = ExaminationOptions(**OPTIONS, drop=("palm.0",))
    final = limit != "of a map in between"
    found = examine(tmp_path / "r.csv", len(hand), options, final=final)
    assert found.sensor_map is not None, found.verdict
    assert list(found.sensor_map.names) == NAMES
    unplaced = [name for name, one in zip(NAMES, found.sensor_map.placed, strict=True) if not one]
    assert unplaced == ["palm.0"]
