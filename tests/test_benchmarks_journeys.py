"""The journeys of users are timed in parts, with busy neighbours and with their growth."""

import csv

import pytest
from benchmarks import journeys
from benchmarks.journeys import Journey, main, readings_of_8_bits, slopes, travel


def journey(name, n_sensors, n_frames, cpu):
    return Journey(name, n_sensors, n_frames, cpu=cpu, clock=cpu)


def test_the_growth_of_a_power_law_is_its_exponent():
    made = [journey("more sensors", n, 500, 3 * n**1.5) for n in (100, 300, 1000)]
    made += [journey("more frames", 100, n, 2 * n**0.5) for n in (1000, 4000)]
    assert slopes(made) == pytest.approx({"more sensors": 1.5, "more frames": 0.5})


def test_readings_are_whole_numbers_of_8_bits():
    readings = readings_of_8_bits(30, 300).readings
    assert readings.max() == 255
    assert readings.min() == 0
    assert (readings == readings.round()).all()


def test_the_parts_of_a_journey_add_up():
    made = travel("some", readings_of_8_bits(30, 600))
    assert made.cpu == pytest.approx(made.faults + made.health + made.map + made.verdict)


def test_neighbours_end_with_the_block():
    with journeys.busy_neighbours(2) as processes:
        assert [process.poll() for process in processes] == [None, None]
    assert all(process.returncode is not None for process in processes)


@pytest.mark.slow
def test_all_journeys_of_small_skins(tmp_path, monkeypatch):
    monkeypatch.setattr(journeys, "FEW_SENSORS", 40)
    monkeypatch.setattr(journeys, "FEW_FRAMES", 600)
    monkeypatch.setattr(journeys, "BUSY_SENSORS", 40)
    monkeypatch.setattr(journeys, "BUSY_FRAMES", 600)
    monkeypatch.setattr(journeys, "RUBBED", ((45, 800),))
    sizes = ["--sensors", "30", "40", "--frames", "300", "600"]
    assert main([*sizes, "-o", str(tmp_path)]) == 0
    with (tmp_path / "journeys.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["journey"] for row in rows} >= {
        "more sensors",
        "more frames",
        "long rubbing",
        "long rubbing, r-anisomap",
        "from the shell",
    }
    assert all(float(row["cpu"]) >= 0 for row in rows)
    table = (tmp_path / "journeys-table.md").read_text(encoding="utf-8")
    assert table.count("exponent") == 2
