"""``anisomap repair``: mend the faults of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import pipeline, printing
from anisomap.errors import InputError
from anisomap.files import check_distinct


def repair(
    recording: options.RecordingFile,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    reading: options.Reading = options.DEFAULT_READING,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Mend the faults of a recording that can be mended, and write it.

    These are copies of sensors, inverted sensors, lags between boards, leaks into the next channel,
    noise and hum that sensors share, spikes, drift and gaps. Copies of a sensor are left out.

    Parameters
    ----------
    output
        NPZ file to write.
    """
    check_distinct([output], [recording, *reading.inputs])
    io.check_writable(output)
    if output.suffix.lower() != ".npz":
        raise InputError(f"recordings are written as NPZ: {output} must end in .npz")
    found = pipeline.read(recording, reading.checked())
    (repaired,), findings = pipeline.repair_runs([found])
    io.write(repaired, output)
    with reporting.printer() as printer:
        printing.print_findings(printer, findings, repaired=True)
        if not findings:
            printer.line("No faults were found; the recording is unchanged.")
        printing.print_files(printer, [("recording", output)])
