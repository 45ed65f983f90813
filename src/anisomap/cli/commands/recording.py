"""``anisomap info``, ``repair`` and ``map``: a recording summarised, mended and mapped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

import anisomap
from anisomap import io
from anisomap.base.defaults import (
    DEFAULT_BINS,
    DEFAULT_METHOD,
    DEFAULT_MU,
    MAX_ITERATIONS,
    PERMUTATIONS,
    STRESS_PERMUTATIONS,
    TOLERANCE,
)
from anisomap.cli import parameters as options
from anisomap.cli.console import print_warning, progress
from anisomap.errors import InputError

if TYPE_CHECKING:
    from anisomap.health import Finding


def info(
    recording: options.RecordingFile,
    /,
    *,
    all_sensors: Annotated[bool, Parameter(name="--all")] = False,
    reading: options.ReadingOptions = options.DEFAULT_READING,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Summarise a recording, and flag faulty sensors and faults of the read-out.

    Parameters
    ----------
    all_sensors
        List all sensors, not only faulty ones.
    """
    from anisomap import route
    from anisomap.cli import outputs
    from anisomap.cli.commands import dissimilarities as objects
    from anisomap.io.dissimilarities import doubt_of

    how = reading.checked()
    try:
        table, doubt = objects.find([recording], wanted=None, weights=None), ""
    except InputError as error:
        table, doubt = None, str(error)
    if table is not None:
        objects.print_pairs(printer, table)
        return
    outputs.print_contents(printer, recording, how)
    try:
        found = route.read(recording, how, progress=progress)
    except io.ChoiceError as error:
        print_warning(str(error))  # the contents are listed; the user must select one
        return
    if doubt := doubt or doubt_of(recording, found.readings):
        print_warning(doubt)
    examined = route.examine([found], progress=progress)
    outputs.doubt_orientation(examined.summary)
    outputs.print_recording(printer, examined.recording, examined.summary)
    outputs.print_findings(printer, examined.findings)
    outputs.print_health(printer, examined.health, all_sensors=all_sensors)
    outputs.print_touches(printer, outputs.coverage_without_map(found), found.names)
    for weakness in examined.summary.warnings:
        print_warning(weakness)
    if examined.summary.missing:
        print_warning(
            f"{examined.summary.missing} readings are NaN or infinite: "
            "map them with --missing drop-frames or --missing interpolate"
        )


