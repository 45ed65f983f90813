"""``anisomap info``, ``repair`` and ``map``: a recording summarised, mended and mapped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

import anisomap
from anisomap import io
from anisomap.base import DEFAULT_METHOD, PERMUTATIONS
from anisomap.cli import parameters as options
from anisomap.cli.console import print_warning, progress
from anisomap.errors import InputError

if TYPE_CHECKING:
    from anisomap.route import Examined


def info(
    recording: options.RecordingFile,
    /,
    *,
    all_sensors: Annotated[bool, Parameter(name="--all")] = False,
    reading: options.ReadingOptions = options.DEFAULT_READING,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Summarise a recording: sensors, faults of the read-out, touches.

    If a file contains several recordings, they are listed as well.

    Parameters
    ----------
    all_sensors
        List all sensors, not only faulty ones.

    Examples
    --------
    anisomap info skin.csv
    anisomap info skin.csv --all
    anisomap info run.mcap --select /skin
    """
    from anisomap import route
    from anisomap.cli import printing

    how = reading.checked()
    printing.print_contents(printer, recording, how)
    try:
        with progress(f"reading {recording.name}") as report_progress:
            found = route.read(recording, how, progress=report_progress)
    except io.ChoiceError as error:
        print_warning(str(error))  # the contents are listed; the user must select one
        return
    with progress("assessing sensors"):
        examined = route.examine(found)
    printing.doubt_orientation(examined.summary)
    printing.print_recording(printer, examined.recording, examined.summary)
    printing.print_findings(printer, examined.findings)
    printing.print_health(printer, examined.health, all_sensors=all_sensors)
    printing.print_touches(printer, printing.coverage_without_map(found), found.names)
    for weakness in examined.summary.warnings:
        print_warning(weakness)
    if examined.summary.missing:
        print_warning(
            f"readings that are NaN or infinite: {examined.summary.missing:,}; "
            "to map the recording, add --missing drop-frames or --missing interpolate"
        )


