"""Compiled loops where nothing can be kept on disk."""

import numpy as np
from numba.core import caching

from anisomap.numerics.compiled.jit import loop


def double(values):
    for i in range(len(values)):
        values[i] *= 2


def test_without_a_folder_to_keep_code_in_loops_are_compiled_all_the_same(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    values = np.arange(3.0)
    loop()(double)(values)
    np.testing.assert_array_equal(values, [0, 2, 4])


def test_flags_are_handed_on():
    fast = loop(fastmath=True)(double)
    assert fast.targetoptions["fastmath"]
    assert fast.targetoptions["nogil"]
