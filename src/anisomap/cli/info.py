"""``anisomap info``: what is in a recording."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from anisomap import formats
from anisomap.cli import parameters as options
from anisomap.cli import pipeline
from anisomap.cli.console import progress, warn


def info(
    recording: options.RecordingFile,
    /,
    *,
    sensors: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Say what is in a recording, before anyone spends time on it.

    Parameters
    ----------
    sensors
        List every sensor, not only those that look faulty.
    """
    with progress(f"reading {recording.name}"):
        readings = formats.read(recording)
    evidence = pipeline.examine(readings)
    pipeline.show_recording(evidence)
    pipeline.show_health(evidence.health, everyone=sensors)
    for weakness in evidence.summary.warnings:
        warn(weakness)
    if evidence.summary.missing:
        warn(
            f"{evidence.summary.missing} readings are NaN or infinite: "
            "map them with --nan drop-frames or --nan interpolate"
        )
