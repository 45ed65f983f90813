"""Sentences, facts and tables of a report, without markup."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from anisomap.covariance_ellipses import ellipses
from anisomap.drawing.view import MAX_JOINED, layout_notes, printable
from anisomap.evaluation import Score
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.methods import METHODS
from anisomap.sensor_map import UNSCALED, SensorMap, is_faulty
from anisomap.usability import LEVELS
from anisomap.wording import join_items

UNKNOWN = "\N{EN DASH}"

MAX_ROWS = 2000
"""Largest number of sensors in the table; browsers lay out longer tables slowly."""

# Smallest Mantel r for each description, chosen by hand.
_AGREEMENT = ((0.98, "very closely"), (0.9, "closely"), (0.6, "roughly"), (-1.0, "only weakly"))

_N_WORST = 5  # sensors named first
_COARSE = 1.0  # RMS error in sensor spacings from which neighbours may be exchanged


@dataclass(frozen=True)
class Fact:
    """A value with its name and an explanation."""

    name: str
    value: str
    meaning: str = ""


@dataclass(frozen=True)
class Touches:
    """How a skin was touched.

    facts: Numbers of contacts, and where to touch next.
    map_png: Picture of the contacts by place.
    series_png: Picture of the readings of doubted sensors over time.
    """

    facts: Mapping[str, str]
    map_png: bytes
    series_png: bytes | None = None


@dataclass(frozen=True)
class Cell:
    """A table cell: its text, and the key by which it is sorted (None is last)."""

    text: str
    key: str | float | None = None


@dataclass(frozen=True)
class Row:
    """A sensor in the table."""

    name: str
    status: str
    reason: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class SensorTable:
    """Table of the sensors: those with problems first, otherwise in the order of the map.

    columns: Titles and explanations of the cells, which follow name and status and precede the
        reason.
    rows: One per sensor, at most `MAX_ROWS`.
    counts: Number of sensors with each status.
    n_sensors: Number of sensors of the map.
    """

    columns: tuple[Fact, ...]
    rows: tuple[Row, ...]
    counts: str
    n_sensors: int

    @property
    def n_problems(self) -> int:
        """Number of listed sensors whose status is not ok."""
        return sum(is_faulty(row.status) for row in self.rows)


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """Format a number with some significant digits; a dash replaces an unknown number."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    rounded = float(f"{value:.{digits}g}")
    if 1000 <= abs(rounded) < 1e7:  # "g" would write an exponent
        decimals = max(0, digits - len(str(int(abs(rounded)))))
        text = f"{rounded:.{decimals}f}"
    else:
        text = f"{rounded:.{digits}g}"
    return f"{text} {unit}".strip()


def headlines(sensor_map: SensorMap, score: Score | None) -> list[str]:
    """Summarise the quality of the map; the first sentence is the headline."""
    sentences = _unscored(sensor_map) if score is None else _scored(sensor_map, score)
    sentences.insert(1, f"Verdict: {printable(str(sensor_map.verdict))}.")
    if sensor_map.approximate:
        sentences.append("This map is approximate: only some pairs of sensors were compared.")
    return sentences


def _unscored(sensor_map: SensorMap) -> list[str]:
    placed = int(sensor_map.placed.sum())
    sizes = sensor_map.component_sizes
    apart = (
        f", but only {sizes[0]} relative to one another: the others are in {len(sizes) - 1} "
        "separate components"
        if len(sizes) > 1
        else ""
    )
    return [
        f"{placed} of {sensor_map.n_sensors} sensors have a position{apart}.",
        f"The map is known up to {sensor_map.known_up_to}.",
    ]


def _scored(sensor_map: SensorMap, score: Score) -> list[str]:
    r, n_permutations = score.mantel.r, len(score.mantel.null)
    null = score.mantel.quantiles().get(0.95)
    if null is not None and r <= null:
        headline = (
            f"The map does not agree with the truth better than random permutations: "
            f"Mantel r {r:.3f}, null 95 % quantile {null:.3f}."
        )
    else:
        how = next(word for least, word in _AGREEMENT if r >= least)
        headline = f"Distances on the map agree {how} with the true ones: Mantel r {r:.3f}."
    if score.rms_in_spacings > _COARSE:
        headline += " Neighbourhoods are unreliable."
    names = [sensor_map.names[i] for i in score.sensors[score.worst(_N_WORST)]]
    errors = score.alignment.errors[score.worst(_N_WORST)]
    worst = [
        f"{printable(name)} ({number(float(error), unit=score.units)})"
        for name, error in zip(names, errors, strict=True)
    ]
    sentences = [headline, f"Farthest from their true positions: {join_items(worst)}."]
    if null is not None and r > null:
        sentences.append(
            f"For comparison: 95 % of {n_permutations} random permutations of the sensors have a "
            f"Mantel r below {null:.3f}."
        )
    reflection = "with" if score.alignment.reflected else "without"
    return [
        *sentences,
        f"The RMS error of the positions is {number(score.rms, unit=score.units)}, or "
        f"{number(score.rms_in_spacings, 2)} times the median distance between neighbours.",
        f"The map is known up to {sensor_map.known_up_to}. These were fitted to the truth; the "
        f"best fit is {reflection} reflection.",
    ]


