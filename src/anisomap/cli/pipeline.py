"""What `map` and `demo` have in common: make a map, score it, show it, write it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisomap import io
from anisomap.cli.console import console, number, percent, progress, show_facts, show_table
from anisomap.diagnostics import diagnose
from anisomap.drawing import figures, report
from anisomap.evaluation import Score, confidence_in_words, score
from anisomap.files import check_distinct
from anisomap.health import RecordingSummary, SensorHealth, assess, summarise
from anisomap.large.approximation import Related, approximate_map_of
from anisomap.large.streaming import Gathered, map_of
from anisomap.methods import MethodOptions
from anisomap.reconstruction import reconstruct
from anisomap.recording import MissingPolicy, Recording
from anisomap.runs import join_runs
from anisomap.sensor_map import SensorMap

_MOST_SHOWN = 100  # sensors with a fault


@dataclass(frozen=True)
class Outputs:
    """Files to write: maps in any format, a picture, a report."""

    maps: tuple[Path, ...] = ()
    picture: Path | None = None
    report: Path | None = None

    def check(self, *inputs: Path) -> None:
        """Find out before the work, not after it, what could not be written.

        Raises
        ------
        FileError
            If a folder is missing, a suffix is of no format that can be written, or a file would
            overwrite an input or another output.
        MissingExtraError
            If a picture or report needs a library that is not installed.
        """
        check_distinct([path for path in (*self.maps, self.picture, self.report) if path], inputs)
        for path in self.maps:
            io.check_writable(path)
        if self.picture:
            figures.check_writable(self.picture)
        if self.report:
            report.check_writable(self.report)


@dataclass(frozen=True)
class Examined:
    """A recording, and the runs it was joined from, with what was found out before any map."""

    recording: Recording
    health: Sequence[SensorHealth]
    summary: RecordingSummary
    runs: Sequence[Recording] = ()


def read(path: Path, how: io.ReadOptions | None = None) -> Recording:
    """Read a recording, with progress; one that does not say where it came from is of its file."""
    with progress(f"reading {path.name}") as tell:
        recording = io.read(path, options=how, progress=tell)
        return replace(recording, source=recording.source or path.name)


def read_runs(
    paths: Sequence[Path], how: io.ReadOptions, missing: MissingPolicy
) -> list[Recording]:
    """Read one recording, or several of one skin.

    What a preset calls absent must be silent in all of them, so it is applied to all as one.
    """
    if len(paths) == 1 or not how.preset:
        return [read(path, how).complete(missing) for path in paths]
    runs = [read(path, replace(how, preset="")).complete(missing) for path in paths]
    return [io.apply_preset(join_runs(runs), how.preset)]


def show_contents(path: Path, how: io.ReadOptions) -> None:
    """Print what a file holds, if it is of a kind that can hold several recordings."""
    held = io.contents(path, options=how)
    if held:
        rows = [(c.name, c.summary, "yes" if c.usable else "no") for c in held]
        show_table(f"In {path.name}", ("name", "what it is", "a recording"), rows)


def examine(recording: Recording) -> Examined:
    """Assess a recording, with progress."""
    with progress("looking at every sensor"):
        health = assess(recording)
        return Examined(recording, health, summarise(recording, health))


def examine_runs(runs: Sequence[Recording]) -> Examined:
    """Assess one recording, or several as one, with progress."""
    if len(runs) == 1:
        return examine(runs[0])
    with progress("looking at every sensor"):
        joined, health = join_runs(runs), assess(runs)
        return Examined(joined, health, summarise(joined, health), tuple(runs))


def make_map(
    examined: Examined,
    method: str,
    dimensions: int,
    *,
    options: MethodOptions | None = None,
    drop: Sequence[str] = (),
    with_confidence: bool = True,
    gathered: Gathered | Related | None = None,
) -> SensorMap:
    """Reconstruct and diagnose, with progress; notes appear as warnings."""
    with progress("making the map"):
        if isinstance(gathered, Related):
            return approximate_map_of(gathered, dimensions, options=options)
        if gathered is not None:
            return map_of(gathered, method, dimensions, options=options, drop=drop)
        runs = examined.runs or [examined.recording]
        made = reconstruct(runs, method, dimensions, options=options, drop=drop)
        return diagnose(
            made,
            runs,
            options=options,
            drop=drop,
            health=examined.health,
            with_confidence=with_confidence,
        )


def finish(
    outputs: Outputs,
    sensor_map: SensorMap,
    examined: Examined,
    permutations: int,
    seed: int,
    *,
    exclude: Sequence[str] = (),
) -> None:
    """Show a map with all that is known of it, and write the files asked for."""
    result = _score_if_known(sensor_map, examined.recording, permutations, seed, exclude)
    show_health(examined.health)
    _show_map(sensor_map)
    if result is not None:
        show_score(result)
    _write(outputs, sensor_map, examined, result)


def _score_if_known(
    sensor_map: SensorMap,
    recording: Recording,
    permutations: int,
    seed: int,
    exclude: Sequence[str],
) -> Score | None:
    if recording.positions is None:
        return None
    with progress(f"relabelling the sensors {permutations} times") as tell:
        return score(
            sensor_map,
            recording.positions,
            exclude=exclude,
            units=recording.units,
            permutations=permutations,
            rng=np.random.default_rng(seed),
            progress=tell,
        )


def show_recording(examined: Examined) -> None:
    """Print what is in a recording."""
    summary = examined.summary
    rate = "unknown" if summary.rate_hz is None else f"{number(summary.rate_hz)} Hz"
    duration = "" if summary.duration is None else f", {number(summary.duration)} s"
    show_facts(
        "Recording",
        {
            "source": examined.recording.source or "unknown",
            "frames": f"{summary.n_frames}{duration}",
            "rate": rate,
            "sensors": f"{summary.n_sensors}, of which {summary.n_constant} never vary",
            "readings": f"{number(summary.minimum)} to {number(summary.maximum)}, "
            f"{percent(summary.share_of_zeros)} zeros, {summary.missing} missing",
            "distinct values": f"{summary.distinct_values} a sensor (median)",
            "true positions": "known" if examined.recording.positions is not None else "not known",
        },
    )


def show_health(health: Sequence[SensorHealth], *, everyone: bool = False) -> None:
    """Print sensor health: those with a fault, or everyone, and how many are well.

    Of very many with a fault, the first are shown.
    """
    every = [sensor for sensor in health if sensor.status != "ok"]
    ill = every if everyone else every[:_MOST_SHOWN]
    well = [sensor for sensor in health if sensor.status == "ok"]
    counts = Counter(sensor.status for sensor in health)
    title = "Sensor health: " + ", ".join(f"{n} {status}" for status, n in counts.most_common())
    rows = [
        (
            sensor.name,
            sensor.status,
            f"{number(sensor.minimum)} .. {number(sensor.maximum)}",
            str(sensor.distinct),
            percent(sensor.active),
            str(sensor.contacts),
            number(sensor.best_match, 2),
        )
        for sensor in (ill + well if everyone else ill)
    ]
    if not rows:
        show_facts(title, {})
        return
    columns = ("sensor", "status", "range", "values", "active", "contacts", "best r")
    show_table(title, columns, rows)
    for sensor in ill:
        console.print(f"  {sensor.name}: {sensor.reason}", markup=False, soft_wrap=True)
    if len(every) > len(ill):
        console.print(f"  ... and {len(every) - len(ill)} more that are not ok")


def _show_map(sensor_map: SensorMap) -> None:
    """Print what a map is, and how far it is known."""
    how = ", approximate" if sensor_map.approximate else ""
    show_facts(
        f"Map by {sensor_map.method}{how}",
        {
            "sensors placed": f"{np.count_nonzero(sensor_map.placed)} of {sensor_map.n_sensors}, "
            f"in {sensor_map.dimensions} dimensions",
            "Stress-1": f"{number(sensor_map.stress)} (0 is a perfect fit of the metric)",
            "confidence": confidence_in_words(sensor_map.confidence),
            "known up to": sensor_map.known_up_to,
        },
    )


def show_score(result: Score) -> None:
    """Print how a map compares with the truth."""
    units = result.units or "units of the truth"
    null = result.mantel.quantiles()
    facts = {"Mantel r": number(result.mantel.r)}
    if null:
        facts |= {
            "its null": ", ".join(
                f"{_quantile_name(level)} {value:.3f}" for level, value in null.items()
            ),
            "p": f"{number(result.mantel.p_value, 3)} ({result.mantel.null.size} labellings)",
        }
    facts |= {
        "RMS error": f"{number(result.rms)} {units}, or {number(result.rms_in_spacings)} of the "
        f"median sensor spacing ({number(result.spacing)} {units})",
        "mirrored": "yes" if result.alignment.reflected else "no",
        "neighbours kept": percent(result.neighbours_kept),
        "sensors compared": str(result.mantel.n_sensors),
    }
    show_facts("Score against the true positions", facts)
    for note in result.notes:
        console.print(f"  note: {note}", markup=False)


def _write(
    outputs: Outputs, sensor_map: SensorMap, examined: Examined, result: Score | None
) -> None:
    with progress("writing"):
        for path in outputs.maps:
            io.write(sensor_map, path)
        figure = (
            figures.map_figure(sensor_map, result) if outputs.picture or outputs.report else None
        )
        if outputs.picture and figure is not None:
            figures.save_figure(figure, outputs.picture)
        if outputs.report and figure is not None:
            report.write_report(
                outputs.report,
                sensor_map,
                score=result,
                health=examined.health,
                summary=examined.summary,
                figure_png=figures.figure_bytes(figure),
            )
    named: list[tuple[str, Path | None]] = [("map", path) for path in outputs.maps]
    named += [("picture", outputs.picture), ("report", outputs.report)]
    show_table("Files", ("what", "where"), [(what, str(p)) for what, p in named if p is not None])


def _quantile_name(level: float) -> str:
    names = {0.0: "least", 0.5: "median", 1.0: "greatest"}
    return names.get(level, f"{level:.0%}")
