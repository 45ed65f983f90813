"""Journeys from the files of whole bodies to a scored map: contacts, CySkin."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap.recording import Recording
from command_line import write_layout
from skins import flat_skin

FRAMES = 600
CALIBRATION = "handle.json"


def cyskin(skin: Recording, path: Path) -> None:
    with path.open("w") as file:
        print(1, skin.n_sensors, sep="\n", file=file)
        for i, values in enumerate(skin.readings.tolist()):
            pairs = " ".join(f"{k} {value:.6f}" for k, value in enumerate(values, start=1))
            print(i, f"{i / 10:.2f}", skin.n_sensors, pairs, file=file)


@pytest.fixture(scope="module")
def skin() -> Recording:
    whole = flat_skin()
    return Recording(whole.readings[:FRAMES], positions=whole.positions)


def calibrate(skin: Recording, first: int) -> None:
    """Write the positions as a calibration of CySkin, with addresses from `first`."""
    positions = np.column_stack([skin.positions, np.zeros(skin.n_sensors)]) / 1000
    taxels = [
        {"id": k, "x": x, "n": [0, 0, 1]} for k, x in enumerate(positions.tolist(), start=first)
    ]
    document = {"info": {"file_version": "2"}, "skin": {"taxels": taxels}}
    Path(CALIBRATION).write_text(json.dumps(document))


def test_from_the_file_to_a_scored_map(run, run_map, skin, tmp_path):
    cyskin(skin, tmp_path / "hand.txt")
    calibrate(skin, 1)
    looked = run("info", "hand.txt")
    assert f"{skin.n_sensors}, " in looked.out
    done = run_map("hand.txt", "--positions", CALIBRATION, "-o", "m.csv", "--json")
    score = done.values["score"]
    assert score["sensors_compared"] == skin.n_sensors
    # On eight seeds of this skin, readings reach .98 to .998.
    assert score["mantel_r"] > 0.85


def test_logs_of_contacts_are_refused(run, skin, tmp_path):
    """The page that is named holds a program that makes readings, and is run as a test."""
    vectors = " ".join(["(0.01 -0.02 0.5)"] * 5)
    with (tmp_path / "data.log").open("w") as log:
        for i, values in enumerate(skin.readings):
            taxels = " ".join(map(str, np.flatnonzero(values)))
            contact = f"((7 4 5 5) {vectors} ({taxels}) 12.5)" if taxels else ""
            print(i, f"{1.3e9 + i / 10:.6f}", contact, file=log)
    refused = run("info", "data.log", code=2).err
    assert "lists contacts (skin_events)" in refused
    page = re.search(r"docs/\S+\.md", refused)[0]
    assert "skin_events" in Path(__file__).parents[2].joinpath(page).read_text("utf-8")


def test_a_grid_with_dead_cells(run_map, skin, tmp_path):
    """The cells around the skin never vary; the map leaves them out."""
    rows, columns = 6, 7
    padded = np.zeros((skin.n_frames, rows + 2, columns))
    padded[:, 1:-1] = skin.readings.reshape(-1, rows, columns)
    anisomap.write(Recording(padded.reshape(skin.n_frames, -1)), tmp_path / "mat.npz")
    done = run_map("mat.npz", "--grid", f"{rows + 2}x{columns}", "-o", "m.csv", "--json")
    assert done.values["map"]["placed"] == skin.n_sensors
    assert done.values["score"]["mantel_r"] > 0.85


def test_positions_of_sensors_that_a_preset_names(run_map, skin, tmp_path):
    """A board of the iCub: the positions have the names of the preset."""
    pads = [12 * triangle + pad for triangle in range(4) for pad in range(12) if pad not in (6, 10)]
    values = np.full((skin.n_frames, 192), 255)
    values[:, pads] = 240 - np.round(100 * skin.readings[:, : len(pads)])
    for name in ("one.log", "two.log"):
        rows = (" ".join(map(str, row)) for row in values.tolist())
        lines = [f"{i} {1.7e9 + i / 20:.6f} {row}" for i, row in enumerate(rows)]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    names = [f"b0.t{pad // 12}.k{pad % 12}" for pad in pads]
    write_layout(tmp_path / "truth.csv", skin.positions[: len(pads)], names)
    for words in (["one.log"], ["one.log", "two.log"]):
        words += ["--preset", "icub", "--positions", "truth.csv"]
        score = run_map(*words, "-o", "m.csv", "--json").values["score"]
        assert score["sensors_compared"] == len(pads)
        assert score["mantel_r"] > 0.85
