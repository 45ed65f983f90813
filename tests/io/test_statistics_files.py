"""Statistics beside a map: round trips, and damage."""

import numpy as np
import pytest

from anisomap import Recording, io
from anisomap.errors import FileError
from anisomap.method.options import MethodOptions
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.tracking import gather_evidence
from skins import lattice, rubbed


@pytest.fixture(scope="module")
def evidence():
    readings = (rubbed(lattice(3, 4), 200, seed=1) > 0.4).astype(float)
    parts = [
        Recording(readings[:100], names=tuple(f"ä{i}" for i in range(12))),
        Recording(readings[100:, :8], names=tuple(f"ä{i}" for i in range(8))),
    ]
    options = MethodOptions(regularisation=0.5, n_neighbours=4, smacof=SmacofOptions(1e-5, 77))
    return gather_evidence(parts, dimensions=2, options=options)


def test_everything_is_read_back_equal(evidence, tmp_path):
    file = tmp_path / "skin.statistics.npz"
    io.write_statistics(evidence, file)
    found = io.read_statistics(file)
    for name in ("names", "method", "dimensions", "options", "n_frames", "recordings"):
        assert getattr(found, name) == getattr(evidence, name)
    assert found.single_contacts == evidence.single_contacts
    assert set(found.sums) == set(evidence.sums)
    for key, sums in evidence.sums.items():
        for field, values in vars(sums).items():
            np.testing.assert_array_equal(getattr(found.sums[key], field), values)


def test_the_file_is_named_after_the_map():
    assert io.statistics_beside("a/skin.map.csv").name == "skin.map.statistics.npz"
    assert io.statistics_beside("skin.npz").name == "skin.statistics.npz"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "something else"}, "another version"),
        ({"method": "magic"}, "magic"),
        ({"dimensions": -1}, "dimensions"),
        ({"options": '{"regularisation": -1}'}, "regularisation"),
        ({"options": '{"colour": 1}'}, "colour"),
        ({"options": '{"smacof.colour": 1}'}, "colour"),
        ({"blended-correlation.squares": np.full((12, 12), -1.0)}, "no recording gives"),
        ({"blended-correlation.products": np.ones(5)}, "shape"),
        ({"blended-correlation.weights": np.full(78, np.nan)}, "no recording gives"),
    ],
)
def test_values_that_cannot_be_are_refused(evidence, tmp_path, change, message):
    file = tmp_path / "skin.statistics.npz"
    io.write_statistics(evidence, file)
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive}
    np.savez(file, **{**arrays, **change})
    with pytest.raises(FileError, match=message):
        io.read_statistics(file)


def test_a_map_is_no_file_of_statistics(tmp_path, sensor_map):
    io.write(sensor_map, tmp_path / "map.npz")
    with pytest.raises(FileError, match="no statistics of a map"):
        io.read_statistics(tmp_path / "map.npz")
    with pytest.raises(FileError, match="absent"):
        io.read_statistics(tmp_path / "absent.statistics.npz")
