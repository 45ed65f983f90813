"""The benchmark of approximate maps measures the loss that it states."""

import numpy as np
import pytest
from benchmarks.speed import approximate
from scipy.spatial.distance import cdist


@pytest.mark.parametrize("skin", approximate.SKINS, ids=lambda skin: skin.name)
def test_contacts_cover_what_is_near_them(skin):
    rng = np.random.default_rng(0)
    sensors = skin.spread(100, 100, rng)
    readings = np.concatenate(list(approximate.touch(skin, sensors, 700, rng)))
    assert readings.shape == (700, 100)
    assert readings.dtype == np.uint8
    for frame in readings[readings.any(axis=1)][::50] if skin.contacts(100) == 1 else ():
        on = sensors[frame > 0]
        assert cdist(on, on).max() < 2 * approximate.REACH


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_tables(capsys, tmp_path):
    skin, rng = approximate.SKINS[0], np.random.default_rng(0)
    places = skin.spread(60, 60, rng)
    readings = np.concatenate(list(approximate.touch(skin, places, 800, rng)))
    np.savez(tmp_path / "skin.npz", readings=readings, positions=places)
    approximate.losses([80], 600, 1)
    approximate.real_losses(tmp_path)
    approximate.costs([60], 600)
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()]
    first, second, third = (i for i, row in enumerate(rows) if set(row) == {" --- "})
    assert second - first == 2 + len(approximate.SKINS)
    assert rows[third + 1][1].strip() == "60 x 600"
    for row in (*rows[first + 1 : second - 1], *rows[second + 1 : third - 1]):
        exact, found, lost = map(float, row[2:5])
        assert lost == pytest.approx(exact - found, abs=2e-4)
        assert exact > 0.9
        assert 0.5 < found <= 1
