"""``anisomap convert``: maps for robot software."""

import numpy as np
import pytest

import anisomap
from anisomap.placement import median_spacing


@pytest.fixture
def map_csv(flat_map, tmp_path):
    anisomap.write(flat_map, tmp_path / "map.csv")
    return tmp_path / "map.csv"


def test_maps_are_converted_to_robot_formats_in_metres(run, map_csv, tmp_path):
    outcome = run("convert", map_csv, "skin.urdf", "--spacing", "6.5mm", "--frame", "l_forearm")
    assert outcome.code == 0, outcome.err
    assert "6.5 mm" in outcome.out
    assert 'name="l_forearm"' in (tmp_path / "skin.urdf").read_text()
    found = anisomap.read_map(tmp_path / "skin.urdf")
    assert median_spacing(found) == pytest.approx(0.0065)
    before = anisomap.read_map(map_csv)
    assert anisomap.mantel(found, before.positions, permutations=0).r == pytest.approx(1)


def test_a_map_is_made_in_millimetres_and_mirrored_at_once(run, skin_npz, tmp_path):
    arguments = ("map", skin_npz, "-d", "2", "--permutations", "0", "--spacing", "6.5mm")
    assert run(*arguments, "-o", "one.json", "-o", "one.icub.txt").code == 0
    assert run(*arguments, "-o", "two.json", "--mirror").code == 0
    one, two = (anisomap.read_map(tmp_path / f"{name}.json") for name in ("one", "two"))
    assert one.units == "mm"
    assert median_spacing(one) == pytest.approx(6.5)
    np.testing.assert_allclose(two.positions, one.positions * [-1, 1])
    assert two.mirrored is True
    assert anisomap.read_map(tmp_path / "one.icub.txt").units == "m"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["skin.urdf"], "format is in metres, but the map has no scale"),
        (["skin.urdf", "--spacing", "6.5"], "'6.5' is not a length"),
        (["skin.xyz"], "unknown suffix '.xyz'"),
        (["map.csv"], "write the result to another file"),
        (["nowhere/skin.urdf", "--spacing", "6.5mm"], "nowhere"),
    ],
)
def test_invalid_conversions_are_refused_with_one_message(
    run, map_csv, tmp_path, arguments, message
):
    before = sorted(tmp_path.iterdir())
    outcome = run("convert", map_csv, *arguments)
    assert outcome.code == 2
    assert message in " ".join(outcome.err.split())
    assert sorted(tmp_path.iterdir()) == before


def test_a_missing_scale_is_reported_before_the_computation(run, skin_npz, tmp_path):
    outcome = run("map", skin_npz, "-o", "skin.mjcf")
    assert outcome.code == 2
    assert "--spacing 6.5mm" in outcome.err
    assert "Stress-1" not in outcome.out


@pytest.mark.parametrize("spacing", ["1e-300m", "1e300m", "1e-160mm", "5e-324m"])
def test_spacings_out_of_range_are_refused_before_writing(run, map_csv, tmp_path, spacing):
    for output in ("skin.csv", "skin.urdf"):
        outcome = run("convert", map_csv, output, "--spacing", spacing)
        assert outcome.code == 2
        assert "out of the range of floating-point numbers" in outcome.err
        assert not (tmp_path / output).exists()


def test_a_single_sensor_is_converted(run, tmp_path):
    anisomap.write(anisomap.SensorMap(np.ones((1, 3)), units="m"), tmp_path / "one.csv")
    assert run("convert", "one.csv", "one.json").code == 0
