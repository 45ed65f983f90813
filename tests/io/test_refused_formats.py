"""Formats that a library of Python reads: the line that a refusal names makes the recording."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import anisomap
from anisomap import io
from anisomap.errors import FileError

READINGS = np.random.default_rng(3).integers(0, 99, (40, 6)).astype(np.float32)
NAMES = tuple(f"pad{i}" for i in range(6))


def _table(path: Path) -> None:
    pytest.importorskip("pyarrow")
    frame = pytest.importorskip("pandas").DataFrame(READINGS, columns=NAMES)
    if path.suffix == ".parquet":
        frame.to_parquet(path)
    else:
        frame.to_feather(path)


def _film(path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    pytest.importorskip("PIL.ImageSequence")
    first, *others = (pillow.fromarray(row.reshape(2, 3)) for row in READINGS)
    first.save(path, save_all=True, append_images=others)


def _electrodes(path: Path) -> None:
    mne = pytest.importorskip("mne")
    info = mne.create_info([*NAMES, "STI"], 50.0, ["eeg"] * 6 + ["stim"])
    raw = mne.io.RawArray(np.vstack([READINGS.T, np.zeros(40)]), info, verbose="ERROR")
    raw.save(path, fmt="double", verbose="ERROR")


LIBRARIES = {"pandas": "pandas", "mne": "mne", "PIL": "PIL.Image", "numpy": "numpy"}
MAKERS: dict[str, Callable[[Path], None]] = {"film.tif": _film, "run_raw.fif": _electrodes}
MAKERS |= {"skin.parquet": _table, "skin.feather": _table}


@pytest.mark.parametrize("name", MAKERS)
def test_the_line_that_a_refusal_names_makes_the_recording(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    MAKERS[name](path)
    (tmp_path / "data.bin").write_bytes(path.read_bytes())
    for file in (path, tmp_path / "data.bin"):
        with pytest.raises(FileError, match=r"anisomap\.Recording\(") as refused:
            io.read(file)
    line = re.search(r"anisomap\.Recording\(.*(?=, which)", str(refused.value))[0]
    known: dict[str, Any] = {"anisomap": anisomap, "path": path, "paths": [path]}
    known |= {
        n: pytest.importorskip(m.partition(".")[0]) for n, m in LIBRARIES.items() if n in line
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = eval(line, known)  # noqa: S307
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == (NAMES if name != "film.tif" else tuple(f"s{i}" for i in range(6)))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("x.json", '{"specification": "probeinterface", "probes": []}', "read_probeinterface"),
        ("x.bdf", "a,b\n1,2\n", "mne.io.read_raw"),
        ("x.xlsx", "a,b\n1,2\n", "save its table as CSV"),
        ("x.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "is a mesh, as anisomap place"),
    ],
)
def test_other_formats_name_what_is_right(put, name: str, content: str, said: str) -> None:
    for read in (io.read, io.read_map):
        with pytest.raises(FileError, match=said):
            read(put(name, content))


def test_a_folder_of_images(tmp_path: Path) -> None:
    for i in range(3):
        (tmp_path / f"{i}.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(FileError, match=r"PIL\.Image\.open"):
        io.read(tmp_path)
