"""Options that several commands share, each documented once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from cyclopts import Group, Parameter
from cyclopts.validators import Number

outputs_group = Group("Output", sort_key=1)
method_group = Group("Method", sort_key=2)
score_group = Group("Score", sort_key=3)

RecordingFile: TypeAlias = Annotated[Path, Parameter(help="File of a recording.")]

Seed: TypeAlias = Annotated[
    int,
    Parameter(group=score_group, validator=Number(gte=0), help="Seed of everything random."),
]
Permutations: TypeAlias = Annotated[
    int,
    Parameter(
        group=score_group,
        validator=Number(gte=0),
        help="Random labellings that make up the null of Mantel r; 0 leaves it out.",
    ),
]
Exclude: TypeAlias = Annotated[
    list[str] | None,
    Parameter(
        group=score_group,
        negative=(),
        help="Sensor to leave out of the score, but not of the map: name or index; may be "
        "repeated, or hold several between commas.",
    ),
]
Drop: TypeAlias = Annotated[
    list[str] | None,
    Parameter(
        group=method_group,
        negative=(),
        help="Sensor to leave out altogether: name or index; may be repeated, or hold several "
        "between commas.",
    ),
]
Missing: TypeAlias = Annotated[
    Literal["error", "drop-frames", "interpolate"],
    Parameter(
        name="--nan",
        group=method_group,
        help="What to do about readings that are NaN or infinite.",
    ),
]


def sensors(chosen: list[str] | None, names: tuple[str, ...]) -> list[str]:
    """Split what was given for a list of sensors at its commas, unless a name holds the comma."""
    found = []
    for text in chosen or []:
        found += [text] if text in names else [part.strip() for part in text.split(",")]
    return found
