"""Whether what is to be done fits into the machine's memory: better a plain word than no answer."""

from __future__ import annotations

import os

import numpy as np

from anisomap.errors import InputError
from anisomap.numerics.precision import float_type

MATRICES, MATRICES_OF_REFINED = 8, 11
"""Matrices of all pairs that making a map takes at once: if it is only scaled, and if refined.

Of 20,000 sensors, 7.4 and 10.3 were measured.
"""

_GIB = 1 << 30


def physical_memory() -> int | None:
    """Give the machine's memory in bytes; None where it cannot be asked."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def check_pair_memory(n_sensors: int, *, refined: bool) -> None:
    """Check that there is room for all pairs of so many sensors.

    Parameters
    ----------
    n_sensors : int
    refined : bool
        Whether the map is refined once it has been scaled.

    Raises
    ------
    InputError
        If a map of them would take more memory than the machine has.
    """
    matrices = MATRICES_OF_REFINED if refined else MATRICES
    needed = matrices * n_sensors**2 * np.dtype(float_type(n_sensors)).itemsize
    check_memory(
        needed,
        f"{n_sensors} sensors have so many pairs that a map of them",
        "an approximate one takes far less (reconstruct_approximately, --approximate)",
    )


def check_worker_memory(n_sensors: int, workers: int) -> None:
    """Check that there is room for what several workers make of pairs before it is merged.

    Parameters
    ----------
    n_sensors : int
    workers : int

    Raises
    ------
    InputError
        If that would take more memory than the machine has.
    """
    if workers > 1:
        # Two parts a worker, and merging: a total, another, and both together; in float64.
        check_memory(
            8 * (2 * workers + 3) * n_sensors**2,
            f"what {workers} workers make of the pairs of {n_sensors} sensors",
            "use fewer workers",
        )


def check_memory(needed: float, what: str, instead: str) -> None:
    """Check that something fits into memory.

    Parameters
    ----------
    needed : float
        Bytes.
    what : str
        What takes them: the beginning of a sentence.
    instead : str
        What would take less: its end.

    Raises
    ------
    InputError
        If the machine has less.
    """
    there = physical_memory()
    if there is not None and needed > there:
        raise InputError(
            f"{what} takes about {needed / _GIB:.0f} GiB of memory, and this machine has "
            f"{there / _GIB:.0f}; {instead}"
        )
