"""Options that several commands share, each documented once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from cyclopts import Group, Parameter
from cyclopts.validators import Number

from anisomap import io
from anisomap.errors import InputError
from anisomap.io import ReadOptions
from anisomap.placement import METRES, mirrored, parse_length, scaled_to_spacing
from anisomap.sensor_map import SensorMap

reading_group = Group("Reading", sort_key=0)
outputs_group = Group("Output", sort_key=1)
method_group = Group("Method", sort_key=2)
score_group = Group("Score", sort_key=3)


@dataclass(frozen=True)
class ReadingOptions:
    """What a reader cannot find out by itself.

    Parameters
    ----------
    select
        Which of several recordings in a file: a topic (with its field: /skin:data), a dataset, a
        column, a port; see what there is with anisomap info. Topics and ports may be several,
        between commas.
    grid
        Rows and columns of a rectangular array, as in 32x64, row after row: gives true positions.
    msg
        Message definition (.msg) of a bag that holds none; may be repeated.
    preset
        Robot whose numbering of sensors is known: icub, icub-hand.
    """

    select: Annotated[str, Parameter(name=("--select", "--topic", "--dataset", "--field"))] = ""
    grid: str = ""
    msg: Annotated[list[Path], Parameter(negative=())] = field(default_factory=list)
    preset: str = ""

    def checked(self) -> ReadOptions:
        """Give them in the words of the library."""
        grid = _rows_and_columns(self.grid) if self.grid else None
        return ReadOptions(self.select, grid, tuple(self.msg), self.preset)


AS_IT_COMES = ReadingOptions()


@dataclass(frozen=True)
class PlacingOptions:
    """What is known of a map beyond its readings.

    Parameters
    ----------
    spacing
        Give the map a scale: how far apart neighbouring sensors are (median), such as 6.5mm. What
        robots' software reads is in metres, and needs it.
    mirror
        Write the mirror image: a map does not know left from right.
    frame
        Name of the frame that the sensors are in.
    """

    spacing: str = ""
    mirror: Annotated[bool, Parameter(negative=())] = False
    frame: str = ""

    def check(self, outputs: Iterable[Path], units: str = "") -> None:
        """Find out before the work what could not be written.

        Raises
        ------
        InputError
            If the spacing is no length, or a file needs a scale and there is none.
        """
        if self.spacing:
            parse_length(self.spacing)
            return
        for path in outputs:
            if io.needs_scale(path) and units not in METRES:
                raise InputError(
                    f"{path} is in metres, but the map will have no scale; say how far apart "
                    "neighbouring sensors are, such as --spacing 6.5mm"
                )

    def applied(self, sensor_map: SensorMap) -> SensorMap:
        """Place a map as was asked for."""
        if self.mirror:
            sensor_map = mirrored(sensor_map)
        if self.spacing:
            sensor_map = scaled_to_spacing(sensor_map, *parse_length(self.spacing))
        if self.frame:
            sensor_map = replace(sensor_map, frame=self.frame)
        return sensor_map


AS_IT_IS = PlacingOptions()


def _rows_and_columns(text: str) -> tuple[int, int]:
    sizes = [int(size) for size in text.lower().split("x") if size.strip().isdecimal()]
    if len(sizes) != 2 or not all(sizes):
        raise InputError(
            f"--grid {text} is no size of an array; give rows and columns, as in 32x64"
        )
    return sizes[0], sizes[1]


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
        group=method_group,
        help="How to handle readings that are NaN or infinite.",
    ),
]


Placing: TypeAlias = Annotated[PlacingOptions, Parameter(name="*", group=outputs_group)]
Reading: TypeAlias = Annotated[ReadingOptions, Parameter(name="*", group=reading_group)]


def sensors(chosen: list[str] | None, names: tuple[str, ...]) -> list[str]:
    """Split what was given for a list of sensors at its commas, unless a name holds the comma."""
    found = []
    for text in chosen or []:
        found += [text] if text in names else [part.strip() for part in text.split(",")]
    return found