def facts(sensor_map: SensorMap, score: Score | None) -> list[Fact]:
    """List the figures of merit."""
    placed = int(sensor_map.placed.sum())
    found = []
    if score is not None:
        null = score.mantel.quantiles()
        found += [
            Fact(
                "Mantel r",
                f"{score.mantel.r:.3f}",
                "correlation of the distances on the map with the true distances; at most 1",
            ),
            Fact("Null, 95 %", f"{null[0.95]:.3f}" if null else UNKNOWN, _null_range(score)),
            Fact(
                "RMS error",
                number(score.rms, unit=score.units),
                "after the best rotation, translation, scale and reflection",
            ),
            Fact(
                "RMS error, spacings",
                number(score.rms_in_spacings, 2),
                f"in units of the median sensor spacing, {number(score.spacing, unit=score.units)}",
            ),
            Fact(
                "Neighbours kept",
                f"{score.neighbours_kept:.0%}",
                "share of the true nearest neighbours that are also nearest on the map",
            ),
        ]
    found += [
        Fact(
            "Verdict",
            sensor_map.verdict.level,
            LEVELS.get(sensor_map.verdict.level, "the map was not judged"),
        ),
        Fact(
            "Expected error, spacings",
            number(sensor_map.verdict.expected_error, 2),
            f"{number(sensor_map.verdict.repeatability, 2)} by chance, "
            f"{number(sensor_map.verdict.systematic, 2)} systematic",
        ),
        Fact("Placed", f"{placed} of {sensor_map.n_sensors}", "sensors with a position on the map"),
        Fact(
            "Stress-1",
            number(sensor_map.stress),
            "misfit between the distances on the map and the metric; 0 is a perfect fit",
        ),
    ]
    return found


def _null_range(score: Score) -> str:
    null = score.mantel.quantiles()
    if not null:
        return "not computed"
    return (
        f"Mantel r of random permutations: min {null[0.0]:.3f}, median {null[0.5]:.3f}, "
        f"max {null[1.0]:.3f}; p = {number(score.mantel.p_value, 2)}"
    )


def alternative_text(sensor_map: SensorMap, score: Score | None) -> str:
    """Describe the picture for readers who cannot see it."""
    placed = int(sensor_map.placed.sum())
    if score is None:
        lines = ", neighbours joined by lines" if placed <= MAX_JOINED else ""
        return f"The map of {placed} sensors{lines}."
    lines = ", true neighbours joined by lines in both" if placed <= MAX_JOINED else ""
    return (
        f"Left: the true positions of {len(score.sensors)} sensors. Middle: the map aligned with "
        f"them{lines}. Right: distances on the map against true distances, Mantel r "
        f"{score.mantel.r:.3f}."
    )


def caveats(
    sensor_map: SensorMap, score: Score | None, summary: RecordingSummary | None
) -> list[str]:
    """List the caveats of map, score and recording, without repetition."""
    notes = [*sensor_map.notes, *layout_notes(sensor_map, score)]
    unplaced = [printable(sensor_map.names[i]) for i in np.flatnonzero(~sensor_map.placed)]
    if unplaced and score is None:
        notes.append(f"sensors without a position: {join_items(unplaced, 12)}")
    if score is not None:
        notes += score.notes
        if score.rms_in_spacings > _COARSE:
            notes.append(
                f"the RMS error is {number(score.rms_in_spacings, 2)} sensor spacings: the map "
                "shows the overall shape, but not which sensors are neighbours"
            )
    notes += summary.warnings if summary is not None else ()
    return list(dict.fromkeys(printable(note[:1].upper() + note[1:]) for note in notes))


def sensor_statuses(sensor_map: SensorMap, health: Sequence[SensorHealth]) -> tuple[str, ...]:
    """Return the status of every sensor, from `health` or else from the map."""
    assessed = {sensor.name: sensor.status for sensor in health}
    own = zip(sensor_map.names, sensor_map.health, strict=True)
    return tuple(printable(assessed.get(name, status)) for name, status in own)


