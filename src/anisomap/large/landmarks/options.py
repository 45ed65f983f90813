"""What an approximate map may cost."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from anisomap.errors import InputError


@dataclass(frozen=True)
class ApproximateOptions:
    """How much is looked at for an approximate map.

    Parameters
    ----------
    neighbours : int
        Sensors that each sensor is joined to, at least 3: those with the highest r.
    candidates : int
        Sensors that r is worked out with for each, at least as many as `neighbours`.
    sketch : int
        Numbers that the readings of a sensor are projected onto, at least 16. An r of a sketch errs
        by ``sketch ** -0.5`` (one standard deviation).
    landmarks : int
        Sensors from which paths to all others are found, at least 8. Pieces of no more sensors are
        not approximated further: all of their sensors are landmarks.
    seed : int
        Of the projection and of the choice of landmarks: the same seed makes the same map.

    Raises
    ------
    InputError
        If a number is too small.
    """

    neighbours: int = 20
    candidates: int = 48
    sketch: int = 512
    landmarks: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in {
            "neighbours": 3,
            "candidates": self.neighbours,
            "sketch": 16,
            "landmarks": 8,
            "seed": 0,
        }.items():
            if getattr(self, name) < least:
                raise InputError(f"{name} is {getattr(self, name)}; it must be at least {least}")


def loops() -> Any:
    """Import the compiled loops of this room; only the first call takes time."""
    return import_module("anisomap.large.landmarks.kernels")
