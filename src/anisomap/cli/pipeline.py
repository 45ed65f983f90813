"""Steps that several commands share: read, examine, map, score and write."""

from __future__ import annotations

import hashlib
import shlex
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from anisomap import io
from anisomap.cli import printing
from anisomap.cli.console import Printer, console, print_warning, progress
from anisomap.cli.parameters import DEFAULT_PLACING, PlacingOptions, doubt_spacing
from anisomap.diagnosis.diagnostics import diagnose
from anisomap.dimensions import Dimensions
from anisomap.errors import FileError, InputError
from anisomap.evaluation import Score, score
from anisomap.files import check_distinct, check_target, together
from anisomap.health import (
    Finding,
    RecordingSummary,
    SensorHealth,
    TouchCoverage,
    assess,
    find_faults,
    repair,
    summarise,
    touch_coverage,
)
from anisomap.memory import check_pair_memory
from anisomap.options import MethodOptions
from anisomap.placement.frames import in_millimetres
from anisomap.reconstruction import reconstruct_with_stages
from anisomap.recording import MissingPolicy, Recording, as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.usability import Verdict
from anisomap.wording import as_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from anisomap.drawing import report
    from anisomap.large.approximation import SimilarityGraph
    from anisomap.large.streaming import StreamedSimilarity

LARGE_BYTES = 1 << 29
"""Size of the readings, as float32, above which a recording is read in blocks: 512 MiB."""

PROBED_BYTES = 1 << 24
"""Total size of files below which the size of the readings is not estimated."""

_NOT_MAPS = {
    **dict.fromkeys((".png", ".svg", ".pdf"), "a picture: name it by --picture"),
    ".html": "a report: name it by --report of anisomap map",
}

Source: TypeAlias = "Sequence[Recording] | StreamedSimilarity | SimilarityGraph"
"""Recordings of one skin, or what their frames were reduced to if they were read in blocks."""


@dataclass(frozen=True)
class Outputs:
    """Files to write, and the inputs, which none may be; checked before anything is computed.

    maps: Maps, in any format.
    recording: An NPZ file.
    others: Files whose formats are not checked here.
    placing: Scale and frame of the maps; if None, they are written as they are.
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
            if kind := _NOT_MAPS.get(path.suffix.lower()):
                raise FileError(f"{path} would not hold a map but {kind}")
            io.check_writable(path)
        if self.recording:
            check_target(self.recording)
            if self.recording.suffix.lower() != ".npz":
                raise FileError(f"recordings are written as NPZ: {self.recording} must end in .npz")
        if self.picture:
            from anisomap.drawing import figures

            figures.check_writable(self.picture)
        if self.report:
            from anisomap.drawing import report

            report.check_writable(self.report)

    def write(
        self,
        sensor_map: SensorMap,
        draw: Callable[[], Figure] | None = None,
        content: str = "map",
    ) -> list[tuple[str, Path]]:
        """Write the maps and the picture; return the files, each with its content."""
        written: list[tuple[str, Path]] = []
        with progress("writing"), together():
            for path in self.maps:
                if self.placing is None:
                    io.write(sensor_map, path)
                    written.append((content, path))
                else:
                    inputs = list(filter(None, self.inputs))
                    files = self.placing.write(sensor_map, path, inputs)
                    written += [(content, file) for file in files]
            if self.picture and draw:
                from anisomap.drawing import figures

                figures.save_figure(draw(), self.picture)
                written.append(("picture", self.picture))
        return written


@dataclass(frozen=True)
class Examined:
    """What a map is made from, with its sensor health, summary and faults.

    recording: All runs as one, or segments of those that were read in blocks.
    """

    source: Source
    recording: Recording
    health: Sequence[SensorHealth]
    summary: RecordingSummary
    findings: Sequence[Finding] = ()

    @property
    def runs(self) -> Sequence[Recording]:
        """The recordings, if they are in memory."""
        return self.source if isinstance(self.source, Sequence) else ()


def read(path: Path, how: io.ReadOptions | None = None) -> Recording:
    """Read a recording, with progress; the default of its source is the file name."""
    with progress(f"reading {path.name}") as report_progress:
        recording = io.read(path, options=how, progress=report_progress)
    return replace(recording, source=recording.source or as_text(path.name))


def too_large(paths: Sequence[Path], how: io.ReadOptions) -> bool:
    """Estimate from their first blocks whether recordings are too large for memory."""
    if sum(map(on_disk, paths)) < PROBED_BYTES:
        return False
    total = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the same warnings follow when the file is read
        for path in paths:
            with io.open_stream(path, options=how) as stream:
                for block in stream.blocks:
                    total += 4 * block.readings.size / max(block.fraction, 1e-9)
                    break
    return total > LARGE_BYTES


def on_disk(path: Path) -> int:
    """Return the size of a file, or of all files of a folder, in bytes."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def read_runs(
    paths: Sequence[Path], how: io.ReadOptions, missing: MissingPolicy
) -> list[Recording]:
    """Read one recording, or several of one skin.

    A preset leaves out channels that are constant in all runs, so it is applied to the joined runs.
    """
    if len(paths) == 1 or not how.preset:
        return [complete(read(path, how), missing) for path in paths]
    unnamed = replace(how, preset="", positions=None)
    runs = [complete(read(path, unnamed), missing) for path in paths]
    return [io.attach_positions(io.apply_preset(join_runs(runs), how.preset), how.positions)]


