"""``anisomap spoil``: inject documented faults into a recording."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline, printing
from anisomap.errors import InputError
from anisomap.files import check_distinct
from anisomap.simulation import inject, injected_faults, parse_fault
from anisomap.simulation.faults import ALL_SENSORS
from anisomap.wording import join_items


def spoil(
    recording: options.RecordingFile,
    /,
    *,
    fault: Annotated[list[str], Parameter(alias="-f", negative=())],
    output: Annotated[Path, Parameter(alias="-o")],
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Inject documented faults into a recording.

    The NPZ file lists every affected sensor and frame, so that fault detectors can be scored.

    Parameters
    ----------
    fault
        KIND:SENSORS,NAME=VALUE, such as dead:s3,s7 or saturating:10%,level=1 or dropped-frames.
        May be repeated; faults are applied in order. `anisomap faults` lists them.
    output
        NPZ file to write.
    seed
        The same seed gives the same faults.
    """
    requests = [parse_fault(text) for text in fault]
    check_distinct([output], [recording])
    io.check_writable(output)
    if output.suffix.lower() != ".npz":
        raise InputError(f"recordings are written as NPZ: {output} must end in .npz")
    spoilt = inject(pipeline.read(recording), requests, seed)
    io.write(spoilt, output)
    sensors: defaultdict[str, list[str]] = defaultdict(list)
    frames: defaultdict[str, int] = defaultdict(int)
    for done in injected_faults(spoilt):
        sensors[done.kind].append({ALL_SENSORS: "all", "": "-"}.get(done.sensor, done.sensor))
        frames[done.kind] += sum(stop - start for start, stop in done.spans)
    with reporting.printer() as printer:
        printer.table(
            "Injected faults",
            ("fault", "sensors", "readings or frames"),
            [(kind, join_items(names), str(frames[kind])) for kind, names in sensors.items()],
        )
        printer.record(
            faults=[
                {"fault": kind, "sensors": names, "readings_or_frames": frames[kind]}
                for kind, names in sensors.items()
            ]
        )
        printing.print_files(printer, [("recording", output)])
