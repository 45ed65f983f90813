"""An example file of every format, in the layout of the programs that write it."""

import gzip
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy

from anisomap import io
from anisomap.map_verdict import Verdict
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

N_FRAMES, N_SENSORS = 24, 5
NAMES = ("a", "b,c", 'd"e', "=f\ng", "#h")


def _readings() -> np.ndarray:
    rng = np.random.default_rng(20)
    values = rng.random((N_FRAMES, N_SENSORS)).round(3)
    return np.where(values < 0.4, 0, values)


def example_recording() -> Recording:
    """Make a recording with names that some format must escape, times and metadata."""
    return Recording(
        _readings(),
        names=NAMES,
        times=np.arange(N_FRAMES) / 10,
        units="mm",
        source="by hand",
        metadata={"seed": 3, "licence": "BSD-3-Clause"},
    )


def example_map(*, in_metres: bool = False) -> SensorMap:
    """Make a map with an unplaced sensor, and several components unless it is in metres."""
    positions = np.random.default_rng(21).standard_normal((N_SENSORS, 3))
    positions[3] = np.nan
    return SensorMap(
        positions,
        names=NAMES,
        component=[0, 0, 0 if in_metres else 1, -1, 0],
        health=("ok", "noisy", "ok", "dead", "ok"),
        units="m" if in_metres else "",
        method="r-anisomap",
        stress=0.0625,
        verdict=Verdict(
            "usable",
            expected_error=0.5,
            expected_error_high=math.inf,
            neighbours_kept=0.9,
            reasons=("few frames", "# b: c"),
        ),
        notes=("one sensor never varies",),
        provenance={"seed": 3, "mu": 1.0, "weighted": False, "source": "skin.csv"},
    )


def own_recording(path: Path) -> None:
    io.write(example_recording(), path)


def own_map(path: Path) -> None:
    io.write(example_map(in_metres=io.needs_scale(path)), path)


def _lines(row: Callable[[int, list[float]], str], end: str = "\n") -> str:
    return "".join(row(i, values) + end for i, values in enumerate(_readings().tolist()))


def _foreign(path: Path) -> None:
    """Semicolons and decimal commas, as a German spreadsheet writes them."""
    header = "time [ms];frame;" + ";".join(f"s{i}" for i in range(N_SENSORS)) + ";\r\n"
    rows = _lines(lambda i, v: f"{10 * i};{i};" + ";".join(map(str, v)) + ";", "\r\n")
    path.write_text(header + rows.replace(".", ","), encoding="utf-8-sig", newline="")


def _gzipped(path: Path) -> None:
    rows = _lines(lambda i, v: f"{i / 50:.2f} " + " ".join(map(str, v)))
    path.write_bytes(gzip.compress(rows.encode(), mtime=0))


def _stamp(frame: int) -> str:
    return f"10:00:{frame // 50:02d}.{20 * (frame % 50):03d}"


def _monitor(path: Path) -> None:
    path.write_text(_lines(lambda i, v: f"{_stamp(i)} -> " + "\t".join(map(str, v))))


def _labelled(path: Path) -> None:
    path.write_text(_lines(lambda i, v: " ".join(f"S{k}:{x}" for k, x in enumerate(v))))


def _rows_of_json(path: Path) -> None:
    path.write_text(_lines(lambda i, v: json.dumps({"t": i / 50, "p": v})))


def _one_stamp(path: Path) -> None:
    path.write_text(
        _lines(lambda i, v: f"{7 + i} {1.3e9 + i / 50:.6f} (" + " ".join(map(str, v)) + ")")
    )


def _two_stamps(path: Path) -> None:
    path.write_text(
        _lines(
            lambda i, v: (
                f"{i} {1.3e9 + i / 50:.6f} {1.3e9 + 0.001 + i / 50:.6f} " + " ".join(map(str, v))
            )
        )
    )


def _archive(path: Path) -> None:
    """Written by numpy without compression, so that damage affects the arrays."""
    with path.open("wb") as stream:
        np.savez(
            stream,
            readings=_readings(),
            names=np.array(NAMES),
            times=np.arange(N_FRAMES) / 10,
            positions=_readings()[:N_SENSORS, :3],
            units="mm",
            licence="MIT",
            triangle=np.arange(N_SENSORS),
        )


def _tables(path: Path, transposed: bool = False) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512 if transposed else 0) as file:
        readings, times = _readings(), np.arange(N_FRAMES) / 50
        if transposed:
            readings, times = np.ascontiguousarray(readings.T), times[None]
        else:
            file["skin/names"] = np.array(NAMES, dtype="S")
        file.create_dataset("skin/readings", data=readings, chunks=True, compression="gzip")
        file["skin/time"] = times
    if transposed:
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))


