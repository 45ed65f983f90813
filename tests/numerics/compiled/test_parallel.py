"""Compilation of loops, and threads of loops and of BLAS."""

import subprocess
import sys
import types

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from anisomap.numerics.compiled.parallel import MIN_PARALLEL_ROWS, limited_blas, loop


@pytest.mark.parametrize(("n_rows", "expected"), [(10, 1), (MIN_PARALLEL_ROWS, 2)])
def test_blas_is_limited_for_small_matrices_and_restored(n_rows, expected):
    def threads():
        return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("this BLAS does not take two threads")
        with limited_blas(n_rows):
            assert threads() == {expected}
        assert threads() == {2}


def test_blas_that_scipy_loads_after_the_first_limit_is_limited():
    # Another thread may limit BLAS while scipy.linalg is being imported.
    program = """if True:
        import sys
        from threadpoolctl import threadpool_info, threadpool_limits
        from anisomap.numerics.compiled.parallel import limited_blas

        class LimitDuringImport:
            calls = 0

            def find_spec(self, name, path=None, target=None):
                if name.startswith("scipy.linalg.") and not self.calls:
                    self.calls += 1
                    with limited_blas(10):
                        pass

        finder = LimitDuringImport()
        sys.meta_path.insert(0, finder)
        import scipy.linalg
        assert finder.calls
        with threadpool_limits(2, user_api="blas"), limited_blas(10):
            assert {b["num_threads"] for b in threadpool_info() if b["user_api"] == "blas"} == {1}
    """
    subprocess.run([sys.executable, "-c", program], check=True)


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