def complete(recording: Recording, missing: MissingPolicy) -> Recording:
    """Handle missing readings; an error names the option that does."""
    try:
        return recording.complete(missing)
    except InputError as error:
        if missing != "error":
            raise
        hint = "use --missing drop-frames or --missing interpolate"
        raise InputError(f"{str(error).partition(';')[0]}; {hint}") from error


def repair_runs(runs: Sequence[Recording]) -> tuple[list[Recording], tuple[Finding, ...]]:
    """Mend the faults of one recording, or of several of one skin, with progress."""
    with progress("repairing the recording"):
        repaired = [repair(run) for run in as_runs(list(runs))]
    findings = tuple(finding for one in repaired for finding in one.findings)
    return [one.recording for one in repaired], findings


def examine(source: Source, findings: Sequence[Finding] | None = None) -> Examined:
    """Assess recordings of one skin, with progress; by default, their faults are searched for."""
    if not isinstance(source, Sequence):
        rate_hz = source.excerpt.rate_hz
        summary = replace(
            summarise(source.excerpt, source.health),
            n_frames=source.n_frames,
            duration=None if rate_hz is None else source.n_frames / rate_hz,
            n_constant=int(np.count_nonzero(~source.varying)),
        )
        return Examined(source, source.excerpt, source.health, summary)
    # Comparing all pairs of so many sensors that no map fits into memory takes hours.
    check_pair_memory(max(run.n_sensors for run in source), refined=False)
    with progress("assessing sensors"):
        joined, health = join_runs(source), assess(source)
        found = find_faults(source) if findings is None else findings
        return Examined(source, joined, health, summarise(joined, health), found)


Judge: TypeAlias = Callable[..., SensorMap]
"""A function that adds its verdict to a map."""


def make_map(
    examined: Examined,
    method: str,
    dimensions: Dimensions,
    *,
    options: MethodOptions | None = None,
    drop: Sequence[str] = (),
    seed: int = 0,
) -> tuple[SensorMap, Judge | None]:
    """Make a map, with progress, and what judges it if it can be judged; notes are warnings."""
    source = examined.source
    with progress("making the map"):
        if not isinstance(source, Sequence):
            from anisomap.large.approximation import SimilarityGraph, map_similarity_graph
            from anisomap.large.streaming import map_streamed_similarity

            if not isinstance(source, SimilarityGraph):
                made = map_streamed_similarity(
                    source, method, dimensions, options=options, drop=drop
                )
                return made, None
            return map_similarity_graph(source, dimensions, options=options), None
        made, stages = reconstruct_with_stages(
            source, method, dimensions, options=options, drop=drop
        )
        diagnosed = partial(
            diagnose,
            recording=source,
            options=options,
            drop=drop,
            health=examined.health,
            findings=examined.findings,
            rng=seed,
            stages=stages,
        )
        return diagnosed(made, with_verdict=False), diagnosed


def reaches(verdict: Verdict, level: str) -> bool:
    """Return whether a verdict reaches a level, and print a message if it does not."""
    if verdict.is_at_least(level):
        return True
    print_warning(f"below --min-quality {level.replace(' ', '-')}: the map is {verdict}")
    return False


