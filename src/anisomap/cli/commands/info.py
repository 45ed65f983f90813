"""``anisomap info``: a summary of a recording."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from anisomap.cli import parameters as options
from anisomap.cli import pipeline, printing, touches
from anisomap.cli.console import print_warning
from anisomap.io import ChoiceError


def info(
    recording: options.RecordingFile,
    /,
    *,
    sensors: Annotated[bool, Parameter(negative=())] = False,
    reading: options.Reading = options.DEFAULT_READING,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Summarise a recording, and flag faulty sensors and faults of the read-out.

    Parameters
    ----------
    sensors
        List all sensors, not only faulty ones.
    """
    how = reading.checked()
    with reporting.printer() as printer:
        printing.print_contents(printer, recording, how)
        try:
            found = pipeline.read(recording, how)
        except ChoiceError as error:
            print_warning(str(error))  # the contents are listed; the user must select one
            return
        examined = pipeline.examine(found)
        printing.print_recording(printer, examined.recording, examined.summary)
        printing.print_findings(printer, examined.findings)
        printing.print_health(printer, examined.health, all_sensors=sensors)
        touches.print_touches(printer, touches.coverage_without_map(found), found.names)
        for weakness in examined.summary.warnings:
            print_warning(weakness)
        if examined.summary.missing:
            print_warning(
                f"{examined.summary.missing} readings are NaN or infinite: "
                "map them with --missing drop-frames or --missing interpolate"
            )
