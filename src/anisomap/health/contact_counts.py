"""Numbers of separate contacts of sensors, and of pairs of sensors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def count_contacts(active: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of each sensor: runs of frames in which it is active.

    Parameters
    ----------
    active : array_like of bool, shape (T, N)
        See `anisomap.numerics.similarity.rest.Rest.active`.

    Returns
    -------
    ndarray of int, shape (N,)
    """
    on = np.asarray(active, dtype=bool)
    return np.asarray(on[:1].sum(axis=0) + np.count_nonzero(on[1:] > on[:-1], axis=0))


def count_joint_contacts(active: ArrayLike, pairs: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of pairs of sensors: runs of frames in which both are active.

    Parameters
    ----------
    active : array_like of bool, shape (T, N)
    pairs : array_like of int, shape (P, 2)

    Returns
    -------
    ndarray of int, shape (P,)
    """
    on = np.ascontiguousarray(np.asarray(active, dtype=bool).T)
    chosen = np.asarray(pairs, dtype=np.intp)
    return np.array([count_runs(on[i] & on[j]) for i, j in chosen], dtype=np.intp)


def count_runs(on: NDArray[np.bool_]) -> int:
    """Count runs of True of a series of shape (T,)."""
    return int(np.count_nonzero(on[1:] > on[:-1])) + int(on[:1].sum())
