"""Limits of memory: checks that fail before a computation begins."""

from __future__ import annotations

import os

import numpy as np

from anisomap.errors import InputError
from anisomap.numerics.precision import float_type

MATRICES, MATRICES_OF_REFINED = 8, 11
"""Maximum number of (N, N) matrices in memory, for methods without and with refinement.

Peak memory at 20,000 sensors was 7.4 and 10.3 matrices.
"""

_GIB = 1 << 30


def physical_memory() -> int | None:
    """Return the physical memory of the machine in bytes; None if it cannot be determined."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def check_pair_memory(n_sensors: int, *, refined: bool) -> None:
    """Check that the matrices of all pairs of sensors fit into memory."""
    matrices = MATRICES_OF_REFINED if refined else MATRICES
    needed = matrices * n_sensors**2 * np.dtype(float_type(n_sensors)).itemsize
    check_memory(
        needed,
        f"a map of all pairs of {n_sensors} sensors",
        "an approximate map needs far less",
    )


def check_worker_memory(n_sensors: int, n_workers: int) -> None:
    """Check that the unmerged results of parallel workers fit into memory."""
    if n_workers > 1:
        # In float64: two results per worker, and the total, the next result and their sum.
        check_memory(
            8 * (2 * n_workers + 3) * n_sensors**2,
            f"merging the results of {n_workers} workers on the pairs of {n_sensors} sensors",
            "use fewer workers",
        )


def check_memory(needed: float, purpose: str, remedy: str) -> None:
    """Check that a computation fits into memory."""
    available = physical_memory()
    if available is not None and needed > available:
        raise InputError(
            f"{purpose} needs about {needed / _GIB:.1f} GiB of memory, but this machine has "
            f"{available / _GIB:.1f} GiB; {remedy}"
        )