def finish(
    printer: Printer,
    outputs: Outputs,
    sensor_map: SensorMap,
    examined: Examined,
    *,
    permutations: int,
    seed: int,
    judge: Judge | None = None,
    exclude: Sequence[str] = (),
    written: Sequence[tuple[str, Path]] = (),
    write_others: Callable[[], None] | None = None,
    truth: SensorMap | None = None,
) -> SensorMap:
    """Write and print a map; then judge it, score it if the truth is known, and write all files.

    If it is interrupted from the verdict on, the map is written without one.

    write_others: Writes the last of `written` together with the map; the others are written.
    """
    placed = (outputs.placing or DEFAULT_PLACING).applied
    coverage = touch_coverage(sensor_map, examined.runs) if examined.runs else None
    with together():
        if write_others is not None:
            write_others()
        files = outputs.write(placed(sensor_map))
    printing.print_health(printer, examined.health)
    printing.print_touches(printer, coverage, sensor_map.names)
    printing.print_map(printer, placed(sensor_map))
    if outputs.placing and outputs.placing.spacing:
        doubt_spacing(outputs.placing.spacing)
    paths = ", ".join(str(path) for _, path in files)
    printer.line(f"Written to {paths}" + ("; the verdict follows" if judge else ""))
    try:
        if judge is not None:
            with progress("judging the map; Ctrl-C keeps it without a verdict") as report_progress:
                sensor_map = judge(sensor_map, progress=report_progress)
        shown, result = placed(sensor_map), None
        if judge is not None or not examined.runs:
            printing.print_verdict(printer, shown)
        printing.record_map(printer, shown)
        if truth is not None or examined.recording.positions is not None:
            result = score_with_progress(
                shown, truth or examined.recording, permutations, seed, exclude=exclude
            )
            printing.print_score(printer, result, shown, "Score against the true positions")
        files += write_outputs(outputs, shown, result, examined, coverage)[len(files) :]
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {paths} is written, without a verdict") from None
    printing.print_files(printer, [*written, *files])
    return sensor_map


def score_with_progress(
    sensor_map: SensorMap,
    truth: Recording | SensorMap,
    permutations: int,
    seed: int,
    *,
    exclude: Sequence[str] = (),
) -> Score:
    """Score a map against the positions of a recording or of another map, in millimetres."""
    if isinstance(truth, Recording):
        truth = SensorMap(np.asarray(truth.positions), names=truth.names, units=truth.units)
    truth = in_millimetres(truth)
    with progress(f"computing {permutations} permutations") as report_progress:
        return score(
            sensor_map,
            truth,
            exclude=exclude,
            units=truth.units,
            permutations=permutations,
            rng=np.random.default_rng(seed),
            progress=report_progress,
        )


def read_reference(path: Path, units: str | None = None) -> SensorMap:
    """Read the positions that a map is scored against."""
    reference = io.read_map(path)
    if units is None:
        units = "" if reference.units == "arbitrary" else reference.units
    return replace(reference, units=units)


def write_outputs(
    outputs: Outputs,
    sensor_map: SensorMap,
    result: Score | None = None,
    examined: Examined | None = None,
    coverage: TouchCoverage | None = None,
    *,
    draw: Callable[[], Figure] | None = None,
) -> list[tuple[str, Path]]:
    """Write all files; return them, each with its content.

    draw: Draws the picture; the map by default.
    """
    if not (outputs.picture or outputs.report):
        return outputs.write(sensor_map)
    from anisomap.drawing import figures, report

    shown = in_millimetres(sensor_map)
    figure = figures.map_figure(shown, result)
    with together():
        written = outputs.write(sensor_map, draw or (lambda: figure))
        if outputs.report:
            with progress("writing"):
                report.write_report(
                    outputs.report,
                    shown,
                    score=result,
                    health=examined.health if examined else (),
                    summary=examined.summary if examined else None,
                    figure_png=figures.figure_bytes(figure),
                    touches=_touches(shown, result, examined, coverage),
                    origin=_origin(outputs.inputs),
                )
            written.append(("report", outputs.report))
    return written


def _origin(inputs: Sequence[Path | None]) -> dict[str, str]:
    """Return the command of this process, and a digest of every input."""
    found = {"command": shlex.join(["anisomap", *console.arguments])}
    for path in filter(None, inputs):
        if path.is_file():
            with path.open("rb") as file:
                found[f"SHA-256 of {path.name}"] = hashlib.file_digest(file, "sha256").hexdigest()
    return found


def _touches(
    sensor_map: SensorMap,
    result: Score | None,
    examined: Examined | None,
    coverage: TouchCoverage | None,
) -> report.Touches | None:
    """Return the section of a report on contacts and doubted sensors; None without contacts."""
    if examined is None or coverage is None:
        return None
    from anisomap.drawing import figures, report

    doubted = [sensor for sensor in examined.health if sensor.status != "ok"]
    series = figures.series_figure(examined.recording, doubted) if doubted else None
    return report.Touches(
        printing.touch_facts(coverage, sensor_map.names),
        figures.figure_bytes(figures.touch_figure(sensor_map, coverage, result)),
        None if series is None else figures.figure_bytes(series),
    )