def sensor_table(
    sensor_map: SensorMap, score: Score | None, health: Sequence[SensorHealth]
) -> SensorTable:
    """Tabulate the sensors: those with the greatest errors first, else those with problems."""
    assessed = {sensor.name: sensor for sensor in health}
    statuses = sensor_statuses(sensor_map, health)
    errors = {} if score is None else dict(zip(score.sensors, score.alignment.errors, strict=True))
    columns: list[tuple[Fact, Callable[[int], Cell]]] = []
    if len(sensor_map.component_sizes) > 1 or not sensor_map.placed.all():
        fact = Fact("Component", "", "connected component of the map; 1 is the largest")
        columns.append((fact, lambda i: _component(int(sensor_map.component[i]) + 1)))
    if score is not None:
        unit = f" ({score.units})" if score.units else ""
        fact = Fact(f"Error{unit}", "", "distance from the true position")
        columns.append((fact, lambda i: _numeric(errors.get(i))))
    if sensor_map.covariances is not None:
        unit = "" if sensor_map.units in UNSCALED else f" ({printable(sensor_map.units)})"
        radii = ellipses(sensor_map.covariances)[0].max(axis=1)
        fact = Fact(f"95 %{unit}", "", "longest half axis of the ellipse of 95 %, by chance alone")
        columns.append((fact, lambda i: _numeric(float(radii[i]))))
    if health:
        columns += [
            (fact, partial(_measured, cell, sensor_map.names, assessed)) for fact, cell in _MEASURED
        ]
    listed = sorted(
        range(len(statuses)), key=lambda i: (not is_faulty(statuses[i]), -errors.get(i, 0))
    )
    rows = []
    for i in sorted(listed[:MAX_ROWS], key=lambda i: -errors.get(i, 0)):
        name = sensor_map.names[i]
        reason = printable(assessed[name].reason) if name in assessed else ""
        cells = tuple(cell(i) for _, cell in columns)
        rows.append(Row(printable(name), statuses[i], reason, cells))
    counts = ", ".join(f"{statuses.count(status)} {status}" for status in sorted(set(statuses)))
    return SensorTable(tuple(fact for fact, _ in columns), tuple(rows), counts, len(statuses))


def recording_facts(summary: RecordingSummary | None) -> list[Fact]:
    """Summarise the recording; empty if no summary is given."""
    if summary is None:
        return []
    rate = number(summary.rate_hz, 4, "Hz") if summary.rate_hz else "unknown"
    duration = number(summary.duration, 4, "s") if summary.duration is not None else "unknown"
    return [
        Fact("Frames", str(summary.n_frames)),
        Fact(
            "Sensors",
            str(summary.n_sensors),
            f"{summary.n_constant} constant" if summary.n_constant else "all active",
        ),
        Fact("Rate", rate),
        Fact("Duration", duration),
        Fact("Readings", f"{number(summary.minimum, 4)} to {number(summary.maximum, 4)}"),
        Fact("Zeros", f"{summary.share_of_zeros:.1%}", "share of all readings"),
        Fact("Distinct values", str(summary.distinct_values), "median over sensors"),
        Fact("Missing", str(summary.missing), "readings that are NaN or infinite"),
    ]


def provenance(sensor_map: SensorMap, score: Score | None) -> list[Fact]:
    """List the information needed to reproduce the map."""
    method = sensor_map.method or "not recorded"
    summary = METHODS[method].summary if method in METHODS else ""
    found = [
        Fact("method", printable(method), summary),
        Fact("dimensions", str(sensor_map.dimensions)),
        Fact("units of the map", printable(sensor_map.units)),
    ]
    if score is not None:
        found.append(Fact("permutations of the null", str(len(score.mantel.null))))
    return found + [
        Fact(printable(name), printable(str(value)))
        for name, value in sensor_map.provenance.items()
    ]


def _component(number: int) -> Cell:
    return Cell(str(number), number) if number else Cell("not placed")


def _measured(
    cell: Callable[[SensorHealth], Cell],
    names: Sequence[str],
    assessed: Mapping[str, SensorHealth],
    i: int,
) -> Cell:
    return cell(assessed[names[i]]) if names[i] in assessed else Cell(UNKNOWN)


def _share(value: float) -> Cell:
    return Cell(f"{value:.1%}" if math.isfinite(value) else UNKNOWN, value)


def _numeric(value: float | None, digits: int = 3) -> Cell:
    if value is None or not math.isfinite(value):
        return Cell(UNKNOWN)
    return Cell(number(value, digits), float(value))


_MEASURED: tuple[tuple[Fact, Callable[[SensorHealth], Cell]], ...] = (
    (Fact("Min", "", "smallest reading"), lambda sensor: _numeric(sensor.minimum)),
    (Fact("Max", "", "largest reading"), lambda sensor: _numeric(sensor.maximum)),
    (
        Fact("Values", "", "number of distinct readings"),
        lambda sensor: Cell(str(sensor.distinct), sensor.distinct),
    ),
    (
        Fact("Active", "", "share of frames in which the reading is not at rest"),
        lambda sensor: _share(sensor.active),
    ),
    (
        Fact("Contacts", "", "number of separate contacts"),
        lambda sensor: Cell(str(sensor.contacts), sensor.contacts),
    ),
    (
        Fact("Lag-1 r", "", "autocorrelation at a lag of one frame; near 0 for noise"),
        lambda sensor: _numeric(sensor.lag_correlation, 2),
    ),
    (
        Fact("Best match", "", "highest Pearson r with another sensor"),
        lambda sensor: _numeric(sensor.best_match, 2),
    ),
)
"""Columns of the table of sensors that the health of a sensor fills."""
