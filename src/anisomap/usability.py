"""How far a map can be used: the verdict, its expected error, and the reasons."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from anisomap.errors import InputError

UNKNOWN = "unknown"
"""Level of a map that was not examined, or cannot be."""

LEVELS: Mapping[str, str] = MappingProxyType(
    {
        "not usable": "positions and neighbourhoods may be wrong",
        "usable locally": "neighbours are right, but the shape as a whole is doubtful",
        "usable": "positions are right up to the expected error",
    }
)
"""Levels of a verdict from the worst to the best, with their meaning."""

ERRORS = ("expected_error", "repeatability", "systematic")
"""Names of the errors of a verdict."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on a map: a level, the error to expect, and the reasons.

    Errors are RMS errors of the positions of the largest component after the best similarity
    transform, in spacings: medians of the distances between nearest neighbours.

    Parameters
    ----------
    level : str
        A key of `LEVELS`, or ``"unknown"``.
    expected_error : float
        Error to expect, at least 0; NaN if unknown.
    repeatability : float
        Part of the expected error that chance explains: the RMS difference that another recording
        of the same kind and length makes. NaN if unknown.
    systematic : float
        Part of the expected error that every map of the recording shares. NaN if unknown.
    reasons : tuple of str
        Sentences, the worst first.

    Raises
    ------
    InputError
        If there is no such level.
    """

    level: str = UNKNOWN
    expected_error: float = math.nan
    repeatability: float = math.nan
    systematic: float = math.nan
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.level != UNKNOWN and self.level not in LEVELS:
            known = ", ".join((*LEVELS, UNKNOWN))
            raise InputError(f"the level of a verdict must be one of {known}, got {self.level!r}")
        object.__setattr__(self, "reasons", tuple(self.reasons))

    def __str__(self) -> str:
        """Return the level, the expected error and the worst reason, in one line."""
        return f"{self.summary}: {self.reasons[0]}" if self.reasons else self.summary

    @property
    def summary(self) -> str:
        """The level, and the expected error if it is known."""
        if math.isnan(self.expected_error):
            return self.level
        return f"{self.level}, expected error {self.expected_error:.2f} spacings"

    @property
    def sentences(self) -> tuple[str, ...]:
        """How far the map can be used, what that means, and the reasons: one sentence each."""
        meaning = LEVELS.get(self.level, "the map was not judged")
        told = (f"verdict: {self.summary}", meaning, *self.reasons)
        return tuple(f"{text[:1].upper()}{text[1:]}." for text in told)

    def is_at_least(self, level: str) -> bool:
        """Return whether a level of `LEVELS` is reached; an unknown verdict reaches none.

        Raises
        ------
        InputError
            If there is no such level.
        """
        ranks = list(LEVELS)
        if level not in ranks:
            raise InputError(f"a level must be one of {', '.join(ranks)}, got {level!r}")
        return self.level in ranks and ranks.index(self.level) >= ranks.index(level)
