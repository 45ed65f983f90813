"""Small skins whose truth is known, made without a physics engine: fast, and exact to describe."""

import numpy as np
from numpy.typing import NDArray

from anisomap import Recording


def lattice(rows: int = 6, columns: int = 7) -> NDArray[np.float64]:
    """Positions of a flat triangular lattice with spacing 1, shape (rows * columns, 2)."""
    x, y = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    x[1::2] += 0.5
    return np.column_stack([x.ravel(), y.ravel() * 3**0.5 / 2])


def rubbed(
    positions: NDArray[np.float64], n_frames: int = 1500, *, seed: int = 0, reach: float = 2.0
) -> NDArray[np.float64]:
    """Readings of sensors over which one contact wanders; zero out of its reach."""
    rng = np.random.default_rng(seed)
    low, high = positions.min(axis=0) - reach / 2, positions.max(axis=0) + reach / 2
    # Fold a random walk back into the box: the contact keeps moving and visits everything alike.
    walk = np.cumsum(rng.normal(0, 0.6, (n_frames, positions.shape[1])), axis=0)
    touch = low + np.abs(
        (walk + rng.uniform(0, 50, positions.shape[1])) % (2 * (high - low)) - (high - low)
    )
    distances = np.linalg.norm(touch[:, None] - positions, axis=2)
    pressure = rng.uniform(0.6, 1.4, (n_frames, 1))
    return np.maximum(0, reach - distances) * pressure


def flat_skin(*, seed: int = 0, n_frames: int = 1500) -> Recording:
    """A rubbed flat skin of 42 sensors that knows where they are."""
    positions = lattice()
    return Recording(
        rubbed(positions, n_frames, seed=seed), positions=positions, units="mm", rate_hz=50
    )


def seeing_patch(*, seed: int = 0, n_frames: int = 1500) -> Recording:
    """Pixels of a flat patch that sees smooth random images: dense, continuous, all alike."""
    positions = lattice()
    squares = ((positions[:, None] - positions) ** 2).sum(axis=2)
    smooth = np.linalg.cholesky(np.exp(-squares / 8) + 1e-6 * np.eye(len(positions)))
    images = np.random.default_rng(seed).normal(size=(n_frames, len(positions))) @ smooth.T
    return Recording(images, positions=positions, units="pixels")