def repair(
    recording: options.RecordingFile,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    reading: options.ReadingOptions = options.DEFAULT_READING,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Repair the faults of a recording, and write the result.

    Inverted sensors, hum, noise of boards and gaps are repaired; copies of sensors and frozen
    frames are left out. Other faults are only listed.

    Parameters
    ----------
    output
        .npz or .txt file to write. Default: NAME.repaired.npz in the current folder.

    Examples
    --------
    anisomap repair skin.csv
    anisomap repair skin.csv -o mended.npz
    anisomap map skin.csv --repair
    """
    from anisomap import route
    from anisomap.cli import outputs, printing

    output = output or options.beside(recording, ".repaired.npz")
    outputs.Outputs(recording=output, inputs=(recording, *reading.inputs))
    with progress(f"reading {recording.name}") as report_progress:
        found = route.read(recording, reading.checked(), progress=report_progress)
    with progress("repairing the recording"):
        repaired = anisomap.repair(found)
    io.write(repaired.recording, output)
    printing.print_findings(printer, repaired.findings, repaired=True)
    if not repaired.findings:
        printer.line("No faults of the recording were found; it is unchanged.")
    printing.print_health(printer, anisomap.assess(repaired.recording))
    printer.files([("recording", output)])


_READINGS_PER_MIB = 1 << 18  # of 4 bytes


@Parameter(name="*", group=options.expert_group)
@dataclass(frozen=True)
class VerdictOptions:
    """The verdict on a map.

    Parameters
    ----------
    verdict
        Judge the map, and estimate the error of every sensor, from maps of resampled recordings.
        The verdict takes up to about twice as long as the map; Ctrl-C ends it and keeps the map.
    contacts
        Shape of all contacts: compact or elongated. Contacts of a fingertip, a palm or a ball are
        compact; contacts of an edge or a roller are elongated, and increase the expected error. A
        map of unevenly spaced sensors can be usable only with --contacts compact and --uneven.
        Default: the shape given in the recording, as in files of simulate.
    uneven
        The sensors are unevenly spaced on the skin; see --contacts.
    min_quality
        Exit with code 1 if the verdict is worse than this level, or "cannot tell". All files are
        written in any case.
    """

    verdict: Annotated[bool, Parameter(negative="--no-verdict")] = True
    contacts: Annotated[
        Literal["compact", "elongated"] | None, Parameter(group=options.method_group)
    ] = None
    uneven: bool = False
    min_quality: options.Quality | None = None
    seed: options.Seed = 0

    def __post_init__(self) -> None:
        if self.min_quality and not self.verdict:
            raise InputError("--min-quality requires the verdict, so leave out --no-verdict")


@Parameter(name="*", group=options.method_group)
@dataclass(frozen=True)
class MappingOptions:
    """How a map is made.

    Parameters
    ----------
    dimensions
        2 for flat skins, 3 for curved skins, or auto. Auto chooses 3 if the third coordinate
        clearly improves the fit, else 2.
    repair
        Repair the faults of the recording first. `anisomap info` lists the faults, and `anisomap
        repair` writes the repaired recording.
    method
        Reconstruction method: see `anisomap list methods`.
    memory
        Size of the readings in MiB (4 bytes each) above which frames are subsampled evenly.
    """

    dimensions: options.MapDimensions = "auto"
    drop: options.Drop = None
    missing: options.Missing = "error"
    repair: bool = False
    method: Annotated[
        str | None, Parameter(alias="-m", group=options.expert_group, show_default=DEFAULT_METHOD)
    ] = None
    memory: Annotated[options.Count, options.expert] = 512


def map_recording(
    recordings: Annotated[
        list[Path],
        Parameter(name="RECORDING", help="Recording files of one skin."),
        options.existing,
    ],
    /,
    *,
    output: options.Output = None,
    report: options.Report = None,
    picture: options.Picture = None,
    placing: options.PlacingOptions = options.DEFAULT_PLACING,
    mapping: MappingOptions = MappingOptions(),
    reading: options.ReadingOptions = options.DEFAULT_READING,
    judging: VerdictOptions = VerdictOptions(),
    truth: options.Truth = None,
    permutations: options.Permutations = PERMUTATIONS,
    printer: options.Printing = options.PRINTER,
) -> int:
    """Make a map of a skin from one or several recordings.

    Sensors of several recordings are matched by name; each recording may lack some sensors. Frames
    of recordings above 512 MiB (see --memory) are subsampled evenly.

    Parameters
    ----------
    output
        Map file; its suffix gives the format [NAME.map.csv]. May be repeated. The default file is
        in the current folder.

    Examples
    --------
    anisomap map skin.csv -d 2 --report skin.html
    anisomap map monday.csv tuesday.csv --drop s3,s7 -o skin.ply
    anisomap map skin.csv --spacing 6.5mm --mirror -o skin.urdf
    """
    from anisomap import route
    from anisomap.cli import printing
    from anisomap.cli.outputs import Outputs, Truth, finish, read_reference
    from anisomap.method.named import find_method
    from anisomap.placement.placing import headline

    files = Outputs(
        maps=output or [options.beside(recordings[0], ".map.csv")],
        picture=picture,
        report=report,
        inputs=(*recordings, *reading.inputs, truth),
        placing=placing,
    )
    placing.check(files.maps)
    reference = None if truth is None else read_reference(truth)
    by = mapping.method or DEFAULT_METHOD
    refined = find_method(by).refine is not None  # refuse unknown methods before files are read
    examined = _examined(recordings, reading.checked(), mapping)
    printing.doubt_orientation(examined.summary, judged=judging.verdict and refined)
    with progress("making the map"):
        made, stages = route.make_map(examined, by, mapping.dimensions)
    printing.print_recording(printer, examined.recording, examined.summary)
    faults = [*examined.mended, *examined.findings]
    printing.print_findings(printer, faults, repaired=mapping.repair)
    stated = partial(route.judge, contacts=judging.contacts or "", uneven=judging.uneven)
    judge = partial(stated, examined, stages=stages, seed=judging.seed)
    wanted = judge if judging.verdict else None
    scored = Truth(permutations, judging.seed, reference)
    shown = finish(printer, files, made, examined, scored, judge=wanted)
    least = judging.min_quality
    if not least or shown.verdict.is_at_least(least.replace("-", " ")):
        return 0
    print_warning(f"below --min-quality {least}: the map is {headline(shown)}")
    return 1


def _examined(recordings: Sequence[Path], how: io.ReadOptions, mapping: MappingOptions) -> Examined:
    """Read recordings of one skin, mend them if requested, and assess them."""
    from anisomap import route

    limit = mapping.memory * _READINGS_PER_MIB
    with progress("reading") as report_progress:
        runs = route.read_runs(recordings, how, max_readings=limit, progress=report_progress)
    repaired = None
    if mapping.repair:
        with progress("repairing the recording"):
            repaired = anisomap.repair(runs)
    with progress("assessing sensors"):
        complete = route.complete(repaired.recording if repaired else runs, mapping.missing)
        mended = repaired.findings if repaired else None
        return route.examine(complete, mended=mended, drop=mapping.drop)
