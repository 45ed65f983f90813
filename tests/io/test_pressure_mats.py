"""Pressure mats and image sequences, with various headers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError

Put = Callable[[str, str | bytes], Path]
FRAMES = np.random.default_rng(5).integers(0, 255, (30, 4, 3))
HEADER = """DATA_TYPE MOVIE
SENSOR_TYPE 5250
ROWS 4
COLS 3
ROW_SPACING 1.27 mm
COL_SPACING 2.5 mm
SECONDS_PER_FRAME 0.01
UNITS kPa
ASCII_DATA @@

"""


def rows(frame: np.ndarray, between: str = ",") -> str:
    return "".join(between.join(map(str, row)) + "\n" for row in frame.tolist())


def movie(header: str = HEADER, end: str = "@@\n") -> str:
    return header + "\n".join(f"Frame {i}\n{rows(f)}" for i, f in enumerate(FRAMES, 1)) + end


def test_ascii_movie(put: Put) -> None:
    found = io.read(put("walk.asf", movie()))
    np.testing.assert_array_equal(found.readings, FRAMES.reshape(30, 12))
    assert found.names[:4] == ("r0c0", "r0c1", "r0c2", "r1c0")
    np.testing.assert_allclose(found.positions[4], [2.5, 1.27])
    assert found.units == "mm"
    assert found.rate_hz == pytest.approx(100)


def test_cells_outside_the_sensor_are_dropped(put: Put) -> None:
    frames = [f.astype(object) for f in FRAMES]
    for frame in frames:
        frame[0, 0] = frame[3, 2] = "B"
    text = HEADER + "\n".join(f"Frame {i}\n{rows(f)}" for i, f in enumerate(frames, 1))
    found = io.read(put("foot.csv", text))
    np.testing.assert_array_equal(found.readings, FRAMES.reshape(30, 12)[:, 1:-1])
    assert "r0c0" not in found.names
    assert len(found.positions) == 10


def test_quoted_csv_with_a_clock_and_decimal_commas(put: Put) -> None:
    """The export of a mat program with a German or Dutch locale."""
    text = 'File:,"walk"\nSensor:,"PX100"\n'
    for i, frame in enumerate(FRAMES):
        quoted = "".join(",".join(f'"{v},5"' for v in row) + "\n" for row in frame.tolist())
        text += f'Frame:,"{i + 1}"\nTime:,"23:59:{i / 25 + 59:06.3f}"\nRows:,4\nColumns:,3\n'
        text = text.replace('"23:59:60', '"00:00:00')
        text += quoted + "\n"
    found = io.read(put("export.csv", text))
    np.testing.assert_array_equal(found.readings, FRAMES.reshape(30, 12) + 0.5)
    np.testing.assert_allclose(found.times[:25], np.arange(25) / 25, atol=1e-6)
    assert found.units == "spacings"


@pytest.mark.parametrize("between", [",", ";", "\t", " "])
def test_frames_without_any_header(put: Put, between: str) -> None:
    text = "".join(f"Frame {i}\n{rows(f, between)}\n" for i, f in enumerate(FRAMES))
    found = io.read(put("mat.txt", text))
    np.testing.assert_array_equal(found.readings, FRAMES.reshape(30, 12))


def test_a_table_with_a_column_frame_is_not_an_export(put: Put) -> None:
    found = io.read(put("x.csv", "frame,a,b\n0,1,2\n1,3,4\n"))
    assert found.names == ("a", "b")


def test_a_truncated_last_frame(put: Put) -> None:
    text = movie(end="")
    with pytest.warns(AnisomapWarning, match="truncated in row 3 of 4.* 29 frames"):
        assert io.read(put("walk.asf", text[: text.rindex("\n", 0, -1) + 1])).n_frames == 29


@pytest.mark.parametrize("between", ["\t", ";", ","])
def test_a_table_below_metadata(put: Put, between: str) -> None:
    """Insoles: metadata, then a table with names."""
    above = f"file name:{between}walk01\ndate/time 03.04.25 12:00\n\nsensors{between}99\n\n"
    names = between.join(["time[secs]", "left 1", "left 2", "right 1", "right 2"])
    body = "".join(
        f"{i / 50:.2f}{between}" + between.join(map(str, row)) + "\n"
        for i, row in enumerate(FRAMES[:, 0, [0, 1, 2, 0]].tolist())
    )
    found = io.read(put("walk.asc", f"{above}{names}\n{body}"))
    assert found.names == ("left 1", "left 2", "right 1", "right 2")
    np.testing.assert_array_equal(found.readings, FRAMES[:, 0, [0, 1, 2, 0]])
    assert found.rate_hz == pytest.approx(50)
    broken = body.replace("\n", f"\n1{between}2\n", 9).replace(f"1{between}2\n", "", 8)
    with pytest.raises(FileError, match=r"line 16 has 2 fields, but the header names 5"):
        io.read(put("walk.asc", f"{above}{names}\n{broken}"))


@pytest.fixture
def pillow():
    return pytest.importorskip("PIL.Image")


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp"])
def test_a_folder_of_images_in_the_order_of_their_numbers(tmp_path: Path, pillow, suffix) -> None:
    for i, frame in enumerate(FRAMES):
        pillow.fromarray(frame.astype(np.uint8)).save(tmp_path / f"touch{i}.{suffix}")
    found = io.read(tmp_path)
    np.testing.assert_array_equal(found.readings, FRAMES.reshape(30, 12))
    assert found.units == "pixels"
    assert found.names[-1] == "r3c2"


def test_images_of_16_bits_and_in_colour(tmp_path: Path, pillow) -> None:
    deep = [pillow.fromarray((257 * frame).astype(np.uint16)) for frame in FRAMES]
    deep[0].save(tmp_path / "deep.tif", save_all=True, append_images=deep[1:])
    found = io.read(tmp_path / "deep.tif")
    np.testing.assert_array_equal(found.readings, 257 * FRAMES.reshape(30, 12))
    grey = [pillow.fromarray(np.repeat(f[..., None], 3, 2).astype(np.uint8)) for f in FRAMES]
    grey[0].save(tmp_path / "grey.tif", save_all=True, append_images=grey[1:])
    np.testing.assert_array_equal(io.read(tmp_path / "grey.tif").readings, FRAMES.reshape(30, 12))


def test_unsuitable_images(tmp_path: Path, pillow) -> None:
    one = pillow.fromarray(FRAMES[0].astype(np.uint8))
    one.save(tmp_path / "one.tif")
    with pytest.raises(FileError, match="a single image"):
        io.read(tmp_path / "one.tif")
    (tmp_path / "sizes").mkdir()
    one.save(tmp_path / "sizes" / "a.png")
    one.resize((2, 2)).save(tmp_path / "sizes" / "b.png")
    with pytest.raises(FileError, match="size of the first, 4 x 3, but image 1 has 4 pixels"):
        io.read(tmp_path / "sizes")
