"""Maps and recordings are read back bit for bit, with any names and notes."""

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from anisomap import io
from anisomap.errors import FileError, InputError
from anisomap.map_verdict import ACCURACY, LEVELS, UNKNOWN, Verdict
from anisomap.recording import Recording, Scalar
from anisomap.sensor_map import MAX_COORDINATE, SensorMap

TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)
TRICKY = st.sampled_from(
    [
        *("", " ", "3", "1e5", "NaN", "true", "null", "[1]", "{}", "provenance", "'", "\\"),
        *('"', '"a"', "a,b", "a;b", "a\tb", "a,", "#", "# x: y", "a: b"),
        *("x\ny", "\r", "\r\n#", "\u2028", "\ufeff"),
    ]
)
WORDS = TEXTS | TRICKY
FLOATS = st.floats(allow_nan=True, allow_infinity=True)
VERDICTS = st.builds(
    Verdict, st.sampled_from([*LEVELS, UNKNOWN]), *3 * [FLOATS], reasons=st.lists(WORDS, max_size=3)
)
FINITE = st.floats(-1e9, 1e9)
PLACES = st.floats(-MAX_COORDINATE, MAX_COORDINATE) | st.sampled_from([np.nan, np.inf])
SCALARS = WORDS | st.booleans() | st.integers(-(10**30), 10**30) | FLOATS


@st.composite
def maps(draw: st.DrawFn, min_k: int = 1, max_k: int = 4) -> SensorMap:
    n_sensors, k = draw(st.integers(1, 6)), draw(st.integers(min_k, max_k))
    positions = draw(hnp.arrays(np.float64, (n_sensors, k), elements=PLACES))
    placed = np.isfinite(positions).all(axis=1)
    labels = draw(hnp.arrays(np.intp, int(placed.sum()), elements=st.integers(0, 3)))
    component = np.full(n_sensors, -1)
    component[placed] = np.unique(labels, return_inverse=True)[1]
    return SensorMap(
        positions,
        names=draw(st.lists(WORDS, min_size=n_sensors, max_size=n_sensors, unique=True)),
        component=component,
        health=draw(st.lists(WORDS, min_size=n_sensors, max_size=n_sensors)),
        units=draw(WORDS),
        method=draw(WORDS),
        stress=draw(FLOATS),
        notes=draw(st.lists(WORDS, max_size=3)),
        verdict=draw(VERDICTS),
        handed=draw(st.booleans()),
        anchored=draw(st.booleans()),
        errors=draw(hnp.arrays(np.float64, n_sensors, elements=FLOATS)),
        covariances=draw(st.none() | hnp.arrays(np.float64, (n_sensors, k, k), elements=FLOATS)),
        normals=draw(st.none() | hnp.arrays(np.float64, (n_sensors, 3), elements=FLOATS)),
        provenance=draw(st.dictionaries(WORDS, SCALARS, max_size=4)),
    )


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    shape = draw(st.tuples(st.integers(1, 12), st.integers(1, 4)))
    width = draw(st.sampled_from([32, 64]))
    elements = st.floats(width=width) | st.integers(0, 255).map(float)
    n_frames, n_sensors = shape
    steps = st.lists(
        st.integers(-(10**12), 10**12), min_size=n_frames, max_size=n_frames, unique=True
    )
    places = hnp.arrays(np.float64, (n_sensors, draw(st.integers(2, 3))), elements=FINITE)
    return Recording(
        draw(hnp.arrays(f"f{width // 8}", shape, elements=elements)),
        positions=draw(st.none() | places),
        units=draw(WORDS),
        names=draw(st.lists(WORDS, min_size=n_sensors, max_size=n_sensors, unique=True)),
        times=draw(st.none() | steps.map(lambda ticks: np.sort(ticks) / 1000)),
        rate_hz=draw(st.none() | st.floats(1e-3, 1e6)),
        source=draw(WORDS),
        metadata=draw(st.dictionaries(WORDS, SCALARS, max_size=4)),
    )


def assert_same_bits(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(found, expected, strict=True)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(expected[known]))


def assert_same_mapping(found: Mapping[str, Scalar], expected: Mapping[str, Scalar]) -> None:
    assert list(found) == list(expected)
    for key, value in expected.items():
        assert type(found[key]) is type(value)
        np.testing.assert_equal(found[key], value)


