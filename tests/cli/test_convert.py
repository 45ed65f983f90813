"""``anisomap convert``: maps for robot software."""

import numpy as np
import pytest

import anisomap
from anisomap.placement import median_spacing


def test_maps_are_converted_to_robot_formats_in_metres(run, made, tmp_path):
    outcome = run(
        "convert", made / "map.csv", "skin.urdf", "--spacing", "6.5mm", "--frame", "l_forearm"
    )
    assert outcome.code == 0, outcome.err
    assert "6.5 mm" in outcome.out
    assert 'name="l_forearm"' in (tmp_path / "skin.urdf").read_text()
    found, before = anisomap.read_map("skin.urdf"), anisomap.read_map(made / "map.csv")
    assert median_spacing(found) == pytest.approx(0.0065)
    assert anisomap.mantel(found, before.positions, permutations=0).r == pytest.approx(1)


def test_a_map_is_made_in_millimetres_and_mirrored_at_once(run_map, skin_npz):
    arguments = (skin_npz, "-d", "2", "--spacing", "6.5mm")
    assert run_map(*arguments, "-o", "one.json", "-o", "one.icub.txt").code == 0
    assert run_map(*arguments, "-o", "two.json", "--mirror").code == 0
    one, two = (anisomap.read_map(f"{name}.json") for name in ("one", "two"))
    assert one.units == "mm"
    assert median_spacing(one) == pytest.approx(6.5)
    np.testing.assert_allclose(two.positions, one.positions * [-1, 1])
    assert two.mirrored is True
    assert anisomap.read_map("one.icub.txt").units == "m"
