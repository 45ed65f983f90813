"""What does not fit into memory is refused before it is begun."""

import os

import numpy as np
import pytest

from anisomap import memory, reconstruct
from anisomap.errors import InputError
from anisomap.large.chunked_similarity import CHUNKED
from anisomap.large.map_reduce import WorkerPool
from anisomap.large.streaming import reconstruct_chunks
from anisomap.memory import check_pair_memory, physical_memory
from anisomap.numerics.similarity.value_counts import ValueCounts


@pytest.fixture
def small_machine(monkeypatch):
    monkeypatch.setattr(memory, "physical_memory", lambda: 100_000)


def test_there_is_memory():
    assert physical_memory() > 1 << 26


def test_where_it_cannot_be_asked_nothing_is_refused(monkeypatch):
    monkeypatch.delattr(os, "sysconf")
    assert physical_memory() is None
    check_pair_memory(10**9, refined=True)


def test_as_many_sensors_as_a_common_machine_has_room_for(monkeypatch):
    monkeypatch.setattr(memory, "physical_memory", lambda: 24 << 30)
    for refined in (False, True):
        check_pair_memory(20_000, refined=refined)
    with pytest.raises(
        InputError, match=r"100000 sensors .* takes about 298 GiB .* has 24; .*appr"
    ):
        check_pair_memory(100_000, refined=False)


def test_maps_say_so_before_they_are_begun(small_machine):
    readings = np.random.default_rng(0).uniform(size=(50, 60))
    with pytest.raises(InputError, match="60 sensors"):
        reconstruct_chunks(readings, "r-anisomap")
    with pytest.raises(InputError, match="60 sensors"):
        reconstruct(similarity=np.corrcoef(readings.T))


def test_workers_say_so_that_would_hold_too_much_at_once(monkeypatch):
    readings = np.random.default_rng(0).uniform(size=(50, 60))
    monkeypatch.setattr(memory, "physical_memory", lambda: 11 * 8 * 60**2)
    with pytest.raises(InputError, match=r"5 workers .* 60 sensors .* use fewer workers"):
        reconstruct_chunks(readings, "covariogram", pool=WorkerPool(5))


def test_counts_of_all_bins_say_so(small_machine):
    values = ValueCounts.of(np.random.default_rng(0).integers(0, 9, (20_000, 30)))
    prepare = CHUNKED["mutual-information"].prepare
    with pytest.raises(InputError, match="8 bins of 30 sensors"):
        prepare(values, 8)
    prepare(values, 2)
