"""Verdict on the use of a map: level, accuracy at three ranges, and reasons."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from anisomap.base.immutable import Value
from anisomap.base.wording import number
from anisomap.errors import InputError
from anisomap.notes import scaled_note

UNKNOWN = "cannot tell"
"""Level of a map that was not, or cannot be, examined."""

LEVELS: Mapping[str, str] = MappingProxyType(
    {
        "not usable": "positions and neighbours may be wrong",
        "usable for neighbours": "most neighbours are correct; lengths and shape may be wrong",
        "usable": "neighbours, lengths and shape can be used",
    }
)
"""Levels of a verdict from the worst to the best, with their meaning."""

CONTACTS = (COMPACT, ELONGATED) = ("compact", "elongated")
"""What can be stated of contacts: as of a fingertip, a palm or a ball; as of an edge or a roller.

Where sensors are not evenly spaced, long contacts compress a map unnoticed.
"""

FORMER_LEVELS: Mapping[str, str] = MappingProxyType(
    {"usable locally": "usable for neighbours", "unknown": UNKNOWN}
)
"""Levels of maps that anisomap 0.1 wrote."""

RANGES = ("expected_error", "region_error", "neighbours_kept")
ACCURACY = (*(f"{name}{end}" for name in RANGES for end in ("", "_low", "_high")), "repeatability")
"""Names of the numeric fields of a verdict."""


@dataclass(frozen=True, eq=False)
class Verdict(Value):
    """Verdict on a map: a level, the accuracy to expect at three ranges, and the reasons.

    Errors are RMS errors of positions after the best similarity transform, in spacings: medians of
    the distances between nearest neighbours. The interval of the error contains the true error for
    nine of ten usable maps. Numbers describe the largest component; NaN if unknown.

    Parameters
    ----------
    level : str
        A key of `LEVELS`, or ``"cannot tell"``.
    expected_error, expected_error_low, expected_error_high : float
        Error of the map as a whole, at least 0.
    region_error, region_error_low, region_error_high : float
        Error of a region of radius 5 spacings, aligned by itself.
    neighbours_kept, neighbours_kept_low, neighbours_kept_high : float
        Share of the true neighbours that are neighbours on the map, in [0, 1].
    repeatability : float
        RMS difference, in spacings, from the map of another recording of equal kind and length.
    reasons : tuple of str
        Sentences, the worst first.

    Raises
    ------
    InputError
        If there is no such level.
    """

    level: str = UNKNOWN
    expected_error: float = math.nan
    expected_error_low: float = math.nan
    expected_error_high: float = math.nan
    region_error: float = math.nan
    region_error_low: float = math.nan
    region_error_high: float = math.nan
    neighbours_kept: float = math.nan
    neighbours_kept_low: float = math.nan
    neighbours_kept_high: float = math.nan
    repeatability: float = math.nan
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "level", FORMER_LEVELS.get(self.level, self.level))
        if self.level != UNKNOWN and self.level not in LEVELS:
            known = ", ".join((*LEVELS, UNKNOWN))
            raise InputError(f"the level of a verdict must be one of {known}, got {self.level!r}")
        object.__setattr__(self, "reasons", tuple(self.reasons))

    def __str__(self) -> str:
        """Return the level, the expected error and the worst reason, in one line."""
        return "; ".join([self.summary, *self.reasons[:1]])

    @property
    def summary(self) -> str:
        """The level, and the expected error with its interval if it is known, in spacings."""
        return self.headline()

    def headline(self, spacing: float = 1.0, unit: str = "spacings") -> str:
        """Return the level, and how far positions are off, with the interval if it is known.

        Parameters
        ----------
        spacing : float
            Length of a spacing in `unit`.
        unit : str
            Unit of the errors.
        """
        if math.isnan(self.expected_error):
            return self.level
        off = "accurate to" if self.level == "usable" else "off by"
        error = _length(self.expected_error, spacing)
        low, high = self.expected_error_low, self.expected_error_high
        if math.isnan(low):
            return f"{self.level}: positions are {off} about {error} {unit}"
        interval = f"{_length(low, spacing)} to {_length(high, spacing)}"
        return f"{self.level}: positions are {off} about {error} {unit} ({interval})"

    def told(self, spacing: float = 1.0, unit: str = "spacings") -> tuple[str, ...]:
        """Return sentences: what the map can be used for, its accuracy, and the reasons.

        The parameters are those of `headline`.
        """
        meaning = LEVELS.get(self.level, "the accuracy of the map is unknown")
        first = self.headline(spacing, unit)
        reasons = [scaled_note(reason, spacing, unit) for reason in self.reasons]
        told = [first if first != self.level else f"verdict: {first}", meaning, *reasons]
        if not math.isnan(self.region_error):
            error, low, high = (
                _length(one, spacing)
                for one in (self.region_error, self.region_error_low, self.region_error_high)
            )
            region = (
                f"within a radius of 5 spacings, positions are off by about {error} {unit} "
                f"({low} to {high}), and "
            )
            if error == _length(self.expected_error, spacing):
                region = ""
            told.insert(
                2,
                f"{region}{self.neighbours_kept:.0%} of neighbours are correct "
                f"({self.neighbours_kept_low:.0%} to {self.neighbours_kept_high:.0%})",
            )
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


UNJUDGED = Verdict()
"""Verdict on a map that was not examined."""


def _length(error: float, spacing: float) -> str:
    """Word an error in spacings as a length."""
    return f"{error:.2f}" if spacing == 1 else number(error * spacing, 2)
