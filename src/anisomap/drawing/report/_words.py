"""What a report says, in plain words and in tables: no markup here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisomap.drawing.view import MOST_JOINED, shown, warn_of_pieces
from anisomap.evaluation import Score, confidence_in_words
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.methods import METHODS
from anisomap.sensor_map import SensorMap
from anisomap.wording import join_items

UNKNOWN = "\N{EN DASH}"
_AGREEMENT = ((0.98, "very closely"), (0.9, "closely"), (0.6, "roughly"), (-1.0, "only weakly"))

_MOST_ROWS = 2000  # of the table: a browser takes long to lay out more

_COARSE = 1.0  # sensor spacings: a sensor so far off stands where another should


@dataclass(frozen=True)
class Fact:
    """A number with its name, and what it means."""

    name: str
    value: str
    meaning: str = ""


@dataclass(frozen=True)
class Cell:
    """An entry of a table: what it shows, and what it is sorted by (None comes last)."""

    text: str
    key: str | float | None = None


@dataclass(frozen=True)
class Row:
    """What there is to say of one sensor."""

    name: str
    status: str
    reason: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class SensorTable:
    """Sensors: those with problems first, in the order of the map otherwise.

    Attributes
    ----------
    columns : tuple of Fact
        Titles of the cells, with what they mean; name, status and reason come before them.
    rows : tuple of Row
        One a sensor; of very many sensors, the first.
    counts : str
        How many sensors have which status.
    n_sensors : int
        How many there are, listed or not.
    """

    columns: tuple[Fact, ...]
    rows: tuple[Row, ...]
    counts: str
    n_sensors: int

    @property
    def n_problems(self) -> int:
        """Number of sensors that are listed and not ok."""
        return sum(row.status != "ok" for row in self.rows)


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """Write a number with so many significant digits; a dash if there is none."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    rounded = float(f"{value:.{digits}g}")
    if 1000 <= abs(rounded) < 1e7:  # written out, where "g" would begin to write exponents
        decimals = max(0, digits - len(str(int(abs(rounded)))))
        text = f"{rounded:.{decimals}f}"
    else:
        text = f"{rounded:.{digits}g}"
    return f"{text} {unit}".strip()


def verdict(sensor_map: SensorMap, score: Score | None) -> list[str]:
    """Say how good the map is: the first sentence is the headline."""
    sentences = _verdict(sensor_map, score)
    if sensor_map.approximate:
        sentences.append("This map is approximate: not all pairs of sensors were compared.")
    return sentences


def _verdict(sensor_map: SensorMap, score: Score | None) -> list[str]:
    placed = int(sensor_map.placed.sum())
    if score is None:
        trust = (
            "How true the map is cannot be told from the readings alone."
            if math.isnan(sensor_map.confidence)
            else f"Confidence {confidence_in_words(sensor_map.confidence)}."
        )
        return [
            f"{placed} of {sensor_map.n_sensors} sensors are placed. {trust}",
            f"This map is known up to {sensor_map.known_up_to}.",
        ]
    r = score.mantel.r
    chance = score.mantel.quantiles().get(0.95)
    if chance is not None and r <= chance:
        headline = (
            f"This map is no better than chance: Mantel r {r:.3f}, and one random labelling of "
            f"the sensors in twenty reaches {chance:.3f}."
        )
    else:
        how = next(word for least, word in _AGREEMENT if r >= least)
        headline = f"Distances on this map follow the true ones {how}: Mantel r {r:.3f}."
        if score.rms_in_spacings > _COARSE:
            headline += " Its neighbourhoods cannot be relied on."
    error = number(score.rms, unit=score.units)
    mirrored = "a mirror image" if score.alignment.reflected else "no mirror image"
    sentences = [headline]
    if chance is not None and r > chance:
        sentences.append(
            f"If the sensors' labels meant nothing, it would stay below {chance:.3f} in 95 % of "
            f"cases ({len(score.mantel.null)} random labellings)."
        )
    sentences += [
        f"Sensors lie {error} from their true places (root mean square), which is "
        f"{number(score.rms_in_spacings, 2)} times the usual distance between neighbours.",
        f"This map is known up to {sensor_map.known_up_to}. Here all of these were fitted to "
        f"the truth, and the best fit was {mirrored}.",
    ]
    return sentences


