"""What the paper leaves open: accuracy, and its statements, over the values of each setting."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.errors import InputError
from anisomap.paper.accuracy import case_tables, patch_tables, tables_of
from anisomap.paper.cases import BOMBARDED, CASES, PATCH, Case
from anisomap.paper.claims import CLAIMS, Evidence
from anisomap.paper.experiment import (
    Picture,
    Row,
    Settings,
    Table,
    Tables,
    by,
    curve,
    experiment,
)

_ROLLING = CASES[len(BOMBARDED) :]
_CYLINDER = CASES[-1:]


@dataclass(frozen=True)
class Setting:
    """A setting that the paper leaves open, and the values to try.

    name: Of `anisomap.paper.cases.OPEN`.
    label: Label of the x axis.
    description: What the paper says about it.
    values: In ascending order.
    default: Value in all other experiments.
    """

    name: str
    label: str
    description: str
    values: tuple[float, ...]
    default: float
    cases: tuple[Case, ...] = CASES

    def tables(self, settings: Settings, value: float) -> dict[str, Table]:
        """Score the runs of a few seeds at a value; too few contacts give no table."""
        changed = replace(settings, changes=((*settings.changes, (self.name, value))))
        found: dict[str, Table] = {}
        for case in self.cases:
            try:
                made = (
                    patch_tables(changed, whole=False)
                    if case == PATCH
                    else case_tables(case, changed, settings.few_seeds, whole=False)
                )
                found |= {table.name: table for table in made}
            except InputError:  # too few contacts for a map, which is a valid result
                continue
        return found


_COLUMNS = {
    "run": "body and scenario",
    "value": "value of the setting",
    "method": "method",
    "seed": "seed of the run",
    "mantel_r": "Mantel r of the map with the true positions",
}
_STATEMENTS = {
    "claim": "claim of the paper",
    "value": "value of the setting",
    "held": "cases in which the criterion is met",
    "cases": "cases of these runs",
}


def explore(setting: Setting, settings: Settings, _: Tables) -> Iterator[Picture | Table]:
    """Draw the accuracy at all values of a setting, and check the claims that it affects."""
    rows: list[Row] = []
    statements: list[Row] = []
    values = setting.values[::3] if settings.quick else setting.values
    for value in values:
        tables = setting.tables(settings, value)
        if not tables:
            continue
        rows += [
            (row["run"], value, row["method"], row["seed"], row["mantel_r"])
            for row in tables_of("scores", tables).records()
        ]
        for claim in CLAIMS:
            held = [claim.holds(found) is True for found in claim.check(Evidence(tables)).values()]
            if held:
                statements.append((claim.text, value, sum(held), len(held)))
    name = f"setting-{setting.name.replace('.', '-').replace('_', '-')}"
    scores = Table(f"{name}-scores", "Scores of all runs.", _COLUMNS, rows, shown=False)
    panels: list[CurvePanel] = []
    for run, of_run in by(scores.records(), "run").items():
        curves = {method: curve(found, "value") for method, found in by(of_run, "method").items()}
        x = next(iter(curves.values()))[0]
        drawn = {method: y for method, (_x, y) in curves.items()}
        panels.append(CurvePanel(run.replace("-", " "), x, drawn, setting.default))
    label, seeds = setting.label, settings.few_seeds
    figure = curves_figure(
        f"Mantel r by {label}", panels, x_label=label, logarithmic=min(values) > 0
    )
    caption = (
        f"Mantel r; dots: runs (seeds {seeds[0]} to {seeds[-1]}), lines: means. Dotted line: value "
        "in all other experiments."
    )
    yield Picture(name, caption, figure)
    checked = Table(f"{name}-statements", "", _STATEMENTS, statements, shown=False)
    columns = {"claim": _STATEMENTS["claim"]} | {
        f"{value:g}": f"cases in which the criterion is met, at a value of {value:g}"
        for value in values
    }
    shown: list[Row] = []
    for text, found in by(checked.records(), "claim").items():
        cells = {row["value"]: f"{row['held']} of {row['cases']}" for row in found}
        shown.append((text, *(cells.get(value, "") for value in values)))
    caption = f"The paper's statements by {label}, on these runs alone."
    yield Table(name, caption, columns, shown)
    yield scores


SETTINGS = (
    Setting(
        "frames",
        "number of frames",
        "The paper's runs have 2,000 frames. Longer runs show how much accuracy more data gives.",
        (250, 500, 1000, 2000, 4000, 8000),
        2000,
    ),
    Setting(
        "mu",
        "mu",
        "The paper adds mu times the smallest positive similarity to each similarity before taking "
        "the reciprocal. It gives no value for mu.",
        (0.001, 0.01, 0.1, 1, 10, 100),
        1,
    ),
    Setting(
        "bombardment.detection_radius",
        "detection radius under bombardment, m",
        "The detection radius of the sensors is in the paper's Text S1, which was not available to "
        "us. Bodies extend 1 m from their centre.",
        (0.2, 0.25, 0.3, 0.35, 0.44, 0.55, 0.66),
        0.44,
        BOMBARDED,
    ),
    Setting(
        "bombardment.n_balls",
        "number of balls",
        "The paper's number of balls is not known.",
        (5, 10, 20, 40, 80, 160),
        40,
        BOMBARDED,
    ),
    Setting(
        "bombardment.one_sided",
        "sensors feel what is in front only: 1, all in range: 0",
        "The paper's sensors register all that enters their sphere of detection. On thin bodies, a "
        "third of the readings come from balls behind the surface, which real skin does not feel.",
        (0, 1),
        0,
        BOMBARDED,
    ),
    Setting(
        "locomotion.detection_radius",
        "detection radius of rolling bodies, m",
        "As under bombardment, the paper's detection radius was not available to us.",
        (0.15, 0.2, 0.25, 0.3, 0.35, 0.44),
        0.44,
        _ROLLING,
    ),
    Setting(
        "locomotion.correlation",
        "correlation length of the ground, m",
        "The paper says that the terrain is uneven. Where its bumps are longer than the distance "
        "between sensors, a whole line of a cylinder is pressed alike.",
        (0.25, 0.35, 0.5, 1, 2),
        0.5,
        _ROLLING,
    ),
    Setting(
        "cylinder.length",
        "length of the cylinder over its radius",
        "The paper shows a cylinder of 10 columns of 6 sensors and gives no lengths.",
        (2, 3, 4, 6),
        4,
        (CASES[1], *_CYLINDER),
    ),
    Setting(
        "patch.mean_span",
        "mean length of a saturation, frames",
        "Sensor 30 had a tendency to saturate intermittently; the paper does not state how often. "
        "With a gap of 100 frames on average, it is saturated for a share of span / (100 + span).",
        (5, 20, 50, 100, 200),
        20,
        (PATCH,),
    ),
)
for _setting in SETTINGS:
    _name = _setting.name.replace(".", "-").replace("_", "-")
    experiment(
        f"setting-{_name}",
        f"Left open: {_setting.label}",
        _setting.description,
        cost=600,
    )(partial(explore, _setting))