def _matlab(path: Path) -> None:
    contents = {"readings": _readings(), "time": np.arange(N_FRAMES) / 50}
    scipy.io.savemat(path, contents, do_compression=True)


def _bag(path: Path) -> None:
    bags = pytest.importorskip("bags")
    bag = bags.Bag(path.suffix[1:])
    for i, row in enumerate(_readings()):
        bag.add("/skin", bag.array(row), i)
    bag.messages = [
        (topic, message, bags.START + 20_000_000 * i)
        for i, (topic, message, _) in enumerate(bag.messages)
    ]
    bag.write(path)
    shutil.rmtree(path.with_suffix(""), ignore_errors=True)


def _mat_export(path: Path) -> None:
    frames = _lines(lambda i, v: f"Frame {i + 1}\n" + ",".join(map(str, v)) + "\n")
    path.write_text(
        "DATA_TYPE MOVIE\nROWS 1\nCOLS 5\nROW_SPACING 8.4 mm\nCOL_SPACING 5.1 mm\n"
        f"SECONDS_PER_FRAME 0.02\nASCII_DATA @@\n\n{frames}@@\n"
    )


def _cyskin(path: Path) -> None:
    """Three taxels of five with addresses beside each response, as robotskinlib records them."""
    rows = _lines(
        lambda i, v: (
            f"{i} {26.82 + i / 10:f} 5 " + " ".join(f"{7 * k + 9} {x}" for k, x in enumerate(v))
        )
    )
    path.write_text(f"1\n5\n{rows}")


def _cyskin_of_driver(path: Path) -> None:
    """Addresses in the first line, as the acquisition program writes them."""
    rows = _lines(lambda i, v: f"{i} {i / 10:f} " + " ".join(map(str, v)))
    path.write_text(f"16 17 18 32 33 \n{rows}")


def _calibration(path: Path) -> None:
    """One patch in a list of its own and one beside it; address 0 is a taxel without a module."""
    sensor_map = example_map()
    taxels = [
        {"id": 7 * k + 9 if placed else 0, "x": x if placed else [0, 0, 0], "n": [0, 0, 1]}
        for k, (x, placed) in enumerate(
            zip(sensor_map.positions.tolist(), sensor_map.placed, strict=True)
        )
    ]
    skin = {"n_taxels": 5, "taxels": [taxels[:3], *taxels[3:]]}
    path.write_text(json.dumps({"info": {"file_version": 2}, "skin": skin}, indent="\t"))


def _display(path: Path) -> None:
    """Two triangles of a board, the second as seen from behind, and a comment."""
    path.write_text(
        "robotPart left_arm\n\n[SENSORS]\n# x y th gain mirror\n"
        "triangle_10pad\t17\t12\t37\t-180\t4\t0\t\ntriangle_10pad 3 40.5 9 30 4 1\n"
    )


RECORDINGS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "skin.npz": ("npz", own_recording),
    "numpy.npz": ("npz", _archive),
    "skin.npy": ("npy", lambda path: np.save(path, _readings())),
    "skin.csv": ("text", own_recording),
    "skin.tsv": ("text", own_recording),
    "foreign.csv": ("text", _foreign),
    "blanks.txt.gz": ("text", _gzipped),
    "monitor.txt": ("text", _monitor),
    "printed.txt": ("text", lambda path: path.write_text(_lines(lambda i, v: str(v)))),
    "labels.txt": ("text", _labelled),
    "rows.jsonl": ("json-lines", _rows_of_json),
    "data.log": ("yarp", _two_stamps),
    "dumped.log": ("yarp", _one_stamp),
    "run.bag": ("ros", _bag),
    "run.mcap": ("ros", _bag),
    "run.db3": ("ros", _bag),
    "mat.asf": ("mat-export", _mat_export),
    "hand.txt": ("cyskin", _cyskin),
    "gesture.txt": ("cyskin", _cyskin_of_driver),
    "skin.h5": ("hdf5", _tables),
    "skin.mat": ("mat", _matlab),
    "v73.mat": ("mat", lambda path: _tables(path, transposed=True)),
}
MAPS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "map.npz": ("npz", own_map),
    "map.csv": ("text", own_map),
    "map.tsv": ("text", own_map),
    "map.json": ("json", own_map),
    "map.ply": ("ply", own_map),
    "map.urdf": ("urdf", own_map),
    "map.mjcf": ("mjcf", own_map),
    "map.icub.txt": ("icub", own_map),
    "handle.json": ("cyskin-calibration", _calibration),
    "arm.ini": ("icub-display", _display),
}