def repair(
    recording: options.RecordingFile,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    reading: options.ReadingOptions = options.DEFAULT_READING,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Mend the faults of a recording that can be mended, and write it.

    These are copies of sensors, which are left out, inverted sensors, lags between boards, hum,
    noise of boards, and gaps. Other faults are named only.

    Parameters
    ----------
    output
        NPZ file to write. Default: NAME.repaired.npz in the current folder.
    """
    from anisomap import route
    from anisomap.cli import outputs

    output = output or options.beside(recording, ".repaired.npz")
    outputs.Outputs(recording=output, inputs=(recording, *reading.inputs))
    (repaired,), findings = route.read_mended([recording], reading.checked(), progress=progress)
    io.write(repaired, output)
    outputs.print_findings(printer, findings, repaired=True)
    if not findings:
        printer.line("No faults of the recording were found; it is unchanged.")
    outputs.print_health(printer, anisomap.assess(repaired))
    printer.files([("recording", output)])


_READINGS_PER_MIB = 1 << 18  # of 4 bytes


@Parameter(name="*", group=options.expert_group)
@dataclass(frozen=True)
class TuningOptions:
    """Settings of the methods.

    Parameters
    ----------
    regularisation
        Regularisation of ANISOMAP's reciprocal; with 0, unrelated components stay separate.
    entropy_bins
        Bins per sensor for entropies.
    n_neighbours
        Neighbours per sensor in ISOMAP's graph. Default: the smallest number that connects all.
    tolerance
        Stop scaling when an iteration lowers the stress by less than this share.
    max_iterations
        Maximum number of iterations of the scaling.
    """

    regularisation: float = DEFAULT_MU
    entropy_bins: int = DEFAULT_BINS
    n_neighbours: int | None = None
    tolerance: float = TOLERANCE
    max_iterations: int = MAX_ITERATIONS

    def checked(self) -> anisomap.MethodOptions:
        """Convert to the options of the library."""
        from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions

        return anisomap.MethodOptions(
            regularisation=self.regularisation,
            entropy_bins=self.entropy_bins,
            n_neighbours=self.n_neighbours,
            smacof=SmacofOptions(self.tolerance, self.max_iterations),
        )


def map_recording(
    recordings: Annotated[
        list[Path], Parameter(help="Recording files of one skin."), options.existing
    ],
    /,
    *,
    dissimilarities: Annotated[
        bool | None, Parameter(group=options.method_group, negative="--no-dissimilarities")
    ] = None,
    weights: Annotated[Path | None, options.expert] = None,
    output: options.Output = None,
    picture: options.Picture = None,
    report: options.Report = None,
    method: Annotated[
        str | None,
        Parameter(alias="-m", group=options.method_group, show_default=DEFAULT_METHOD),
    ] = None,
    dimensions: options.MapDimensions = "auto",
    drop: options.Drop = None,
    missing: options.Missing = "error",
    repair: Annotated[bool, Parameter(group=options.method_group)] = False,
    tuning: TuningOptions = TuningOptions(),
    reading: options.ReadingOptions = options.DEFAULT_READING,
    verdict: Annotated[bool, Parameter(group=options.method_group, negative="--no-verdict")] = True,
    min_quality: Annotated[options.Quality | None, options.expert] = None,
    placing: options.PlacingOptions = options.DEFAULT_PLACING,
    truth: options.Truth = None,
    exclude: options.Exclude = None,
    permutations: Annotated[
        int | None,
        Parameter(
            group=options.score_group,
            validator=Number(gte=0),
            help="Size of the null distribution of Mantel r, or of the stress of dissimilarities; "
            "0 skips it.",
            show_default=f"{PERMUTATIONS}, or {STRESS_PERMUTATIONS} of the stress",
        ),
    ] = None,
    seed: options.Seed = 0,
    memory: Annotated[options.Count, options.expert] = 512,
    printer: options.Printing = options.PRINTER,
) -> int:
    """Make a map from one or several recordings of a skin.

    Sensors of several recordings are matched by name; recordings may lack some sensors. Of readings
    above 512 MiB, frames are sampled evenly in time, and the map says so.

    A square symmetric matrix with a zero diagonal is mapped as dissimilarities of objects.

    Parameters
    ----------
    dissimilarities
        The file holds dissimilarities: a square matrix, a triangle, or lines of two names and a
        value. --method is then anisomap (distances are shortest paths), mds (they are the
        dissimilarities) or ordinal (they have their order), and --picture shepard and
        --picture stress draw NAME.shepard.png and NAME.stress.png.
    weights
        File of the weights of pairs, in the form of the dissimilarities; 0 leaves a pair out.
    output
        File for the map; its suffix chooses the format. May be repeated. Default: NAME.map.csv in
        the current folder.
    method
        Reconstruction method: see `anisomap list methods`.
    dimensions
        Number of coordinates: 2 for flat skins, 3 for bodies; auto chooses 3 if the third
        coordinate improves the fit clearly, else 2.
    repair
        Mend faults of the recording first: copies, inverted sensors, lags, hum, noise of boards,
        and gaps. `anisomap info` lists those that it finds.
    verdict
        Judge the map, and estimate the error of every sensor, from maps of resampled recordings.
        This takes about as long as the map, which is written before; Ctrl-C ends it.
    memory
        Size of the readings in MiB, of 4 bytes each, above which frames are sampled.
    min_quality
        Exit with code 1 if the verdict is worse than this, or cannot tell. All files are written.
    """
    from anisomap import route
    from anisomap.cli import outputs
    from anisomap.cli.commands import dissimilarities as objects
    from anisomap.method.named import METHODS, find_method

    if min_quality and not verdict:
        raise InputError("--min-quality requires the verdict, so leave out --no-verdict")
    chosen = tuning.checked()
    table = objects.find(recordings, wanted=dissimilarities, weights=weights)
    if table is not None and (len(recordings) > 1 or repair or min_quality):
        raise InputError(
            "dissimilarities are read from one file, and get no verdict: leave out other files, "
            "--repair and --min-quality"
        )
    maps = output or [options.beside(recordings[0], ".map.csv")]
    drawn = str(picture) if table is not None and str(picture) in objects.PICTURES else ""
    files = outputs.Outputs(
        maps=maps,
        picture=options.beside(recordings[0], f".{drawn}.png") if drawn else picture,
        report=report,
        inputs=(*recordings, *reading.inputs, truth, weights),
        placing=placing,
    )
    placing.check(maps)
    by = method or DEFAULT_METHOD
    if table is None:
        # Unknown methods and options are refused before the recording is read.
        find_method(by)
    reference = None if truth is None else outputs.read_reference(truth)
    scored = outputs.Truth(PERMUTATIONS if permutations is None else permutations, seed, reference)
    if table is not None:
        objects.map_file(
            printer,
            files,
            scored,
            table,
            picture=drawn,
            exclude=exclude,
            source=recordings[0].name,
            weights=weights,
            drop=route.split_names(drop, table.names),
            method=method,
            dimensions=dimensions,
            options=chosen.smacof,
            permutations=STRESS_PERMUTATIONS if permutations is None else permutations,
            seed=seed,
        )
        return 0
    runs, mended = _read(
        recordings,
        reading.checked(),
        missing,
        memory * _READINGS_PER_MIB,
        repair=repair,
        doubted=dissimilarities is None,
    )
    remaining = [one for one in mended if not one.mendable] if repair else None
    examined = route.examine(runs, remaining, progress=progress)
    outputs.doubt_orientation(examined.summary, judged=verdict and METHODS[by].refine is not None)
    names = examined.recording.names
    left_out = route.split_names(exclude, names)
    dropped = route.split_names(drop, names, examined.recording.metadata)
    examined.recording.indices([*left_out, *dropped])  # unknown names are refused at once
    if left_out and examined.recording.positions is None and reference is None:
        print_warning(
            "--exclude has no effect: the recording has no true positions to score against"
        )
    sensor_map, judge = route.make_map(
        examined, by, dimensions, options=chosen, drop=dropped, seed=seed, progress=progress
    )
    outputs.print_recording(printer, examined.recording, examined.summary)
    outputs.print_findings(printer, mended if repair else examined.findings, repaired=repair)
    if done := dict.fromkeys(one.kind for one in mended if one.mendable):
        provenance = {**sensor_map.provenance, "repaired": ", ".join(done)}
        sensor_map = replace(sensor_map, provenance=provenance)

    judged = outputs.finish(
        printer,
        files,
        sensor_map,
        examined,
        replace(scored, exclude=left_out),
        judge=judge if verdict else None,
    )
    if not min_quality or judged.verdict.is_at_least(min_quality.replace("-", " ")):
        return 0
    print_warning(f"below --min-quality {min_quality}: the map is {judged.verdict}")
    return 1


def _read(
    recordings: list[Path],
    how: io.ReadOptions,
    missing: options.Missing,
    max_readings: int,
    *,
    repair: bool,
    doubted: bool,
) -> tuple[list[anisomap.Recording], Sequence[Finding]]:
    """Read recordings; return them and the faults that were mended.

    doubted: Whether to ask if a single file may hold dissimilarities.
    """
    from anisomap import route
    from anisomap.io.dissimilarities import doubt_of

    limits: dict[str, Any] = {"max_readings": max_readings, "progress": progress}
    if repair:
        return route.read_mended(recordings, how, missing, **limits)
    runs = route.read_runs(recordings, how, missing, **limits)
    if doubted and len(recordings) == 1 and (doubt := doubt_of(recordings[0], runs[0].readings)):
        raise InputError(doubt)
    return runs, ()
