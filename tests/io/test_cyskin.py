"""CySkin: text recordings of two programs, and calibrations with the positions."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError

Put = Callable[[str, str | bytes], Path]
ADDRESSES = (38135, 38136, 38433, 38140, 38433)
"""One address is in two places, as in a published recording of a gripped handle."""
READINGS = np.random.default_rng(4).integers(0, 900, (30, 5)).astype(float)
NAMES = ("38135", "38136", "38433", "38140", "38433_2")


def recorded(addresses=ADDRESSES, readings: np.ndarray = READINGS) -> str:
    rows = [
        f"{i} {26.82 + i / 10:f} {len(addresses)} "
        + " ".join(f"{a} {v:.0f}" for a, v in zip(addresses, row, strict=True))
        for i, row in enumerate(readings)
    ]
    return "\n".join(["1", str(len(addresses)), *rows]) + "\n"


def calibration(addresses=ADDRESSES, **changes: object) -> str:
    taxels = [
        {"id": address, "x": [k / 100, 0.0, k % 2], "n": [0, 0, 1], "type": "pressure", "cut": 0}
        for k, address in enumerate(addresses)
    ]
    taxels[1].update(changes)
    return json.dumps({"info": {"file_version": "2"}, "skin": {"taxels": taxels, "faces": []}})


def test_a_recording_with_its_calibration(put: Put) -> None:
    truth = put("handle.json", calibration())
    with pytest.warns(AnisomapWarning, match="several sensors have the name 38433"):
        found = io.read(put("hand.txt", recorded()), options=io.ReadOptions(positions=truth))
    np.testing.assert_array_equal(found.readings, READINGS)
    np.testing.assert_allclose(found.times, np.arange(30) / 10, atol=1e-9)
    assert found.names == NAMES
    np.testing.assert_array_equal(found.positions[:, 0], np.arange(5) / 100)
    assert found.units == "m"


def test_errors_of_sensors_are_missing_readings(put: Put) -> None:
    found = io.read(put("skin_data.txt", "7 8 9 \n0 0.600000 1 43000 2\n1 0.700000 3 4 65535\n"))
    assert found.names == ("7", "8", "9")
    np.testing.assert_array_equal(found.readings, [[1, np.nan, 2], [3, 4, np.nan]])


def test_normals_become_unit_vectors(put: Put) -> None:
    for normal, expected in (([0, 3, 4], [0, 0.6, 0.8]), ([0, 0, 0], [np.nan] * 3), ("up", None)):
        found = io.read_map(put("handle.json", calibration((7, 8, 9), n=normal)))
        np.testing.assert_array_equal(found.normals[0], [0, 0, 1])
        np.testing.assert_allclose(found.normals[1], expected or [np.nan] * 3)


def test_a_calibration_is_no_recording(put: Put) -> None:
    with pytest.raises(FileError, match=r"handle\.json .*CySkin calibration.* holds no recording"):
        io.read(put("handle.json", calibration((7, 8, 9))))
