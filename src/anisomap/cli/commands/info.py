"""``anisomap info``: what is in a recording."""

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
) -> None:
    """Say what is in a recording, before anyone spends time on it.

    Parameters
    ----------
    sensors
        List every sensor, not only those that look faulty.
    """
    how = reading.checked()
    pipeline.show_contents(recording, how)
    try:
        found = pipeline.read(recording, how)
    except ChoiceError as error:
        warn(str(error))  # to list what there is to choose from was all that could be asked for
        return
    examined = pipeline.examine(found)
    pipeline.show_recording(examined)
    pipeline.show_health(examined.health, everyone=sensors)
    for weakness in examined.summary.warnings:
        warn(weakness)
    if examined.summary.missing:
        warn(
            f"{examined.summary.missing} readings are NaN or infinite: "
            "map them with --missing drop-frames or --missing interpolate"
        )
