"""What speaks for each claim of the paper, and what against it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from anisomap.paper.experiment import Tables
from anisomap.paper.experiments.quality import in_groups
from anisomap.paper.runs import FIRST_FAILED_RUN, METHODS

ANISOMAPS = METHODS[:2]
REASONABLE, EXCELLENT = 0.7, 0.9
"""Mantel r from which we call a map reasonable, and excellent: the paper gives no numbers."""

AMONG_BEST = 0.02
ALIKE = 0.05
ISOLATED = 2.0
SPHERICAL = 0.95
_PATCH = ("patch, 2D", "patch, 3D")
_POOR = "cylinder-locomotion"

HOLDS, FAILS, PARTLY = "holds", "does not hold", "holds only for"


@dataclass(frozen=True)
class Evidence:
    """What speaks for a claim.

    Parameters
    ----------
    measured : str
        Numbers, in words.
    held : mapping of str to bool
        By case, whether it held there.
    """

    measured: str
    held: Mapping[str, bool]

    @property
    def verdict(self) -> str:
        """Say whether the claim holds, does not, or what it holds only for."""
        if all(self.held.values()):
            return HOLDS
        if not any(self.held.values()):
            return FAILS
        good = [case for case, held in self.held.items() if held]
        bad = [case for case, held in self.held.items() if not held]
        if len(bad) < len(good):
            return f"{PARTLY} {len(good)} of {len(self.held)}: not for {', '.join(bad)}"
        return f"{PARTLY} {', '.join(good)}"


Rows: TypeAlias = Sequence[dict[str, Any]]
"""Scores of all maps, see `anisomap.paper.experiments.quality.all_scores`."""


def _means(rows: Rows) -> dict[str, dict[str, float]]:
    """Mean Mantel r by group and method."""
    return {
        group: {m: _mean(row["mantel_r"] for row in found if row["method"] == m) for m in METHODS}
        for group, found in in_groups(rows).items()
    }


def reasonable(rows: Rows, _: Tables) -> Evidence:
    """Tell how good r-ANISOMAP's maps are."""
    means = {group: found["r-anisomap"] for group, found in _means(rows).items()}
    return Evidence(_listed(means), {group: r >= REASONABLE for group, r in means.items()})


def best_is_anisomap(rows: Rows, _: Tables) -> Evidence:
    """Tell which method makes the best map of each run in 3D."""
    won: dict[str, list[bool]] = {}
    for group, runs in _in_space(rows).items():
        won[group] = [max(run, key=run.__getitem__) in ANISOMAPS for run in runs]
    shares = {group: float(np.mean(each)) for group, each in won.items()}
    told = "share of runs: " + _listed(shares)
    return Evidence(told, {group: share == 1 for group, share in shares.items()})


def r_among_best(rows: Rows, _: Tables) -> Evidence:
    """Tell how far r-ANISOMAP is behind the best method."""
    behind = {
        group: max(found.values()) - found["r-anisomap"] for group, found in _means(rows).items()
    }
    told = "mean r behind the best: " + _listed(behind)
    return Evidence(told, {group: gap <= AMONG_BEST for group, gap in behind.items()})


def rolling_is_poor(rows: Rows, _: Tables) -> Evidence:
    """Tell how bad the rolling cylinder's maps are beside all others."""
    means = _means(rows)
    others = {m: min(found[m] for group, found in means.items() if group != _POOR) for m in METHODS}
    told = "; ".join(
        f"{m} {means[_POOR][m]:.2f} (elsewhere {others[m]:.2f} or more)" for m in METHODS
    )
    return Evidence(told, {m: means[_POOR][m] < others[m] for m in METHODS})


def axial(_: Rows, tables: Tables) -> Evidence:
    """Tell how compressed the rolling cylinder's maps are along the axis."""
    rows = [row for row in tables["figure-4"].records() if row["scenario"] == "locomotion"]
    told = "; ".join(
        f"{row['method']} {row['local_axial_scale']:.2f} between neighbours, "
        f"{row['axial_scale']:.2f} as a whole"
        for row in rows
    )
    return Evidence(told, {row["method"]: row["local_axial_scale"] < 1 for row in rows})


def flat_is_better(rows: Rows, _: Tables) -> Evidence:
    """Tell what the third dimension costs each method on flat skins."""
    means = _means(rows)
    flat = {"the plane": ("plane-bombardment, 2D", "plane-bombardment"), "the patch": _PATCH}
    told, held = [], {}
    for skin, (in_plane, in_space) in flat.items():
        drops = {m: means[in_plane][m] - means[in_space][m] for m in METHODS}
        told.append(f"{skin}: " + _listed(drops, 3))
        lost = {m for m, drop in drops.items() if drop > AMONG_BEST}
        held[skin] = lost == {"information-distance"}
    return Evidence("mean r in 2D less that in 3D, " + "; ".join(told), held)