def assert_same_map(found: SensorMap, expected: SensorMap) -> None:
    assert_same_bits(found.positions, expected.positions)
    for name in ("component", "errors", "covariances", "normals", "stress"):
        np.testing.assert_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("names", "health", "units", "method", "notes", "handed", "anchored"):
        assert getattr(found, name) == getattr(expected, name), name
    for name in ("level", "reasons", *ACCURACY):
        np.testing.assert_equal(getattr(found.verdict, name), getattr(expected.verdict, name))
    assert_same_mapping(found.provenance, expected.provenance)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("round-trips")


def refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is not JSON")


@given(sensor_map=maps())
def test_maps(folder: Path, sensor_map: SensorMap) -> None:
    for suffix in (".csv", ".tsv", ".json", ".npz"):
        path = folder / f"map{suffix}"
        io.write(sensor_map, path)
        assert_same_map(io.read_map(path), sensor_map)
    text = (folder / "map.json").read_text(encoding="utf-8")
    document = json.loads(text, parse_constant=refuse)
    unknown = [None in sensor["position"] for sensor in document["sensors"]]
    np.testing.assert_array_equal(unknown, np.isnan(sensor_map.positions).any(axis=1))


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".json"])
@pytest.mark.parametrize(
    "mark",
    [
        *("taxel2Repr", "taxel2Repr ( 0 )", "skin", "taxels", "<robot/>", "<mujoco/>"),
        *("VERSION ", "ply", "a\nframe 1\nframe 2\n", "a\n1 1.5 ((2))\n", "a\ntime,sensors\n1,2\n"),
    ],
)
def test_texts_may_be_marks_of_other_formats(tmp_path: Path, suffix: str, mark: str) -> None:
    texts = {"method": mark, "units": mark, "notes": [mark, "skin"], "provenance": {mark: "taxels"}}
    sensor_map = SensorMap(np.eye(2), names=[mark, "b"], **texts)
    io.write(sensor_map, tmp_path / f"map{suffix}")
    assert_same_map(io.read_map(tmp_path / f"map{suffix}"), sensor_map)
    if suffix != ".json":
        recording = Recording(np.eye(2), names=[mark, "b"], source=mark, metadata={mark: mark})
        io.write(recording, tmp_path / f"skin{suffix}")
        found = io.read(tmp_path / f"skin{suffix}")
        assert (found.names, found.source) == (recording.names, recording.source)


@given(sensor_map=maps(2, 3))
def test_point_clouds(folder: Path, sensor_map: SensorMap) -> None:
    path = folder / "map.ply"
    io.write(sensor_map, path)
    if not sensor_map.placed.any():
        with pytest.raises(InputError, match="no vertices"):
            io.read_map(path)
        return
    found = io.read_map(path)
    assert_same_bits(found.positions, sensor_map.positions[sensor_map.placed])
    np.testing.assert_array_equal(found.component, sensor_map.component[sensor_map.placed])
    assert found.names == sensor_map.select(sensor_map.placed).names
    assert found.units == sensor_map.units


@given(recording=recordings())
def test_recordings(folder: Path, recording: Recording) -> None:
    for suffix in (".csv", ".tsv", ".npz"):
        path = folder / f"skin{suffix}"
        io.write(recording, path)
        found = io.read(path)
        assert found.units == recording.units
        np.testing.assert_equal(found.positions, recording.positions)
        np.testing.assert_equal(found.normals, recording.normals)
        assert_same_bits(found.readings.astype(np.float64), recording.readings.astype(np.float64))
        assert found.readings.dtype <= recording.readings.dtype
        assert found.names == recording.names
        assert (found.times is None) == (recording.times is None)
        if recording.times is not None and found.times is not None:
            assert_same_bits(found.times, recording.times)
        assert found.rate_hz == recording.rate_hz
        assert found.source == recording.source
        assert_same_mapping(found.metadata, recording.metadata)


def test_text_with_positions_that_do_not_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "skin.csv"
    io.write(Recording(np.eye(3), positions=np.eye(3), units="mm"), path)
    path.write_text(path.read_text().replace("; 0.0 0.0 1.0", "; 0.0 0.0"))
    with pytest.raises(FileError, match="positions must be 2 or 3 numbers for each sensor"):
        io.read(path)


