"""What the paper leaves open: which of its statements hold at which settings."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.charts import CountPanel, counts_figure
from anisomap.errors import InputError
from anisomap.paper.accuracy import case_tables, patch_tables
from anisomap.paper.cases import BOMBARDED, CASES, PATCH, Case
from anisomap.paper.claims import CLAIMS, Evidence
from anisomap.paper.experiment import INFERRED, Picture, Row, Settings, Table, Tables, experiment
from anisomap.recording import Recording

_KINDS = ("scores", "ablations", "responses", "pairs", "failures")
_LENGTH, _RADIUS = "cylinder.length", "detection_radius"
_REAL = "runs-real"
_CONTROL, _ROLLING = Case("cylinder"), Case("cylinder", "locomotion")

Counts = NDArray[np.int_]
"""Of each claim: cases that hold, cases that can be judged, and cases at chance."""

Point = tuple[tuple[str, float], ...]
"""Values of settings."""

_LESS_MU: Point = (("mu", 0.1),)


@dataclass(frozen=True)
class Group:
    """Runs that share settings.

    values: Of settings that are combined.
    others: Further settings; what they leave open is as inferred.
    """

    name: str
    cases: tuple[Case, ...]
    values: Mapping[str, tuple[float, ...]]
    others: tuple[Point, ...]

    def points(self, settings: Settings) -> list[Point]:
        """All defaults, a change of the first setting alone, all combinations, and others."""
        found = [
            tuple(zip(self.values, each, strict=True)) for each in product(*self.values.values())
        ]
        inferred = {name: INFERRED[name] for name in self.values}
        others = [tuple((inferred | dict(other)).items()) for other in self.others]
        all_points = [(), found[0][:1], *found, *others]
        return all_points[:1] if settings.quick else all_points


GROUPS = (
    Group(
        "bombardment",
        BOMBARDED,
        {_LENGTH: (2,), f"bombardment.{_RADIUS}": (0.44, 0.55, 0.3)},
        (
            ((f"bombardment.{_RADIUS}", 0.44), ("bombardment.one_sided", 1)),
            (("bombardment.n_balls", 20),),
            (("bombardment.n_balls", 80),),
            _LESS_MU,
        ),
    ),
    Group(
        "locomotion",
        CASES[len(BOMBARDED) :],
        {
            _LENGTH: (2,),
            "locomotion.correlation": (0.5, 0.3),
            f"locomotion.{_RADIUS}": (0.44, 0.25, 0.15),
        },
        (_LESS_MU,),
    ),
    Group(
        "patch",
        (PATCH,),
        {
            "rubbing.hand_size": (0.026,),
            f"rubbing.{_RADIUS}": (0.022,),
            "patch.mean_span": (20, 100),
        },
        (_LESS_MU,),
    ),
)


def _label(point: Point) -> str:
    named = [f"{name.rpartition('.')[2]} {value:g}" for name, value in point]
    return ", ".join(named).replace("_", " ") or "defaults"


def _length(point: Point) -> float:
    return dict(point).get(_LENGTH, 4)


def _own(case: Case, point: Point) -> Point:
    """Return the settings that affect a case."""
    own = ("mu", case.scenario, "patch" if case == PATCH else case.body)
    return tuple((name, value) for name, value in point if name.partition(".")[0] in own)


class _Narrowed(Case):
    """A case whose recordings are those of the largest detection radius, less the difference.

    A reading is the depth to which an object enters the sphere of detection: one run of the
    physics serves all radii.
    """

    def record(self, settings: Settings, seed: int, n_frames: int | None = None) -> Recording:
        name = f"{self.scenario}.{_RADIUS}"
        if name not in settings.chosen:
            return super().record(settings, seed, n_frames)
        widest = max(value for group in GROUPS for value in group.values.get(name, (0.0,)))
        found = super().record(
            replace(settings, changes=(*settings.changes, (name, widest))), seed, n_frames
        )
        less = found.readings.dtype.type(widest - settings.chosen[name])
        return replace(found, readings=np.maximum(found.readings - less, 0))


def _explore(group: Group, case: Case, settings: Settings, _: Tables) -> Iterator[Table]:
    """Score the runs of a case at each of its settings; too few contacts give no rows."""
    columns: dict[str, Mapping[str, str]] = {}
    rows: dict[str, list[Row]] = {}
    for point in dict.fromkeys(_own(case, point) for point in group.points(settings)):
        changed = replace(settings, inferred=(), changes=(*settings.changes, *point))
        narrowed = _Narrowed(case.body, case.scenario)
        try:
            found = (
                [*patch_tables(changed)]
                if case == PATCH
                else [*case_tables(narrowed, changed, settings.few_seeds)]
            )
        except InputError:  # too few contacts for a map, which is a valid result
            continue
        for table in found:
            columns[table.name] = table.columns
            rows.setdefault(table.name, []).extend((_label(point), *row) for row in table.rows)
    for name, each in rows.items():
        described = {"settings": "settings that affect these runs", **columns[name]}
        yield Table(name, "Scores of all runs.", described, each, shown=False)


for _group in GROUPS:
    for _case in _group.cases:
        experiment(f"settings-{_case.name}", cost=400)(partial(_explore, _group, _case))


def _counts(tables: Tables) -> Counts:
    """Check all claims on some runs."""
    found = []
    for claim in CLAIMS:
        cases = claim.check(Evidence(tables)).values()
        judged = [one for one in cases if one is not None]
        held = sum(one.holds is True for one in judged)
        found.append((held, len(judged), len(cases) - len(judged)))
    return np.array(found)


def _at(tables: Tables, case: Case, point: Point) -> dict[str, Table]:
    """Return the tables of a case at a setting."""
    label, name = _label(_own(case, point)), "patch" if case == PATCH else case.name
    found = {}
    for kind in _KINDS:
        table = tables.get(f"{kind}-{name}")
        if table is not None:
            rows = [row[1:] for row in table.rows if row[0] == label]
            columns = {key: text for key, text in table.columns.items() if key != "settings"}
            found[table.name] = Table(table.name, "", columns, rows)
    return found


def _of(tables: Tables, cases: Sequence[Case], point: Point) -> dict[str, Table]:
    return {name: table for case in cases for name, table in _at(tables, case, point).items()}


def _across(tables: Tables, bombarded: Point, rolling: Point) -> Counts:
    """Count the cases that compare the rolling with the bombarded cylinder."""
    one, other = _at(tables, _CONTROL, bombarded), _at(tables, _ROLLING, rolling)
    return _counts({**one, **other}) - _counts(one) - _counts(other)


SETTINGS_COLUMNS = {
    "runs": "runs that the settings affect",
    "settings": "values; all others are usual",
    "claim": "claim of the paper",
    "held": "cases that hold",
    "judged": "cases that can be judged",
    "at_chance": "cases whose maps are at chance",
}
BEST_COLUMNS = {
    "claims": "claims of which all cases hold that can be judged",
    "cases": "cases that hold",
    **{group.name: f"settings of {group.name}" for group in GROUPS},
}
_N_BEST = 5
_LINE = 80  # characters of a line of a claim in the figure


@experiment(
    "settings",
    "What the paper leaves open",
    "The paper gives no detection radius, proportions of the cylinder, ground, number of balls, mu "
    "or share of saturation. Here its statements are checked at combinations of these settings, "
    "with few seeds each. Settings affect some of the runs only: a claim holds in full at a "
    "combination if all of its cases hold, of all runs. The rolling cylinder is compared with a "
    "bombarded one of the same length.",
    needs=(*(f"settings-{case.name}" for group in GROUPS for case in group.cases), _REAL),
)
def settings_map(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw which statements hold at which settings, and find the settings at which most do."""
    counts = {
        group.name: {
            point: _counts(_of(tables, group.cases, point)) for point in group.points(settings)
        }
        for group in GROUPS
    }
    bombardment, locomotion, patch = counts.values()
    across = {
        (b, r): _across(tables, b, r)
        for b, r in product(bombardment, locomotion)
        if _length(b) == _length(r)
    }
    usual = {_length(b): b for b in reversed(bombardment)}
    shown = counts | {
        "locomotion": {r: n + across[usual[_length(r)], r] for r, n in locomotion.items()}
    }
    texts = [claim.text for claim in CLAIMS]
    panels = [
        CountPanel(name, [*map(_label, found)], *np.array([*found.values()]).transpose(2, 1, 0)[:2])
        for name, found in shown.items()
    ]
    seeds = settings.few_seeds
    caption = (
        f"Cases of each claim that hold, of those that can be judged (seeds {seeds[0]} to "
        f"{seeds[-1]}; five runs of the patch). Frames: all cases hold."
    )
    lines = [textwrap.fill(text, _LINE) for text in texts]
    figure = counts_figure("Statements of the paper by what it leaves open", panels, lines, caption)
    yield Picture("settings", caption, figure)
    rows = [
        (name, _label(point), text, *map(int, count))
        for name, found in shown.items()
        for point, each in found.items()
        for text, count in zip(texts, each, strict=True)
    ]
    yield Table("settings", caption, SETTINGS_COLUMNS, rows, shown=False)
    real = _counts({name: table for name, table in tables.items() if name.endswith("-real")})
    best: list[tuple[int, int, str, str, str]] = []
    for (b, r), compared in across.items():
        for p, of_patch in patch.items():
            if not any("mu" in dict(point) for point in (b, r, p)):  # real skin has one mu
                held, judged, _ = (bombardment[b] + locomotion[r] + compared + of_patch + real).T
                in_full = int(((held == judged) & (held > 0)).sum())
                best.append((in_full, int(held.sum()), _label(b), _label(r), _label(p)))
    caption = "The combinations of settings at which most claims hold, on these seeds."
    best = sorted(best, key=lambda row: row[:2], reverse=True)[:_N_BEST]
    yield Table("settings-best", caption, BEST_COLUMNS, best)