def above_null(rows: Rows, _: Tables) -> Evidence:
    """Tell whether maps are better than after random relabelling."""
    held: dict[str, bool] = {}
    margins: list[float] = []
    for row in rows:
        key = f"{row['method']} on {row['group']}"
        held[key] = held.get(key, True) and row["mantel_r"] > row["null_most"]
        margins.append(row["mantel_r"] - row["null_most"])
    told = (
        f"r above the greatest of all relabellings in {sum(m > 0 for m in margins)} of "
        f"{len(margins)} maps; least margin {min(margins):.2f}"
    )
    return Evidence(told, held)


def isolated(_: Rows, tables: Tables) -> Evidence:
    """Tell how far the failing sensor lies from all others."""
    alone = {row["run"]: row["isolation"] for row in _patch_maps(tables)}
    told = "distance to its nearest, over the others': " + _listed(
        {f"run {run}": value for run, value in alone.items()}
    )
    among = [
        row["saturated"]
        for row in tables["failing-sensor"].records()
        if row["method"] == "r-anisomap" and row["dimensions"] == 2 and row["isolation"] < ISOLATED
    ]
    held = {
        "sensor 30 while it is sound": all(
            value < ISOLATED for run, value in alone.items() if run < FIRST_FAILED_RUN
        ),
        "a sensor saturated as often as in Figure 2": all(
            value >= ISOLATED for run, value in alone.items() if run >= FIRST_FAILED_RUN
        ),
        f"a sensor saturated in more than {max(among, default=0.0):.0%} of the frames": True,
    }
    return Evidence(told, held)


def robust(_: Rows, tables: Tables) -> Evidence:
    """Tell what the failing sensor costs."""
    rows = _patch_maps(tables)
    sound = [row["mantel_r"] for row in rows if row["run"] < FIRST_FAILED_RUN]
    failed = {row["run"]: row["mantel_r"] for row in rows if row["run"] >= FIRST_FAILED_RUN}
    told = f"mean r of runs 1 to 3: {_mean(sound):.3f}; " + _listed(
        {f"run {run}": r for run, r in failed.items()}, 3
    )
    return Evidence(told, {f"run {run}": r >= _mean(sound) - ALIKE for run, r in failed.items()})


def spherises(_: Rows, tables: Tables) -> Evidence:
    """Tell how much rounder maps of information distance are than the truth."""
    rows = tables["figure-7"].records()
    told = "spread of radii over the truth's: " + _listed(
        {row["body"]: row["information-distance"] for row in rows}
    )
    held = {
        row["body"]: row["information-distance"] < min(SPHERICAL, row["r-anisomap"]) for row in rows
    }
    return Evidence(told, held)


def bins_do_not_matter(_: Rows, tables: Tables) -> Evidence:
    """Tell what other numbers of bins change."""
    rows = tables["bins"].records()
    changes = {
        m: max(row["largest change"] for row in rows if row["method"] == m) for m in METHODS[1:]
    }
    held = {f"{row['method']} on {row['run']}": row["largest change"] <= ALIKE for row in rows}
    return Evidence("largest change of mean r: " + _listed(changes), held)


def r_means_topology(rows: Rows, _: Tables) -> Evidence:
    """Tell whether maps with a greater r keep more neighbours."""
    names = ("mantel_r", "neighbours_kept")
    by_group: dict[str, bool] = {}
    found: dict[str, float] = {}
    for group, each in in_groups(rows).items():
        first, second = (np.argsort(np.argsort([row[name] for row in each])) for name in names)
        found[group] = float(np.corrcoef(first, second)[0, 1])
        by_group[group] = found[group] > 0.5
    return Evidence("rank correlation of r with neighbours kept: " + _listed(found), by_group)


def senses(_: Rows, tables: Tables) -> Evidence:
    """Tell how good maps of other senses are."""
    best: dict[str, float] = {}
    for sense in ("retina", "cochlea"):
        for row in tables[sense].records():
            case = f"{sense} by {row['method']}"
            best[case] = max(best.get(case, -1.0), row["mantel_r"])
    return Evidence(_listed(best), {case: r >= REASONABLE for case, r in best.items()})


def _in_space(rows: Rows) -> dict[str, list[dict[str, float]]]:
    """Mantel r in 3D by group, run and method."""
    found: dict[str, dict[tuple[str, int], dict[str, float]]] = {}
    for row in rows:
        if row["dimensions"] == 3:
            run = found.setdefault(row["group"], {}).setdefault((row["run"], row["seed"]), {})
            run[row["method"]] = row["mantel_r"]
    return {group: list(runs.values()) for group, runs in found.items()}


def _patch_maps(tables: Tables) -> list[dict[str, Any]]:
    return [
        row
        for row in tables["figure-2"].records()
        if row["method"] == "r-anisomap" and row["dimensions"] == 2
    ]


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _listed(values: Mapping[str, float], digits: int = 2) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in values.items())
