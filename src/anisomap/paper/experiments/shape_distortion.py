"""Figures 4 and 7: axial compression and spherisation."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from anisomap.drawing.figures.gallery import gallery_figure, map_panel, truth_panel
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.cases import BOMBARDED, METHODS, Case, find_case, true_positions
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.map_scores import map_and_score

AXIAL_COLUMNS = {
    "scenario": "scenario of the cylinder",
    "method": "method",
    "mantel_r": "Mantel r with the true positions",
    "axial_scale": "axial scale divided by radial scale of the map aligned with the true "
    "positions; below 1: compressed along the axis",
    "local_axial_scale": "distance of axial neighbours divided by distance of circumferential "
    "neighbours, relative to the true ratio; below 1: compressed along the axis",
}
ROUNDNESS_COLUMNS = {
    "body": "bombarded body",
    "true spread": "spread of radii of the true positions: standard deviation divided by mean of "
    "the distances from the centroid; 0 for a sphere",
    **{
        method: f"mean spread of radii of the maps by {method}, relative to the true spread: 1 is "
        "correct, 0 is a sphere"
        for method in METHODS
    },
}
_NOTE = "A sensor has the same colour in all panels; lines join true neighbours."


def figure_4(settings: Settings, tables: Tables) -> Outcome:
    """Draw the rolling cylinder; measure its axial compression, and that of the bombarded one."""
    rolling, bombarded = find_case("cylinder", "locomotion"), find_case("cylinder")
    seed = settings.picked_seed(rolling.name)
    recording = rolling.record(settings, seed)
    truth = true_positions(recording)
    panels = [truth_panel("true positions", truth, units=recording.units)]
    for method in METHODS:
        scored = map_and_score(recording, method, 3)
        panels.append(map_panel(scored.title, scored.sensor_map, scored.score, truth))
    figure = gallery_figure(f"Figure 4. Cylinder, locomotion, seed {seed}", panels, 5, _NOTE)
    caption = f"Maps of the rolling cylinder by all methods. Randomly picked seed: {seed}."
    rows = tuple(
        row
        for case in (rolling, bombarded)
        for row in _axial_rows(case, tables[f"scores-{case.name}"])
    )
    table = Table("figure-4", "Mean axial scale of the maps of the cylinder.", AXIAL_COLUMNS, rows)
    return Outcome((Picture("figure-4", caption, figure),), (table,))


def figure_7(settings: Settings, tables: Tables) -> Outcome:
    """Draw maps by information distance; measure how close all maps are to a sphere."""
    truths, maps = [], []
    for body in ("cylinder", "y-shape", "plane"):
        case = find_case(body)
        recording = case.record(settings, settings.picked_seed(case.name))
        truth = true_positions(recording)
        scored = map_and_score(recording, "information-distance", 3)
        truths.append(truth_panel(body, truth, units=recording.units))
        maps.append(map_panel(scored.title, scored.sensor_map, scored.score, truth))
    figure = gallery_figure(
        "Figure 7. Maps by information distance (bottom) and true positions (top)",
        [*truths, *maps],
        3,
        _NOTE,
    )
    rows = tuple(
        _roundness_row(case, tables[f"scores-{case.name}"])
        for case in BOMBARDED
        if case.body != "sphere"
    )
    caption = "Typical maps by information distance: cylinder, Y-shape, plane (seeds of Figure 1)."
    table = Table(
        "figure-7", "Spread of radii relative to the true spread.", ROUNDNESS_COLUMNS, rows
    )
    return Outcome((Picture("figure-7", caption, figure),), (table,))


def _axial_rows(case: Case, scores: Table) -> Iterable[Row]:
    """Average over the seeds; yield one row per method."""
    rows = [row for row in scores.records() if row["bins"] == DEFAULT_BINS]
    for method in METHODS:
        found = [row for row in rows if row["method"] == method]
        names = ("mantel_r", "axial_scale", "local_axial_scale")
        means = (float(np.mean([row[name] for row in found])) for name in names)
        yield (case.scenario, method, *means)


def _roundness_row(case: Case, scores: Table) -> Row:
    rows = [
        row for row in scores.records() if row["bins"] == DEFAULT_BINS and row["dimensions"] == 3
    ]
    truth = rows[0]["true_spread_of_radii"]
    ratios = [
        float(np.mean([row["spread_of_radii"] / truth for row in rows if row["method"] == method]))
        for method in METHODS
    ]
    return (case.body, truth, *ratios)


FIGURE_4 = Experiment(
    "figure-4",
    "Figure 4: the rolling cylinder",
    "A cylinder touches the ground along a line parallel to its axis, so that the sensors on this "
    "line have similar readings. In the paper, the maps of the rolling cylinder were relatively "
    "poor by all methods, and compressed along the axis.\n\nHere the compression is measured "
    "globally (axial scale of the map relative to its radial scale) and locally (distance of axial "
    "neighbours relative to circumferential ones). 1 is correct; values below 1 mean compression. "
    "The bombarded cylinder is included for comparison.",
    figure_4,
    needs=("scores-cylinder-locomotion", "scores-cylinder-bombardment"),
    cost=5,
)
FIGURE_7 = Experiment(
    "figure-7",
    "Figure 7: spherisation by information distance",
    "Unrelated sensors all have about the same information distance, which cannot be represented "
    "in few dimensions. According to the paper, the maps therefore tend towards a sphere. The "
    "spread of the distances from the centroid of the map, relative to that of the true positions, "
    "measures this effect: bodies other than spheres are spherised if it is below 1.",
    figure_7,
    needs=tuple(f"scores-{case.name}" for case in BOMBARDED),
    cost=8,
)
