"""Corrected layouts in the robot's own files: wrong lines change, all others stay byte for byte."""

from dataclasses import replace

import numpy as np
import pytest

import anisomap
from anisomap import io
from anisomap.errors import FileError

DISPLAY = (
    b"cardid 12\r\n"
    b"CanDeviceNum 8   # of the left one, too\r\n"
    b"robotPart right_forearm\n"
    b"\n"
    b"#             x     y     th   gain\n"
    b"[SENSORS]\n"
    b"triangle_10pad\t4\t83  64\t-210\t4\t1\n"
    b"triangle_10pad 0\t0\t80\t-90\t4\t1  # the first\r\n"
    b"triangle_10pad\t1\t9\t96\t-30\t4\n"
    b"\n"
    b"triangle_10pad  2 40 20 30"
)


def turned(layout, chosen, angle, hand=1.0):
    """Turn some sensors about their middle."""
    positions = layout.positions.copy()
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    middle = positions[chosen].mean(axis=0)
    apart = positions[chosen] - middle
    apart[:, :2] = apart[:, :2] * [1, hand] @ [[cos, sin], [-sin, cos]]
    positions[chosen] = middle + apart
    return replace(layout, positions=positions)


def changed_lines(before, after):
    """Return the numbers of the lines that differ, of files with equally many."""
    first, second = (path.read_bytes().split(b"\n") for path in (before, after))
    assert len(first) == len(second)
    return [i for i, pair in enumerate(zip(first, second, strict=True), 1) if pair[0] != pair[1]]


@pytest.fixture
def display(tmp_path):
    path = tmp_path / "part.ini"
    path.write_bytes(DISPLAY)
    return path


@pytest.mark.parametrize(
    ("triangle", "turn", "line", "text"),
    [
        (0, (120, 1), 8, "triangle 0: orientation -90 -> 30"),
        (4, (120, 1), 7, "triangle 4: orientation -210 -> -90"),
        (1, (0, -1), 9, "mirror 0 -> 1"),
        (2, (0, -1), 11, "mirror 0 -> 1"),
    ],
)
def test_a_line_of_a_display_changes_in_its_own_terms(display, triangle, turn, line, text):
    angle, hand = turn
    stated = anisomap.read_map(display)
    centre = {0: (0, 80), 1: (9, 96), 2: (40, 20), 4: (83, 64)}[triangle]
    chosen = [i for i, name in enumerate(stated.names) if name.startswith(f"b0.t{triangle}.")]
    moved = stated.positions.copy()
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    moved[chosen] = (moved[chosen] - centre) * [1, hand] @ [[cos, sin], [-sin, cos]] + centre
    corrected = replace(stated, positions=moved)
    (edit,) = io.corrections(display, stated, corrected)
    assert edit.line == line
    assert text in edit.text
    assert edit.before == DISPLAY.decode().splitlines()[line - 1]
    fixed = display.with_name("fixed.ini")
    io.write_corrected(display, stated, corrected, fixed)
    assert changed_lines(display, fixed) == [line]
    found = anisomap.read_map(fixed)
    assert found.names == stated.names
    np.testing.assert_allclose(found.positions, moved, atol=0.01)


def test_a_layout_without_changes_is_the_same_file(display, tmp_path):
    stated = anisomap.read_map(display)
    io.write_corrected(display, stated, stated, tmp_path / "same.ini")
    assert (tmp_path / "same.ini").read_bytes() == DISPLAY


@pytest.mark.parametrize(
    ("header", "row", "end"),
    [
        ("# by hand\nname,x [mm],y [mm],gain", "taxel{i},{x:.3f}, {y:.3f} ,4", "\r\n"),
        ("name;x;y", "taxel{i};{x:.2f};{y:.2f}", "\n"),
        ("name\tx\ty\tz", "taxel{i}\t{x:.4f}\t{y:.4f}\t0.0", "\n"),
    ],
)
def test_lines_of_a_table_change_in_their_numbers(tmp_path, header, row, end):
    pads = np.random.default_rng(5).uniform(-40, 40, (30, 2)).round(2)
    rows = [row.format(i=i, x=x, y=y) for i, (x, y) in enumerate(pads.tolist())]
    path, fixed = tmp_path / "layout.csv", tmp_path / "fixed.csv"
    path.write_bytes(end.join([*header.split("\n"), *rows]).encode())
    stated = anisomap.read_map(path)
    corrected = turned(stated, [3, 4, 5], 60)
    moved = corrected.positions.copy()
    moved[[10, 20]] = moved[[20, 10]]
    corrected = replace(corrected, positions=moved)
    io.write_corrected(path, stated, corrected, fixed)
    first = 1 + len(header.split("\n"))
    assert changed_lines(path, fixed) == [first + i for i in (3, 4, 5, 10, 20)]
    found = anisomap.read_map(fixed)
    np.testing.assert_allclose(found.positions, moved, atol=0.006)
    np.testing.assert_array_equal(found.positions[[10, 20]], stated.positions[[20, 10]])


def test_normals_of_an_icub_file_go_with_the_places(tmp_path):
    lines = [f"{i % 4 * 0.005} {i // 4 * 0.005} 0.010 0.0 {i / 100} 1.0" for i in range(12)]
    lines[6] = lines[10] = "0 0 0 0 0 0"
    listed = " ".join(["3"] * 6 + ["-2"] + ["3"] * 3 + ["-2", "3"] + ["-1"] * 36)
    path, fixed = tmp_path / "foot.txt", tmp_path / "fixed.txt"
    path.write_text(f"name l_foot\ntaxel2Repr ( {listed} )\n[calibration]\n" + "\n".join(lines))
    stated = anisomap.read_map(path)  # values of -1 beyond the lines are no sign of a cut file
    assert stated.names == tuple(f"taxel{i}" for i in range(12) if i not in (6, 10))
    moved = stated.positions.copy()
    moved[[1, 8]] = moved[[8, 1]]
    io.write_corrected(path, stated, replace(stated, positions=moved), fixed)
    written = fixed.read_text().splitlines()[3:]
    expected = list(lines)
    expected[1], expected[9] = lines[9], lines[1]
    assert written == expected


def test_a_cut_icub_file_is_refused(tmp_path):
    path = tmp_path / "cut.txt"
    path.write_text("taxel2Repr ( 0 1 2 3 -1 -1 )\n[calibration]\n0 0 1 0 0 1\n0 1 0 0 0 1\n")
    with pytest.raises(FileError, match="cut short"):
        anisomap.read_map(path)
