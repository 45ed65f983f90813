"""Landmark MDS: landmarks are scaled, and all others placed by their distances from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROWS = 4096
"""Sensors that are placed at a time."""


def triangulate(rows: NDArray[np.float32], landmarks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place sensors by their distances from landmarks.

    Parameters
    ----------
    rows : ndarray of shape (N, L)
        Distance of each sensor from each landmark.
    landmarks : ndarray of shape (L, k)
        Where these are.

    Returns
    -------
    ndarray of shape (N, k)
        In the frame of the landmarks. Where distances are those of points in k dimensions, and the
        landmarks do not lie in fewer, that is where they are.

    Notes
    -----
    De Silva & Tenenbaum (2004), "Sparse multidimensional scaling using landmark points", section
    3.2: ``y = -1/2 X^+ (d^2 - |x|^2)`` with centred landmarks X. Squared distances d^2 = |x|^2 -
    2 x y + |y|^2 are linear in y but for |y|^2, which is the same for all landmarks and so drops
    out.
    """
    middle = landmarks.mean(axis=0)
    centred = landmarks - middle
    inverse = np.linalg.pinv(centred, rcond=1e-7)
    squares = (centred**2).sum(axis=1)
    placed = np.empty((len(rows), landmarks.shape[1]))
    for begin in range(0, len(rows), ROWS):
        part = rows[begin : begin + ROWS].astype(np.float64)
        placed[begin : begin + ROWS] = (squares - part**2) @ inverse.T / 2
    return np.asarray(placed + middle)
