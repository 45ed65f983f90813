"""Options that several commands share.

The library is imported when a command runs, so that help pages and errors of options take .2 s:
`io`, `placement` and `drawing` import their contents on first use.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from cyclopts import Group, Parameter, Token
from cyclopts.validators import Number

import anisomap
from anisomap import io, placement
from anisomap.base import METRES
from anisomap.cli.console import Printer, print_warning
from anisomap.errors import FileError, InputError

_GRID = re.compile(r"\s*+(\d{1,9})\s*+[xX]\s*+(\d{1,9})\s*+")

reading_group = Group("Reading", sort_key=0)
outputs_group = Group("Output", sort_key=1)
method_group = Group("Method", sort_key=2)
expert_group = Group("Rarely needed", sort_key=9)
expert = Parameter(group=expert_group)


Count: TypeAlias = Annotated[int, Parameter(validator=Number(gte=1))]
Amount: TypeAlias = Annotated[int, Parameter(validator=Number(gte=0))]


@Parameter(name="*", group=reading_group)
@dataclass(frozen=True)
class ReadingOptions:
    """Options of readers.

    Parameters
    ----------
    select
        Recording to read, if the file contains several. Give a topic (optionally with a field, as
        in /skin:data), a dataset or a port; separate several topics or ports by commas.
        `anisomap info` lists what the file contains.
    positions
        File of true positions, to score maps. Sensors are matched by name, or by the number in
        their names.
    grid
        Rows and columns of an array, such as 32x64. Sensors must be numbered row by row; their true
        positions are then known.
    preset
        Robot whose numbering of sensors is known: icub or icub-hand.
    keep
        Columns that are sensors: names, indices, ranges (c0-c35) or patterns ('c*_z'), separated by
        commas; may be repeated. Default: all columns that are not recognised as something else.
    axis
        Axis to read from taxels with three axes: z, x, y, norm (the distance of the reading from
        its value at rest), or all (each axis becomes a sensor).
    msg
        Message definition (.msg), if the bag does not contain it; may be repeated.
    """

    select: Annotated[str, Parameter(name=("--select", "--topic"))] = ""
    positions: Path | None = None
    grid: Annotated[str, expert] = ""
    preset: Annotated[str, expert] = ""
    keep: Annotated[list[str], expert] = field(default_factory=list)
    axis: Annotated[Literal["z", "norm", "x", "y", "all"], expert] = "z"
    msg: Annotated[list[Path], expert] = field(default_factory=list)

    @property
    def inputs(self) -> list[Path]:
        """Files that are read in addition to the recording; outputs must not overwrite them."""
        return [*self.msg, *([self.positions] if self.positions else [])]

    def checked(self) -> io.ReadOptions:
        """Convert to the options of the library."""
        grid = rows_and_columns(self.grid) if self.grid else None
        return io.ReadOptions(
            self.select,
            grid,
            tuple(self.msg),
            self.preset,
            self.positions,
            self.axis,
            tuple(part.strip() for text in self.keep for part in text.split(",")),
        )


DEFAULT_READING = ReadingOptions()

PRINTER = Printer()
"""Placeholder for the printer of a command, which `app` creates."""


_GIVE_SPACING = (
    "give the median distance to the nearest sensor, such as --spacing 6.5mm, or find the scale by "
    "anisomap place --module-layout"
)


@Parameter(name="*", group=outputs_group)
@dataclass(frozen=True)
class PlacingOptions:
    """Scale, handedness and frame of a map.

    Parameters
    ----------
    spacing
        Median distance to the nearest sensor, such as 6.5mm. It gives the map a scale, which
        formats of robot software require; errors are then in millimetres. If the spacing is
        unknown, `anisomap place --module-layout` finds the scale.
    mirror
        Reflect the map, if its handedness is wrong. Readings do not determine the handedness.
    frame
        Name of the coordinate frame to write in the map.
    """

    spacing: str = ""
    mirror: bool = False
    frame: str = ""

    def check(self, outputs: Iterable[Path], units: str = "", *, hint: str = _GIVE_SPACING) -> None:
        """Check, before the map is computed, that the outputs can be written."""
        if self.spacing:
            doubt_spacing(self.spacing)
            return
        for path in outputs:
            if io.needs_scale(path) and units not in METRES:
                raise InputError(
                    f"cannot write {path}: its format is in metres, but the map has no scale; "
                    f"{hint}"
                )

    def applied(self, sensor_map: anisomap.SensorMap) -> anisomap.SensorMap:
        """Apply the options to a map."""
        if self.mirror:
            sensor_map = placement.mirrored(sensor_map)
        if self.spacing:
            length = placement.parse_length(self.spacing)
            sensor_map = placement.scaled_to_spacing(sensor_map, *length)
        if self.frame:
            sensor_map = replace(sensor_map, frame=self.frame)
        return sensor_map


DEFAULT_PLACING = PlacingOptions()


@Parameter(name="*", group=Group("Modules", sort_key=3))
@dataclass(frozen=True)
class ModuleOptions:
    """Rigid modules.

    Parameters
    ----------
    module_layout
        File of the pads of one module: columns x [mm], y [mm].
    module_size
        Pads per module, including missing pads. The number at the end of a sensor's name determines
        its module. Numbers begin at 0 or at 1, whichever gives fewer modules.
    module_table
        Table of modules, instead of --module-size. The columns are sensor, module and, optionally,
        pad.
    """

    module_layout: Path | None = None
    module_size: Annotated[int | None, Parameter(validator=Number(gte=2))] = None
    module_table: Path | None = None

    def __post_init__(self) -> None:
        if self.module_table and self.module_size:
            raise InputError("give the modules by --module-table or by --module-size, not by both")

    @property
    def files(self) -> list[Path | None]:
        """Files to read."""
        return [self.module_layout, self.module_table]

    @property
    def given(self) -> bool:
        """Whether an option of modules is given."""
        return bool(self.module_layout or self.divided)

    @property
    def divided(self) -> bool:
        """Whether the modules of the sensors are known."""
        return bool(self.module_table or self.module_size)

    def listed(self, names: Sequence[str]) -> placement.Modules | None:
        """Read the table of modules, if it is given."""
        return None if self.module_table is None else io.read_modules(self.module_table, names)

    def with_layout(self, modules: placement.Modules) -> placement.Modules:
        """Add the positions of the pads, if they are given."""
        if self.module_layout is None:
            return modules
        return modules.with_template(io.read_map(self.module_layout))


DEFAULT_MODULES = ModuleOptions()


_SMALLEST, _LARGEST = 1e-4, 0.5  # metres; no skin has smaller or larger spacings


def doubt_spacing(text: str) -> None:
    """Warn of an implausible spacing of sensors."""
    value, unit = placement.parse_length(text)
    if not _SMALLEST <= value * METRES[unit] <= _LARGEST:
        print_warning(
            f"a spacing of {text} is unlikely: sensors of skins are between "
            f"{_SMALLEST * 1e3:g} mm and {_LARGEST:g} m apart; check its unit"
        )


def rows_and_columns(text: str) -> tuple[int, int]:
    """Return the numbers of ``"32x64"``."""
    match = _GRID.fullmatch(text)
    if not match:
        raise InputError(f"--grid must give rows and columns, as in 32x64, got {text}")
    return int(match[1]), int(match[2])


def _exists(_: object, given: Path | Sequence[Path]) -> None:
    """Raise FileError for a file that does not exist, before the library is imported."""
    for path in [given] if isinstance(given, Path) else given:
        if not path.exists():
            raise FileError(f"there is no file {path}")


existing = Parameter(validator=_exists)
RecordingFile: TypeAlias = Annotated[Path, Parameter(help="File of a recording."), existing]
MapFile: TypeAlias = Annotated[Path, Parameter(help="File of a map."), existing]


Quality: TypeAlias = Literal["usable", "usable-for-neighbours"]
"""Levels of a verdict that can be required."""

Output: TypeAlias = Annotated[list[Path] | None, Parameter(alias="-o", group=outputs_group)]
Picture: TypeAlias = Annotated[
    Path | None, Parameter(group=outputs_group, help="Figure to write: .png, .svg or .pdf.")
]
Report: TypeAlias = Annotated[
    Path | None,
    Parameter(group=outputs_group, help="Report to write: one HTML file that works offline."),
]

Seed: TypeAlias = Annotated[
    Amount, Parameter(group=expert_group, help="Seed: the same seed gives the same result.")
]
Permutations: TypeAlias = Annotated[
    Amount,
    Parameter(
        group=expert_group, help="Permutations for the p-value of Mantel r; 0 gives no p-value."
    ),
]
Truth: TypeAlias = Annotated[
    Path | None,
    Parameter(
        group=expert_group,
        help="File of true positions, in any map format, to score the map. Default: the positions "
        "in the recording, if it contains any.",
    ),
]
Exclude: TypeAlias = Annotated[
    list[str] | None,
    Parameter(
        help="Sensors to leave out of the score, such as s3,c0-c35. Give names, indices, ranges or "
        "patterns, separated by commas; may be repeated."
    ),
]


def _read_dimensions(_: object, tokens: Sequence[Token]) -> Any:
    """Read a number of dimensions: the default conversion rounds fractions."""
    from anisomap.method.dimensions import check_dimensions

    text = tokens[0].value
    dimensions: Any = int(text) if text.removeprefix("-").isdecimal() else text
    try:
        check_dimensions(dimensions)
    except InputError as error:
        raise ValueError(str(error)) from None
    return dimensions


Drop: TypeAlias = Annotated[
    list[str] | None,
    Parameter(
        group=method_group,
        help="Sensors to leave out, such as s3,c0-c35. Give names, indices, ranges or patterns, "
        "separated by commas; may be repeated.",
    ),
]
MapDimensions: TypeAlias = Annotated[
    int | Literal["auto"], Parameter(alias="-d", group=method_group, converter=_read_dimensions)
]
Missing: TypeAlias = Annotated[
    Literal["error", "drop-frames", "interpolate"],
    Parameter(
        group=method_group,
        help="NaN readings: error, drop-frames, interpolate. Infinite readings count as NaN.",
    ),
]


Units: TypeAlias = Annotated[
    str | None, Parameter(help="Unit of the positions, if the file contains none.")
]
Printing: TypeAlias = Annotated[Printer, Parameter(name="*", group=expert_group)]


def beside(path: Path, suffix: str) -> Path:
    """Return the default path of an output: the name of a file with `suffix`, in this folder."""
    return Path(path.name.split(".")[0] + suffix)
