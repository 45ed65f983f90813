"""Computations that do not fit into memory are refused before they start."""

import numpy as np
import pytest

from anisomap import MethodOptions, reconstruct, reconstruct_from
from anisomap.errors import InputError
from anisomap.numerics.precision import check_pair_memory


def test_20000_sensors_fit_into_24_gib_and_100000_do_not(machine_with):
    machine_with(24 << 30)
    for refined in (False, True):
        check_pair_memory(20_000, refined=refined)
    with pytest.raises(
        InputError, match=r"100000 sensors needs about 298.0 GiB .* has 24.0 GiB; map fewer"
    ):
        check_pair_memory(100_000, refined=False)


def test_maps_too_large_for_memory_are_refused(machine_with):
    machine_with(100_000)
    readings = np.random.default_rng(0).uniform(size=(50, 60))
    with pytest.raises(InputError, match="60 sensors"):
        reconstruct(readings, "r-anisomap")
    with pytest.raises(InputError, match="60 sensors"):
        reconstruct_from(similarity=np.corrcoef(readings.T))


def test_counts_too_large_for_memory_are_refused(machine_with):
    array = pytest.importorskip("dask.array", reason="needs the extra 'cluster'")
    readings = array.from_array(np.random.default_rng(0).integers(0, 9, (20_000, 30)))
    machine_with(100_000)
    with pytest.raises(InputError, match="8 bins of 30 sensors"):
        reconstruct(readings, "i-anisomap", 2, options=MethodOptions(entropy_bins=8))
