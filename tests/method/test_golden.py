"""Maps of fixed recordings are those of the record, and a difference from it is found."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from golden.__main__ import main
from golden.cases import CASES, FOLDER, REAL, SOURCES
from golden.results import (
    EXACT,
    SIMILAR,
    Result,
    differences,
    displacement,
    read_record,
    result_of,
    write_record,
)

FAST = (
    *("copies", "leak", "sphere-potentials", "plane-walking", "torus-rubbed, halves"),
    *("sphere-rolling, r-anisomap", "hexagon-rubbed, isomap"),
)


@pytest.fixture(scope="module")
def record():
    return read_record()


@pytest.fixture
def result():
    """Give a result by hand: two components and a sensor without a place."""
    positions = np.random.default_rng(0).normal(size=(12, 3))
    positions[11] = np.nan
    component = np.repeat([0, 1, -1], [7, 4, 1])
    facts = {
        "level": "usable",
        "r": 0.9,
        "expected error": float("nan"),
        "repeatability": 0.5,
        "notes": ["a map differs by 0.38 spacings", "s3 is dead"],
    }
    return Result(facts, positions, component)


@pytest.mark.parametrize("name", FAST)
def test_maps_are_those_of_the_record(record, name):
    assert not differences(record[name], result_of(CASES[name]), SIMILAR)


def test_all_rows_are_recorded(record):
    assert list(record) == [*CASES, *REAL]
    assert {path.stem for path in (FOLDER / "readings").iterdir()} == set(SOURCES)


def test_no_reading_position_or_name_of_a_real_recording_is_recorded(record):
    for name in REAL:
        assert not record[name].positions.size
        assert all(isinstance(fact, str | float) for fact in record[name].facts.values())


def test_a_similar_map_does_not_differ(result):
    rotation = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    moved = 3 * result.positions @ rotation + np.where(result.component == 1, 5, 0)[:, None]
    for mirror in (1, -1):
        assert not differences(result, replace(result, positions=mirror * moved), EXACT)


@pytest.mark.parametrize("sensor", [2, 9])
def test_a_displaced_sensor_differs(result, sensor):
    positions = result.positions.copy()
    positions[sensor, 0] += 0.01
    other = replace(result, positions=positions)
    assert 1e-3 < displacement(result, other) < 0.1
    assert "moved" in differences(result, other, SIMILAR)[0]
    assert not differences(result, other, 0.1)
    positions[sensor] = np.nan
    assert displacement(result, other) == np.inf


@pytest.mark.parametrize("label", [0, -1])
def test_another_component_differs(result, label):
    component = result.component.copy()
    component[10] = label
    assert displacement(result, replace(result, component=component)) == np.inf
    assert displacement(result, replace(result, positions=result.positions[:, :2])) == np.inf


@pytest.mark.parametrize(
    ("changed", "limit"),
    [
        ({"level": "usable for neighbours"}, SIMILAR),
        ({"r": 0.902}, SIMILAR),
        ({"r": 0.9 + 1e-8}, EXACT),
        ({"expected error": 0.5}, SIMILAR),
        ({"repeatability": 0.7}, SIMILAR),
        ({"notes": ["a map differs by 0.38 spacings"]}, SIMILAR),
        ({"notes": ["a map differs by 0.38 spacings", "s4 is dead"]}, SIMILAR),
        ({"notes": ["a map differs by 0.39 spacings", "s3 is dead"]}, EXACT),
        ({"refused": "too few frames"}, SIMILAR),
    ],
)
def test_another_fact_differs(result, changed, limit):
    found = differences(result, replace(result, facts=result.facts | changed), limit)
    assert [text.partition(":")[0] for text in found] == list(changed)


def test_rounding_may_change_digits_and_order_but_not_the_map(result):
    notes = ["s3 is dead", "a map differs by 0.39 spacings"]
    other = replace(result, facts=result.facts | {"r": 0.9001, "notes": notes})
    assert not differences(result, other, SIMILAR)


def test_the_record_holds_results_exactly(result, tmp_path):
    write_record({"row": result}, tmp_path)
    assert not differences(read_record(tmp_path)["row"], result, EXACT)


def test_a_difference_is_reported_and_can_be_accepted(tmp_path, capsys):
    for name in ("record.json", "positions.npz"):
        shutil.copy(FOLDER / name, tmp_path)
    arguments = ["--rows", "copies", "--workers", "1", "--folder", str(tmp_path)]
    assert main(arguments) == 0
    path = tmp_path / "record.json"
    rows = json.loads(path.read_text())
    level, rows["copies"]["level"] = rows["copies"]["level"], "usable"
    path.write_text(json.dumps(rows))
    assert main(arguments) == 1
    assert f"level: usable became {level}" in capsys.readouterr().out
    assert main([*arguments, "--accept"]) == 0
    assert main(arguments) == 0
    assert list(read_record(tmp_path)) == list(rows)
    with pytest.raises(SystemExit):
        main(["--rows", "no such row"])
