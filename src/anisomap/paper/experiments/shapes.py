"""Figures 4 and 7: what becomes of shapes, as pictures and numbers."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from anisomap.drawing.figures.charts import METHOD_LOOKS
from anisomap.drawing.figures.gallery import gallery_figure, map_panel, truth_panel
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.runs import BOMBARDED, METHODS, ROLLED, Case, make_map, truth_of

_AXIAL = {
    "scenario": "what happened to the cylinder",
    "method": "method",
    "mantel_r": "Mantel r with the true positions",
    "axial_scale": "scale along the axis over scale away from it, of the map laid onto the truth: "
    "below 1 it is compressed along the axis",
    "local_axial_scale": "distance between neighbours along the axis over that of neighbours "
    "around it, against the truth: below 1, those along the axis are too close",
}
_ROUND = {
    "body": "bombarded body",
    "true spread": "spread of the radii of the true positions: standard deviation over mean of "
    "the distances from the centroid; 0 for a sphere",
    **{
        method: f"mean spread of the radii of the maps of {method}, over the truth's: 1 is right, "
        "0 a sphere"
        for method in METHODS
    },
}


def figure_4(settings: Settings, tables: Tables) -> Outcome:
    """Draw the rolling cylinder, and measure its axial compression beside the bombarded one's."""
    rolling = next(case for case in ROLLED if case.body == "cylinder")
    bombarded = next(case for case in BOMBARDED if case.body == "cylinder")
    picked = settings.picked_seed(rolling.name)
    recording = rolling.record(settings, picked)
    panels = [truth_panel("true places", truth_of(recording), units=recording.units)]
    for method in METHODS:
        scored = make_map(recording, method, 3)
        title = f"{METHOD_LOOKS[method].label}, r = {scored.score.mantel.r:.3f}"
        panels.append(map_panel(title, scored.sensor_map, scored.score, truth_of(recording)))
    figure = gallery_figure(
        f"Figure 4. Cylinder, locomotion, seed {picked}",
        panels,
        5,
        "A sensor has the same colour in all panels; lines join true neighbours.",
    )
    caption = f"The rolling cylinder, by every method. Randomly chosen seed: {picked}."
    rows = [
        row
        for case in (rolling, bombarded)
        for row in _axial_rows(case, tables[f"scores-{case.name}"])
    ]
    words = "Axial scale of the cylinder's maps, means over the seeds."
    return Outcome(
        (Picture("figure-4", caption, figure),),
        (Table("figure-4", words, _AXIAL, tuple(rows)),),
    )


def _axial_rows(case: Case, scores: Table) -> Iterable[Row]:
    """Average over the seeds, a row a method."""
    rows = [row for row in scores.records() if row["bins"] == DEFAULT_BINS]
    for method in METHODS:
        found = [row for row in rows if row["method"] == method]
        names = ("mantel_r", "axial_scale", "local_axial_scale")
        yield (
            case.scenario,
            method,
            *(float(np.mean([row[name] for row in found])) for name in names),
        )


def figure_7(settings: Settings, tables: Tables) -> Outcome:
    """Draw maps of information distance, and measure how round all maps are."""
    truths, maps = [], []
    for body in ("cylinder", "y-shape", "plane"):
        case = next(one for one in BOMBARDED if one.body == body)
        recording = case.record(settings, settings.picked_seed(case.name))
        scored = make_map(recording, "information-distance", 3)
        truths.append(truth_panel(body, truth_of(recording), units=recording.units))
        title = f"information distance, r = {scored.score.mantel.r:.3f}"
        maps.append(map_panel(title, scored.sensor_map, scored.score, truth_of(recording)))
    figure = gallery_figure(
        "Figure 7. Maps of information distance, below the true places",
        [*truths, *maps],
        3,
        "A sensor has the same colour in all panels; lines join true neighbours.",
    )
    rows = [
        _roundness(case, tables[f"scores-{case.name}"])
        for case in BOMBARDED
        if case.body != "sphere"
    ]
    caption = "Typical maps of information distance: cylinder, Y-shape, plane (seeds of Figure 1)."
    table = Table("figure-7", "Spread of radii over the truth's.", _ROUND, tuple(rows))
    return Outcome((Picture("figure-7", caption, figure),), (table,))


def _roundness(case: Case, scores: Table) -> Row:
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
    "A cylinder touches the ground along a line on its side, so sensors on one line read alike. "
    "The paper's maps of it were relatively poor by every method, and compressed along the "
    "axis.\n\nThe compression has a number here, in two ways: of the whole map, along the axis "
    "against away from it; and of neighbours, along the axis against around it. 1 is right, "
    "less is compressed. The bombarded cylinder stands beside it for comparison.",
    figure_4,
    needs=("scores-cylinder-locomotion", "scores-cylinder-bombardment"),
    cost=5,
)
FIGURE_7 = Experiment(
    "figure-7",
    "Figure 7: spherisation by information distance",
    "Unrelated sensors all have about the same information distance, which no low-dimensional "
    "space can hold; so, says the paper, maps bulge towards a sphere. The number: spread of the "
    "distances from the map's centroid, against that of the true places. Bodies that are no "
    "spheres come out rounder where it is below 1.",
    figure_7,
    needs=tuple(f"scores-{case.name}" for case in BOMBARDED),
    cost=8,
)
