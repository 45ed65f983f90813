"""Files written by commands: maps, pictures and reports; and the last steps of making a map."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisomap import drawing, io
from anisomap.base.wording import number
from anisomap.cli.console import Printer, console, print_warning, progress
from anisomap.cli.parameters import DEFAULT_PLACING, PlacingOptions
from anisomap.cli.printing import (
    print_health,
    print_map,
    print_score,
    print_touches,
    print_verdict,
    record_map,
    touch_facts,
)
from anisomap.errors import FileError, InputError
from anisomap.evaluation import Score, score
from anisomap.files.paths import check_distinct, check_target, together
from anisomap.health import TouchCoverage, touch_coverage
from anisomap.placement.frames import in_millimetres
from anisomap.placement.placing import spacing_shown
from anisomap.recording import Recording
from anisomap.route import Examined
from anisomap.sensor_map import UNSCALED, SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOT_MAPS = {
    **dict.fromkeys((".png", ".svg", ".pdf"), "pictures are written by --picture"),
    ".html": "reports are written by --report of anisomap map",
}


_ALIKE = 1.5  # maximum ratio of two spacings of one skin with correct units; by hand


@dataclass(frozen=True)
class Truth:
    """Options of scoring.

    reference: Positions to score against; if None, true positions in the recording.
    exclude: Sensors to leave out.
    """

    permutations: int
    seed: int = 0
    reference: SensorMap | None = None
    exclude: Sequence[str] = ()

    def score(
        self, printer: Printer, sensor_map: SensorMap, title: str, known: Recording | None = None
    ) -> Score | None:
        """Score a map in millimetres, and print it; None if no true positions are known."""
        truth = self.reference
        if truth is None and known is not None and known.positions is not None:
            truth = SensorMap(np.asarray(known.positions), names=known.names, units=known.units)
        if truth is None:
            return None
        truth = in_millimetres(truth)
        with progress(f"computing {self.permutations} permutations") as report_progress:
            result = score(
                sensor_map,
                truth,
                exclude=self.exclude,
                units=truth.units,
                permutations=self.permutations,
                rng=np.random.default_rng(self.seed),
                progress=report_progress,
            )
        print_score(printer, result, sensor_map, title)
        spacing, unit = spacing_shown(sensor_map)
        if unit == truth.units and not 1 / _ALIKE <= result.spacing / spacing <= _ALIKE:
            print_warning(
                f"neighbouring sensors are {number(result.spacing)} {unit} apart by the true "
                f"positions, and {number(spacing)} {unit} on the map: check --spacing and the units"
            )
        return result


def read_layout(path: Path, units: str | None = None) -> SensorMap:
    """Read positions; `units` is their unit if the file gives none."""
    layout = io.read_map(path)
    if units is None:
        return layout
    if layout.units not in (*UNSCALED, units):
        raise InputError(f"{path} states the unit {layout.units}: leave out --units {units}")
    return replace(layout, units=units)


def read_reference(path: Path, units: str | None = None) -> SensorMap:
    """Read the reference positions for a score."""
    found = read_layout(path, units)
    return replace(found, units="" if found.units == "arbitrary" else found.units)


@dataclass(frozen=True)
class Outputs:
    """Files to write, and inputs, which must not be overwritten; checked before computations.

    maps: Maps, in any format.
    recording: NPZ or text.
    others: Files whose formats are not checked here.
    placing: Scale and frame of the maps; if None, maps are written unchanged.
    """

    maps: Sequence[Path] = ()
    recording: Path | None = None
    picture: Path | None = None
    report: Path | None = None
    others: Sequence[Path | None] = ()
    inputs: Sequence[Path | None] = ()
    placing: PlacingOptions | None = None

    def __post_init__(self) -> None:
        every = (*self.maps, self.recording, self.picture, self.report, *self.others)
        check_distinct(filter(None, every), filter(None, self.inputs))
        for path in self.maps:
            if hint := _NOT_MAPS.get(path.suffix.lower()):
                raise FileError(f"cannot write a map to {path}: {hint}")
            io.check_writable(path)
        for other in filter(None, self.others):
            check_target(other)
        if self.recording:
            io.check_writable(self.recording, recording=True)
        if self.picture:
            drawing.figures.check_writable(self.picture)
        if self.report:
            drawing.report.check_writable(self.report)

    def write(
        self,
        sensor_map: SensorMap,
        draw: Callable[[], Figure] | None = None,
        content: str = "map",
        *,
        source: tuple[Path, SensorMap] | None = None,
    ) -> list[tuple[str, Path]]:
        """Write the maps and the picture; return files and descriptions of their contents.

        source: A file and the map in it; unchanged lines of the file are kept.
        """
        written: list[tuple[str, Path]] = []
        with progress("writing"), together():
            for path in self.maps:
                if source is not None:
                    io.write_corrected(*source, sensor_map, path)
                else:
                    io.write(sensor_map, path)
                written.append((content, path))
            if self.picture and draw:
                drawing.figures.save_figure(draw(), self.picture)
                written.append(("picture", self.picture))
        return written

    def write_all(
        self,
        sensor_map: SensorMap,
        result: Score | None = None,
        examined: Examined | None = None,
        coverage: TouchCoverage | None = None,
    ) -> list[tuple[str, Path]]:
        """Write all files of a map and its score; return files and descriptions of contents."""
        if not (self.picture or self.report):
            return self.write(sensor_map)
        figures, shown = drawing.figures, in_millimetres(sensor_map)
        with together():
            written = self.write(sensor_map, lambda: figures.map_figure(shown, result))
            if self.report:
                touches = None
                if examined is not None and coverage is not None:
                    doubted = [sensor for sensor in examined.health if sensor.status != "ok"]
                    series = figures.series_figure(examined.recording, doubted) if doubted else None
                    touches = drawing.report.Touches(
                        touch_facts(coverage, shown.names),
                        coverage,
                        None if series is None else figures.figure_bytes(series),
                    )
                drawing.report.write_report(
                    self.report,
                    shown,
                    score=result,
                    health=examined.health if examined else (),
                    summary=examined.summary if examined else None,
                    touches=touches,
                    origin=self._origin(),
                )
                written.append(("report", self.report))
        return written

    def _origin(self) -> dict[str, str]:
        """Return the command of this process, and a digest of every input."""
        found = {"command": shlex.join(["anisomap", *console.arguments])}
        for path in filter(None, self.inputs):
            if path.is_file():
                with path.open("rb") as file:
                    digest = hashlib.file_digest(file, "sha256")
                found[f"SHA-256 of {path.name}"] = digest.hexdigest()
        return found


def finish(
    printer: Printer,
    outputs: Outputs,
    sensor_map: SensorMap,
    examined: Examined,
    truth: Truth,
    *,
    judge: Callable[..., SensorMap] | None = None,
    write_others: Callable[[], list[tuple[str, Path]]] = list,
) -> SensorMap:
    """Write and print a map; then judge it, score it if the truth is known, and write all files.

    Returns the map as it was written, with its verdict and scale.

    If it is interrupted during or after the verdict, the map is written without a verdict.

    judge: Adds a verdict: ``judge(sensor_map, progress=...)``.
    write_others: Writes other files together with the map, and returns them.
    """
    placed = (outputs.placing or DEFAULT_PLACING).applied
    touched = examined.recording.touched
    coverage = touch_coverage(sensor_map, examined.recording) if touched else None
    with together():
        others = write_others()
        files = outputs.write(placed(sensor_map))
    print_health(printer, examined.health)
    print_touches(printer, coverage, sensor_map.names)
    print_map(printer, placed(sensor_map))
    paths = ", ".join(str(path) for _, path in files)
    printer.line(f"Written to {paths}" + ("; the verdict follows" if judge else ""))
    try:
        if judge is not None:
            with progress("judging the map; Ctrl-C keeps it without a verdict") as report_progress:
                sensor_map = judge(sensor_map, progress=report_progress)
        shown = placed(sensor_map)
        if judge is not None:
            print_verdict(printer, shown)
        record_map(printer, shown)
        result = truth.score(printer, shown, "Score against the true positions", examined.recording)
        files = outputs.write_all(shown, result, examined, coverage)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {paths} is written, without a verdict") from None
    printer.files([*others, *files])
    return shown