def facts(sensor_map: SensorMap, score: Score | None) -> list[Fact]:
    """List the numbers behind the verdict."""
    placed = int(sensor_map.placed.sum())
    found = []
    if score is not None:
        null = score.mantel.quantiles()
        found += [
            Fact(
                "Mantel r",
                f"{score.mantel.r:.3f}",
                "correlation of the distances on the map with the true ones; 1 is best",
            ),
            Fact(
                "Null, 95 %",
                f"{null[0.95]:.3f}" if null else UNKNOWN,
                f"what random labels reach; median {number(null[0.5], 1)}, "
                f"p = {number(score.mantel.p_value, 2)}"
                if null
                else "was not computed",
            ),
            Fact(
                "RMS error",
                number(score.rms, unit=score.units),
                "after the best rotation, translation, scale and mirror image",
            ),
            Fact(
                "In spacings",
                number(score.rms_in_spacings, 2),
                f"the same in units of the median sensor spacing, "
                f"{number(score.spacing, unit=score.units)}",
            ),
            Fact(
                "Neighbours kept",
                f"{score.neighbours_kept:.0%}",
                "share of the nearest true neighbours that are nearest on the map",
            ),
        ]
    found += [
        Fact(
            "Confidence",
            number(sensor_map.confidence, 2),
            "Mantel r that is expected of a map as repeatable as this one, whatever the truth",
        ),
        Fact("Placed", f"{placed} of {sensor_map.n_sensors}", "sensors that are on the map"),
        Fact(
            "Stress-1",
            number(sensor_map.stress),
            "misfit between the map and the distances it was made from; 0 is a perfect fit",
        ),
    ]
    return found


def alternative_text(sensor_map: SensorMap, score: Score | None) -> str:
    """Say what the picture shows to those who cannot see it."""
    placed = int(sensor_map.placed.sum())
    if score is None:
        lines = ", neighbours joined by lines" if placed <= MOST_JOINED else ""
        return f"The map of {placed} sensors{lines}."
    joined = ", with true neighbours joined in both" if placed <= MOST_JOINED else ""
    return (
        f"Left, the true places of {len(score.sensors)} sensors; in the middle, the map fitted to "
        f"them{joined}; right, distances on the map against true "
        f"distances, which correlate with Mantel r {score.mantel.r:.3f}."
    )


def cautions(
    sensor_map: SensorMap, score: Score | None, summary: RecordingSummary | None
) -> list[str]:
    """List every reason to doubt the map, each once."""
    notes = [*sensor_map.notes, *warn_of_pieces(sensor_map)]
    unplaced = [shown(sensor_map.names[i]) for i in np.flatnonzero(~sensor_map.placed)]
    if unplaced and score is None:
        notes.append(f"not on the map: {join_items(unplaced, 12)}")
    if score is not None:
        notes += score.notes
        if score.rms_in_spacings > _COARSE:
            notes.append(
                f"sensors are {number(score.rms_in_spacings, 2)} spacings off: the map shows the "
                "overall shape, but not which sensors are neighbours"
            )
    notes += summary.warnings if summary is not None else ()
    return list(dict.fromkeys(shown(note[:1].upper() + note[1:]) for note in notes))


def find_statuses(sensor_map: SensorMap, health: Sequence[SensorHealth]) -> tuple[str, ...]:
    """Tell the health of every sensor of the map: as judged, or else as the map has it."""
    judged = {sensor.name: sensor.status for sensor in health}
    own = zip(sensor_map.names, sensor_map.health, strict=True)
    return tuple(shown(judged.get(name, status)) for name, status in own)


