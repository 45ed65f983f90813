"""The benchmark of approximate maps measures the loss that it states."""

import numpy as np
import pytest
from benchmarks import approximate
from scipy.spatial.distance import cdist


def test_contacts_cover_what_is_near_them():
    for skin in approximate.SKINS:
        rng = np.random.default_rng(0)
        sensors = skin.spread(100, 100, rng)
        readings = np.concatenate(list(approximate.touch(skin, sensors, 700, rng)))
        assert readings.shape == (700, 100)
        assert readings.dtype == np.uint8
        touched = np.flatnonzero((readings > 0).any(axis=1))
        reach = 2 * approximate.REACH
        one_contact = skin.contacts(100) == 1
        for frame in touched[::50] if one_contact else ():
            on = sensors[readings[frame] > 0]
            assert cdist(on, on).max() < reach


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_a_row_for_each_skin_and_size(capsys):
    approximate.losses([120, 150], 1500, 1)
    table = capsys.readouterr().out.splitlines()
    assert len(table) == 2 + 2 * len(approximate.SKINS)
    for row in table[2:]:
        exact, found, lost = map(float, row.split("|")[3:6])
        assert lost == pytest.approx(exact - found, abs=2e-4)
        assert 0.9 < found <= 1


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_costs_and_real_recordings(capsys, tmp_path):
    approximate.costs([90], 800)
    assert "| 90 x 800 |" in capsys.readouterr().out
    skin = approximate.SKINS[0]
    rng = np.random.default_rng(0)
    places = skin.spread(60, 60, rng)
    readings = np.concatenate(list(approximate.touch(skin, places, 800, rng)))
    np.savez(tmp_path / "skin.npz", readings=readings, positions=places)
    approximate.real_losses(tmp_path)
    assert "| skin | 60 | 0.9" in capsys.readouterr().out
