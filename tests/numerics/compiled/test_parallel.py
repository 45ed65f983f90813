"""Threads of loops and of BLAS."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from anisomap.numerics.compiled.parallel import MIN_PARALLEL_ROWS, limited_blas


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