def sensor_table(
    sensor_map: SensorMap, score: Score | None, health: Sequence[SensorHealth]
) -> SensorTable:
    """Tabulate the sensors, those with problems first."""
    judged = {sensor.name: sensor for sensor in health}
    statuses = find_statuses(sensor_map, health)
    errors = {} if score is None else dict(zip(score.sensors, score.alignment.errors, strict=True))
    columns = []
    if len(sensor_map.component_sizes) > 1 or not sensor_map.placed.all():
        columns.append(Fact("Piece", "", "which separate piece of the map it is in"))
    if score is not None:
        unit = f" ({score.units})" if score.units else ""
        columns.append(Fact(f"Error{unit}", "", "distance from its true place"))
    columns += _MEASURED if health else ()
    rows = []
    ill_first = sorted(range(len(statuses)), key=lambda i: statuses[i] == "ok")
    for i in ill_first[:_MOST_ROWS]:
        name = sensor_map.names[i]
        cells = []
        if columns and columns[0].name == "Piece":
            piece = int(sensor_map.component[i]) + 1
            cells.append(Cell(str(piece), piece) if piece else Cell("not placed"))
        if score is not None:
            cells.append(_numeric(errors.get(i)))
        sensor = judged.get(name)
        if health:
            cells += _measurements(sensor)
        reason = "" if sensor is None else shown(sensor.reason)
        rows.append(Row(shown(name), statuses[i], reason, tuple(cells)))
    counts = ", ".join(f"{statuses.count(status)} {status}" for status in sorted(set(statuses)))
    return SensorTable(tuple(columns), tuple(rows), counts, len(statuses))


def contents(summary: RecordingSummary | None) -> list[Fact]:
    """List what the recording held; nothing if that is not known."""
    if summary is None:
        return []
    rate = number(summary.rate_hz, 4, "Hz") if summary.rate_hz else "not known"
    duration = number(summary.duration, 4, "s") if summary.duration is not None else "not known"
    return [
        Fact("Frames", str(summary.n_frames)),
        Fact("Sensors", str(summary.n_sensors), f"{summary.n_constant} of them never vary"),
        Fact("Rate", rate),
        Fact("Duration", duration),
        Fact("Readings", f"{number(summary.minimum, 4)} to {number(summary.maximum, 4)}"),
        Fact("Zeros", f"{summary.share_of_zeros:.1%}", "share of all readings"),
        Fact("Distinct values", str(summary.distinct_values), "median a sensor"),
        Fact("Missing", str(summary.missing), "readings that are NaN or infinite"),
    ]


def provenance(sensor_map: SensorMap, score: Score | None) -> list[Fact]:
    """List what it takes to make the map again."""
    method = sensor_map.method or "not recorded"
    summary = METHODS[method].summary if method in METHODS else ""
    found = [
        Fact("method", shown(method), summary),
        Fact("dimensions", str(sensor_map.dimensions)),
        Fact("units of the map", shown(sensor_map.units)),
    ]
    if score is not None:
        found.append(Fact("labellings of the null", str(len(score.mantel.null))))
    return found + [
        Fact(shown(name), shown(str(value))) for name, value in sensor_map.provenance.items()
    ]


_MEASURED = (
    Fact("Least", "", "least reading"),
    Fact("Greatest", "", "greatest reading"),
    Fact("Values", "", "how many different values it read"),
    Fact("Active", "", "share of frames beyond rest"),
    Fact("Contacts", "", "how many separate times it went beyond rest"),
    Fact("Lag-1 r", "", "correlation of readings with those one frame later; noise has none"),
    Fact("Best match", "", "highest Pearson r with another sensor"),
)


def _measurements(sensor: SensorHealth | None) -> list[Cell]:
    if sensor is None:
        return [Cell(UNKNOWN)] * len(_MEASURED)
    return [
        _numeric(sensor.minimum),
        _numeric(sensor.maximum),
        Cell(str(sensor.distinct), sensor.distinct),
        Cell(f"{sensor.active:.1%}" if math.isfinite(sensor.active) else UNKNOWN, sensor.active),
        Cell(str(sensor.contacts), sensor.contacts),
        _numeric(sensor.lag_correlation, 2),
        _numeric(sensor.best_match, 2),
    ]


def _numeric(value: float | None, digits: int = 3) -> Cell:
    if value is None or not math.isfinite(value):
        return Cell(UNKNOWN)
    return Cell(number(value, digits), float(value))
