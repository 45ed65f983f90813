"""Compilation of loops with and without a cache on disk."""

import types

import numpy as np

from anisomap.numerics.compiled.parallel import loop

SOURCE = """
def double(values):
    for i in range(len(values)):
        values[i] *= 2
"""


def uncacheable_function():
    """Return a function without a source file, next to which numba could store a cache."""
    code = compile(SOURCE, "<no file>", "exec").co_consts[0]
    return types.FunctionType(code, {"__name__": "nowhere"}, "double")


def test_loops_compile_without_a_cache_folder():
    values = np.arange(3.0)
    loop()(uncacheable_function())(values)
    np.testing.assert_array_equal(values, [0, 2, 4])