def test_point_clouds_have_three_dimensions(tmp_path: Path) -> None:
    flat = SensorMap([[1.5, -2.5]], names=["a"])
    io.write(flat, tmp_path / "flat.ply")
    assert (tmp_path / "flat.ply").read_text().splitlines()[-1] == "1.5 -2.5 0.0 0.0 0.0 1.0 0 0"
    with pytest.raises(InputError, match="at most 3 dimensions, got 4"):
        io.write(SensorMap(np.eye(4)), tmp_path / "x.ply")


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz"])
@pytest.mark.parametrize("field", ["distorted", "mirrored", "handed", "anchored", "frame"])
def test_provenance_may_use_the_names_of_fields(tmp_path: Path, suffix: str, field: str) -> None:
    path = tmp_path / f"map{suffix}"
    for value, flag in (("", True), (True, False), ("base", True)):
        provenance = {field: value, f"~{field}": 2, f"~~{field}": 3, "~": 4}
        changed = {field: ("base" if flag else "skin") if field == "frame" else flag}
        sensor_map = replace(SensorMap(np.eye(2), provenance=provenance), **changed)
        io.write(sensor_map, path)
        found = io.read_map(path)
        assert dict(found.provenance) == provenance
        assert getattr(found, field) == getattr(sensor_map, field)


def test_comments_padded_by_a_spreadsheet(tmp_path: Path, sensor_map: SensorMap) -> None:
    path = tmp_path / "map.csv"
    io.write(sensor_map, path)
    path.write_text(re.sub("^(#.*)$", r"\1,,,,", path.read_text(), flags=re.MULTILINE))
    assert_same_map(io.read_map(path), sensor_map)


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz", ".ply"])
def test_the_reference_frame_is_always_written(
    tmp_path: Path, sensor_map: SensorMap, suffix: str
) -> None:
    path = tmp_path / f"map{suffix}"
    placed = replace(sensor_map, units="mm", frame="left_palm")
    for written, scale in ((sensor_map, "unknown"), (placed, "in mm")):
        io.write(written, path)
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as stored:
                stated = {key: str(stored[key]) for key in ("scale", "handedness", "frame")}
        else:
            lines = [line.strip('# ,"') for line in path.read_text().splitlines()]
            pairs = (line.removeprefix("comment ").partition(":") for line in lines)
            stated = {key.strip('"'): value.strip(' "') for key, _, value in pairs}
        assert stated["scale"] == scale
        assert stated["frame"] == written.frame
        assert stated["handedness"].startswith("right-handed")
        if suffix == ".csv":
            facts = {"method: r-anisomap", "stress: 0.0625", "verdict: usable"}
            facts.add("expected_error: 0.5")
            assert facts <= set(lines)
            assert f"known up to {written.known_up_to}" in lines[0]
    assert "scale" not in placed.known_up_to


FORMULAS = ("=cmd|' /C calc'!A0", "'=1", "''+2", "-3", "@sum", "\t=4", "'plain", "\uff1d5")


@pytest.mark.parametrize("suffix", [".csv", ".tsv"])
def test_names_are_no_formulas_in_spreadsheets(suffix: str, tmp_path: Path) -> None:
    notes = ("a,=1+1", "b;@sum,+x", "plain, -3 dB")
    facts = {"key,=2": "x,=3"}
    count = len(FORMULAS)
    skin = SensorMap(
        np.eye(count, 3), names=FORMULAS, health=FORMULAS, notes=notes, provenance=facts
    )
    recording = Recording(np.eye(count), names=FORMULAS, metadata=facts)
    for data, read in ((skin, io.read_map), (recording, io.read)):
        path = tmp_path / f"skin{suffix}"
        io.write(data, path)
        found = read(path)
        assert found.names == FORMULAS
        with path.open(encoding="utf-8", newline="") as stream:
            mark = "\t" if suffix == ".tsv" else ","
            cells = [cell for row in csv.reader(stream, delimiter=mark) for cell in row]
        starts = ("=", "+", "-", "@", "\t", "\r", "\uff1d")
        texts = [cell for cell in cells if not cell.lstrip("-").replace(".", "").isdigit()]
        assert not [cell for cell in texts if cell.startswith(starts)]
        if isinstance(found, SensorMap):
            assert found.health == FORMULAS
            assert found.notes == notes
            assert found.provenance == facts
        else:
            assert found.metadata == facts
