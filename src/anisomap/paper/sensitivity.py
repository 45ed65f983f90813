"""Sensitivity of the paper's statements to settings that the paper does not specify."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from anisomap.drawing.figures.charts import CountPanel, counts_figure
from anisomap.errors import InputError
from anisomap.paper.accuracy import case_tables, patch_tables
from anisomap.paper.cases import BOMBARDED, CASES, PATCH, Case
from anisomap.paper.claims import CLAIMS, OWN, Evidence, scope_of
from anisomap.paper.experiment import Picture, Row, Settings, Table, Tables, by, experiment, joined

_RADIUS = "detection_radius"

# Numeric bounds for the paper's sentences about settings, chosen here:
SPARSE = 2 / 3
"""Share of zeros of each run: "most of the signals essentially vanish most of the time"."""
SHORT, SMALL = 0.35, 0.2
"""Largest detection radius of "short-range" sensors, half of the smallest body; largest radius of
"small balls", below half of the distance between sensors of the sphere; in m."""

Point = tuple[tuple[str, float], ...]
"""Values of settings."""


@dataclass(frozen=True)
class Group:
    """Runs with common settings, and the points of settings at which they are simulated."""

    name: str
    cases: tuple[Case, ...]
    points: tuple[Point, ...]


def _points(*names: str, values: Sequence[tuple[float, ...]]) -> tuple[Point, ...]:
    """Combine names and values of settings; values of the last settings may be absent."""
    return tuple(tuple(zip(names, each, strict=False)) for each in values)


_BALLS = (
    *((0.3, 0.55, 0.05), (0.2, 0.35, 0.05), (0.2, 0.35, 0.1)),
    *((0.2, 0.35, 0.2), (0.2, 0.25, 0.2), (0.2, 0.35, 0.1, 1)),
)
GROUPS = (
    Group(
        "bombardment",
        BOMBARDED,
        _points(
            "bombardment.ball_radius",
            f"bombardment.{_RADIUS}",
            "bombardment.frame_interval",
            "sphere.random",
            values=_BALLS,
        ),
    ),
    Group(
        "locomotion",
        (*CASES[len(BOMBARDED) :], Case("cylinder")),
        _points(
            "locomotion.correlation",
            f"locomotion.{_RADIUS}",
            "locomotion.roughness",
            values=((0.5, 0.44), (0.25, 0.25), (0.25, 0.25, 0.04), (0.12, 0.25)),
        ),
    ),
    Group(
        "patch",
        (PATCH,),
        _points(
            "rubbing.hand_size",
            f"rubbing.{_RADIUS}",
            values=((0.026, 0.022), (0.026, 0.004), (0.017, 0.004), (0.017, 0.002)),
        ),
    ),
)


def _label(point: Point) -> str:
    return ", ".join(f"{key.split('.')[1].replace('_', ' ')} {value:g}" for key, value in point)


def obeys(point: Point, zeros: float) -> bool:
    """Return whether settings, and the resulting share of zeros, agree with the paper."""
    values = {name.partition(".")[2]: value for name, value in point}
    is_local = values.get(_RADIUS, 0) <= SHORT and values.get("ball_radius", 0) <= SMALL
    return is_local and zeros >= SPARSE


def count_rows(group: Group, point: Point, tables: Tables) -> Iterator[Row]:
    """Check all claims on the paper's own cases; yield rows of `SETTINGS_COLUMNS`."""
    scores = [
        tables[f"scores-{case.name}" if case != PATCH else "scores-patch"] for case in group.cases
    ]
    zeros = min(row["zeros"] for table in scores for row in table.records())
    stated = (group.name, _label(point), zeros, "yes" if obeys(point, zeros) else "no")
    for claim in CLAIMS:
        found = claim.check(Evidence(tables))
        own = [one for case, one in found.items() if scope_of(case) == OWN]
        held = [one.holds for one in own if one is not None]
        yield (*stated, claim.text, held.count(True), len(held), len(own) - len(held))


def _explore(group: Group, number: int, settings: Settings, _: Tables) -> Iterator[Table]:
    """Check all claims at a point, in previews at the first; too few contacts give no rows."""
    point, seeds = group.points[number], settings.few_seeds
    tables: dict[str, Table] = {}
    changed = replace(settings, changes=(*settings.changes, *point))
    rows: list[Row] = []
    try:
        for case in () if settings.quick and number else group.cases:
            if case == PATCH:
                tables |= {table.name: table for table in patch_tables(changed, len(seeds))}
            else:
                tables |= {table.name: table for table in case_tables(case, changed, seeds)}
        rows += count_rows(group, point, tables) if tables else ()
    except InputError:  # too few contacts for a map, which is a valid result
        pass
    name = f"settings-{group.name}-{number}"
    yield Table(name, "Cases that hold.", SETTINGS_COLUMNS, rows, shown=False)


SETTINGS_COLUMNS = {
    "runs": "runs that the settings affect",
    "settings": "values; all others are usual",
    "zeros": "lowest share of zeros of the readings of a run",
    "obeys": f"whether at least {SPARSE:.0%} of the readings are zero, sensors reach at most "
    f"{SHORT:g} m, and balls have at most {SMALL:g} m",
    "claim": "claim of the paper",
    "held": "cases that hold",
    "judged": "cases that can be judged",
    "at_chance": "cases whose maps are at chance",
}
for _group in GROUPS:
    for _number in range(len(_group.points)):
        experiment(f"settings-{_group.name}-{_number}", cost=150)(
            partial(_explore, _group, _number)
        )


@experiment(
    "settings",
    "What the paper leaves open",
    "The paper gives no detection radius, size of its balls, proportions of the cylinder, ground, "
    "frames per second or size of the palm. It says that most signals vanish most of the time, "
    "that sensors are short-ranged, and that balls are small: settings with fewer than two thirds "
    "of zeros, sensors that reach further than .35 m or balls of more than .2 m contradict it, and "
    "cannot be chosen. Its statements are checked with few seeds at each point, on the paper's own "
    "cases. The rolling runs have the bombarded cylinder beside them, as their control.",
    needs=tuple(f"settings-{one.name}-{n}" for one in GROUPS for n in range(len(one.points))),
)
def settings_map(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw the statements that hold at each setting."""
    seeds = settings.few_seeds
    caption = (
        f"Cases of each claim that hold, among those that can be judged (seeds {seeds[0]} to "
        f"{seeds[-1]}). Frames: all cases hold. (x): settings that contradict the paper."
    )
    counts = joined(tables, tables, "settings", caption)
    panels = []
    for name, of_group in by(counts.records(), "runs").items():
        points = by(of_group, "settings")
        labels = [
            label + ("" if rows[0]["obeys"] == "yes" else " (x)") for label, rows in points.items()
        ]
        held, judged = (
            np.array([[row[key] for row in rows] for rows in points.values()]).T
            for key in ("held", "judged")
        )
        panels.append(CountPanel(name, labels, held, judged))
    lines = [textwrap.fill(claim.text, 80) for claim in CLAIMS]
    figure = counts_figure("Statements of the paper by what it leaves open", panels, lines, caption)
    yield Picture("settings", caption, figure)
    yield counts
