"""Options of approximate maps."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from anisomap.errors import InputError


@dataclass(frozen=True)
class ApproximateOptions:
    """Accuracy of an approximate map, and its random seed.

    The defaults were chosen on simulated skins; ``docs/explanation/large-recordings.md``
    gives the accuracy.

    Parameters
    ----------
    n_neighbours : int
        Number of sensors with the highest r that each sensor is linked to, at least 3.
    n_candidates : int
        Number of sensors for which r with each sensor is computed, at least `n_neighbours`.
    sketch_size : int
        Length of the random projection of a sensor's readings, at least 16. The standard error of r
        between two sketches is about ``sketch_size ** -0.5``.
    n_landmarks : int
        Number of sensors from which shortest paths to all others are computed, at least 8. In
        connected components that are not larger, all sensors are landmarks.
    seed : int
        Seed of the projection and of the choice of landmarks, at least 0.

    Raises
    ------
    InputError
        If a value is too small.
    """

    n_neighbours: int = 20
    n_candidates: int = 48
    sketch_size: int = 512
    n_landmarks: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in {
            "n_neighbours": 3,
            "n_candidates": self.n_neighbours,
            "sketch_size": 16,
            "n_landmarks": 8,
            "seed": 0,
        }.items():
            if getattr(self, name) < least:
                raise InputError(f"{name} must be at least {least}, got {getattr(self, name)}")


def loops() -> Any:
    """Import the compiled loops of this package on first use."""
    return import_module("anisomap.large.landmarks.landmark_kernels")
