"""How a skin was touched, on the command line and in reports."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from anisomap.cli.console import Printer
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import SensorHealth, TouchCoverage, touch_coverage
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.wording import join_items

if TYPE_CHECKING:
    from anisomap.drawing import report

_MAX_QUICK = 1000  # sensors of which `anisomap info` makes a quick map, in about a second
_PLACES_TOLD = 3
_QUICK_METHOD = "r-anisomap"  # the fastest; neighbours suffice


def coverage_of(
    sensor_map: SensorMap, runs: Recording | Sequence[Recording]
) -> TouchCoverage | None:
    """Return how the sensors of a map were touched; None if the recordings are not in memory."""
    several = (runs,) if isinstance(runs, Recording) else tuple(runs)
    return touch_coverage(sensor_map, several) if several else None


def coverage_without_map(recording: Recording) -> TouchCoverage | None:
    """Return how a skin was touched, by its true positions or by a quick map; None without one."""
    if recording.positions is not None:
        return touch_coverage(SensorMap(recording.positions, names=recording.names), recording)
    if recording.n_sensors > _MAX_QUICK:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)
            complete = recording.complete("interpolate")
            return touch_coverage(reconstruct(complete, _QUICK_METHOD), recording)
    except InputError:  # too few sensors vary
        return None


def touch_facts(coverage: TouchCoverage, names: Sequence[str]) -> dict[str, str]:
    """Say in two facts how a skin was touched, and where to touch it next."""
    counts = coverage.contacts
    least = names[int(np.argmin(counts))]
    apart = len(coverage.never_together)
    told = [f"median {np.median(counts):g} per sensor, least {counts.min()} ({least})"]
    if coverage.untouched.size:
        told.append(f"{coverage.untouched.size} of {len(counts)} sensors untouched")
    if apart:
        told.append(f"{apart} of {len(coverage.pairs)} pairs of neighbours never touched together")
    around = "; ".join(place.in_words(names) for place in coverage.places[:_PLACES_TOLD])
    untouched = join_items([names[i] for i in coverage.untouched[:_PLACES_TOLD].tolist()])
    enough = f"no place lacks contacts: neighbours had about {ENOUGH_CONTACTS} or more together"
    return {
        "contacts": ", ".join(told),
        "touch next": around or (f"wherever {untouched} may be" if untouched else enough),
    }


def section(
    sensor_map: SensorMap,
    recording: Recording,
    health: Sequence[SensorHealth],
    coverage: TouchCoverage | None,
) -> report.Touches | None:
    """Return the section of a report on contacts and doubted sensors; None without contacts."""
    if coverage is None:
        return None
    doubted = [sensor for sensor in health if sensor.status != "ok"]
    from anisomap.drawing import figures, report  # noqa: PLC0415, slow to import

    series = figures.series_figure(recording, doubted) if doubted else None
    return report.Touches(
        touch_facts(coverage, sensor_map.names),
        figures.figure_bytes(figures.touch_figure(sensor_map, coverage)),
        None if series is None else figures.figure_bytes(series),
    )


def print_touches(printer: Printer, coverage: TouchCoverage | None, names: Sequence[str]) -> None:
    """Print how a skin was touched, and where to touch it next."""
    if coverage is None:
        return
    printer.facts("Touches", touch_facts(coverage, names))
    printer.record(
        touches={
            "contacts": dict(zip(names, coverage.contacts.tolist(), strict=True)),
            "never_together": [[names[i], names[j]] for i, j in coverage.never_together.tolist()],
            "next": [
                {
                    "sensors": [names[i] for i in place.sensors],
                    "centre": place.centre.tolist(),
                    "need": place.need,
                }
                for place in coverage.places
            ],
        }
    )
