"""Steps that several commands share: read, examine, map, score and write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisomap import io
from anisomap.cli import printing
from anisomap.cli import printing as touches
from anisomap.cli.console import Printer, print_warning, progress
from anisomap.cli.parameters import DEFAULT_PLACING, PlacingOptions
from anisomap.diagnosis.diagnostics import diagnose
from anisomap.dimensions import Dimensions
from anisomap.errors import FileError, InputError
from anisomap.evaluation import Score, score
from anisomap.files import check_distinct
from anisomap.health import (
    Finding,
    RecordingSummary,
    SensorHealth,
    TouchCoverage,
    assess,
    find_faults,
    repair,
    summarise,
)
from anisomap.large.approximation import SimilarityGraph, map_similarity_graph
from anisomap.large.streaming import StreamedSimilarity, map_streamed_similarity
from anisomap.memory import check_pair_memory
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct_with_stages
from anisomap.recording import MissingPolicy, Recording, as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.usability import Verdict
from anisomap.wording import as_text

_SHARE_OF_MAP = 0.45
"""Share of the time of a map with its verdict that the map takes, for the progress display.

.43 to .51 on eleven recordings, simulated and real; .24 to .34 on three others.
"""

_OTHER_OUTPUTS = {
    ".png": "--picture",
    ".svg": "--picture",
    ".pdf": "--picture",
    ".html": "--report",
}


@dataclass(frozen=True)
class Outputs:
    """Files to write: maps in any format, a picture, a report ...; and all inputs."""

    maps: tuple[Path, ...] = ()
    picture: Path | None = None
    report: Path | None = None
    checkpoint: Path | None = None
    statistics: Path | None = None
    inputs: tuple[Path, ...] = ()
    placing: PlacingOptions = DEFAULT_PLACING

    def check(self) -> None:
        """Check, before the map is computed, that all files can be written."""
        others = (self.picture, self.report, self.checkpoint, self.statistics)
        check_distinct([path for path in (*self.maps, *others) if path], self.inputs)
        for path in self.maps:
            if option := _OTHER_OUTPUTS.get(path.suffix.lower()):
                raise FileError(f"{path} cannot hold a map: name it by {option}, not by --output")
            io.check_writable(path)
        if self.picture:
            from anisomap.drawing import figures  # noqa: PLC0415, slow to import

            figures.check_writable(self.picture)
        if self.report:
            from anisomap.drawing import report  # noqa: PLC0415, slow to import

            report.check_writable(self.report)


@dataclass(frozen=True)
class Examined:
    """A recording, its sensor health, summary and faults, and the runs that it was joined from."""

    recording: Recording
    health: Sequence[SensorHealth]
    summary: RecordingSummary
    runs: Sequence[Recording] = ()
    findings: Sequence[Finding] = ()


def read(path: Path, how: io.ReadOptions | None = None) -> Recording:
    """Read a recording, with progress; the default of its source is the file name."""
    with progress(f"reading {path.name}") as report_progress:
        recording = io.read(path, options=how, progress=report_progress)
        return replace(recording, source=recording.source or as_text(path.name))


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


def examine(
    runs: Recording | Sequence[Recording], findings: Sequence[Finding] | None = None
) -> Examined:
    """Assess one recording, or several as one, with progress."""
    several = [runs] if isinstance(runs, Recording) else list(runs)
    # Comparing all pairs of so many sensors that no map fits into memory takes hours.
    check_pair_memory(max(run.n_sensors for run in several), refined=False)
    with progress("assessing sensors"):
        joined, health = join_runs(several), assess(several)
        found = find_faults(several) if findings is None else findings
        return Examined(joined, health, summarise(joined, health), tuple(several), found)


def make_map(
    examined: Examined,
    method: str,
    dimensions: Dimensions,
    *,
    options: MethodOptions | None = None,
    drop: Sequence[str] = (),
    with_verdict: bool = True,
    seed: int = 0,
    streamed: StreamedSimilarity | SimilarityGraph | None = None,
) -> SensorMap:
    """Reconstruct and diagnose a map, with progress; its notes are issued as warnings."""
    with progress("making the map") as report_progress:
        if isinstance(streamed, SimilarityGraph):
            return map_similarity_graph(streamed, dimensions, options=options)
        if streamed is not None:
            return map_streamed_similarity(streamed, method, dimensions, options=options, drop=drop)
        made, stages = reconstruct_with_stages(
            examined.runs, method, dimensions, options=options, drop=drop
        )
        if with_verdict:
            report_progress(_SHARE_OF_MAP)
        return diagnose(
            made,
            examined.runs,
            options=options,
            drop=drop,
            health=examined.health,
            findings=examined.findings,
            with_verdict=with_verdict,
            rng=seed,
            progress=lambda share: report_progress(_SHARE_OF_MAP + (1 - _SHARE_OF_MAP) * share),
            stages=stages,
        )


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
    exclude: Sequence[str] = (),
    already_written: Sequence[tuple[str, Path]] = (),
    truth: SensorMap | None = None,
) -> None:
    """Score a map if the truth is known, write all files, and print the results."""
    result = None
    if truth is not None or examined.recording.positions is not None:
        result = score_with_progress(
            sensor_map, truth or examined.recording, permutations, seed, exclude=exclude
        )
    coverage = touches.coverage_of(sensor_map, examined.runs)
    files = write_outputs(outputs, sensor_map, result, examined, coverage)
    printing.print_health(printer, examined.health)
    touches.print_touches(printer, coverage, sensor_map.names)
    printing.print_map(printer, sensor_map)
    if result is not None:
        printing.print_score(printer, result, sensor_map, "Score against the true positions")
    printing.print_files(printer, [*already_written, *files])


def score_with_progress(
    sensor_map: SensorMap,
    truth: Recording | SensorMap,
    permutations: int,
    seed: int,
    *,
    exclude: Sequence[str] = (),
) -> Score:
    """Score a map against the positions of a recording or of another map, with progress."""
    with progress(f"computing {permutations} permutations") as report_progress:
        return score(
            sensor_map,
            truth if isinstance(truth, SensorMap) else np.asarray(truth.positions),
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
) -> list[tuple[str, Path]]:
    """Write all files; return them, each with its kind."""
    written: list[tuple[str, Path]] = []
    with progress("writing"):
        for path in outputs.maps:
            files = outputs.placing.write(sensor_map, path, outputs.inputs)
            written += [("map", file) for file in files]
        if outputs.picture or outputs.report:
            written += _draw(outputs, sensor_map, result, examined, coverage)
    return written


def _draw(
    outputs: Outputs,
    sensor_map: SensorMap,
    result: Score | None,
    examined: Examined | None,
    coverage: TouchCoverage | None,
) -> list[tuple[str, Path]]:
    """Write the picture and the report; return them, each with its kind."""
    from anisomap.drawing import figures, report  # noqa: PLC0415, slow to import

    written: list[tuple[str, Path]] = []
    figure = figures.map_figure(sensor_map, result)
    if outputs.picture:
        figures.save_figure(figure, outputs.picture)
        written.append(("picture", outputs.picture))
    if outputs.report:
        report.write_report(
            outputs.report,
            sensor_map,
            score=result,
            health=() if examined is None else examined.health,
            summary=None if examined is None else examined.summary,
            figure_png=figures.figure_bytes(figure),
            touches=None
            if examined is None
            else touches.section(sensor_map, examined.recording, examined.health, coverage),
        )
        written.append(("report", outputs.report))
    return written
