"""``anisomap info``: a summary of a recording."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from anisomap.cli import parameters as options
from anisomap.cli import pipeline
from anisomap.cli.console import warn
from anisomap.io import ChoiceError


def info(
    recording: options.RecordingFile,
    /,
    *,
    sensors: Annotated[bool, Parameter(negative=())] = False,
    reading: options.Reading = options.AS_IT_COMES,
    reporting: options.Reporting = options.AS_TEXT,
) -> None:
    """Summarise a recording and flag faulty sensors.

    Parameters
    ----------
    sensors
        List all sensors, not only faulty ones.
    """
    how = reading.checked()
    with reporting.printer() as printer:
        pipeline.print_contents(printer, recording, how)
        try:
            found = pipeline.read(recording, how)
        except ChoiceError as error:
            warn(str(error))  # listing the choices was all that could be done
            return
        examined = pipeline.examine(found)
        pipeline.print_recording(printer, examined)
        pipeline.print_health(printer, examined.health, everyone=sensors)
        for weakness in examined.summary.warnings:
            warn(weakness)
        if examined.summary.missing:
            warn(
                f"{examined.summary.missing} readings are NaN or infinite: "
                "map them with --missing drop-frames or --missing interpolate"
            )
