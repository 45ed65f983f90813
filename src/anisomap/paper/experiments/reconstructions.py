"""Figures 1 and S1 to S4: maps of the bombarded bodies."""

from __future__ import annotations

from functools import partial

from anisomap.drawing.figures.charts import METHOD_LOOKS
from anisomap.drawing.figures.gallery import Panel, gallery_figure, map_panel, truth_panel
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.runs import BOMBARDED, METHODS, Case, make_map, truth_of
from anisomap.recording import Recording

_COLUMNS = {
    "body": "body",
    "seed": "the randomly chosen seed",
    "method": "method",
    "mantel_r": "Mantel r with the true positions",
    "rms_in_spacings": "RMS error after alignment, in distances between neighbouring sensors",
}
_AS_IN_FIGURES = (
    "A sensor has the same colour in all panels, and lines join true neighbours. Each map is "
    "turned, scaled and, if need be, mirrored onto the truth."
)


def _panel_and_row(case: Case, recording: Recording, seed: int, method: str) -> tuple[Panel, Row]:
    scored = make_map(recording, method, 3)
    result = scored.score
    label = METHOD_LOOKS[method].label
    panel = map_panel(
        f"{label}, r = {result.mantel.r:.3f}", scored.sensor_map, result, truth_of(recording)
    )
    return panel, (case.body, seed, method, result.mantel.r, result.rms_in_spacings)


def figure_1(settings: Settings, _: Tables) -> Outcome:
    """Draw r-ANISOMAP's maps of the four bodies, each beside its truth."""
    truths, maps, rows = [], [], []
    for name in ("cylinder", "plane", "y-shape", "sphere"):
        case = next(one for one in BOMBARDED if one.body == name)
        seed = settings.picked_seed(case.name)
        recording = case.record(settings, seed)
        panel, row = _panel_and_row(case, recording, seed, "r-anisomap")
        truths.append(truth_panel(name, truth_of(recording), units=recording.units))
        maps.append(panel)
        rows.append(row)
    figure = gallery_figure(
        "Figure 1. r-ANISOMAP's maps of bombarded bodies, below the true places",
        [*truths, *maps],
        4,
        _AS_IN_FIGURES,
    )
    seeds = ", ".join(f"{row[0]} {row[1]}" for row in rows)
    caption = f"Typical reconstructions by r-ANISOMAP. Randomly chosen seeds: {seeds}."
    table = Table("figure-1", "The maps of Figure 1.", _COLUMNS, tuple(rows), shown=False)
    return Outcome((Picture("figure-1", caption, figure),), (table,))


def supplementary(body: str, number: str, settings: Settings, _: Tables) -> Outcome:
    """Draw the maps that every method makes of one bombarded body."""
    case = next(one for one in BOMBARDED if one.body == body)
    seed = settings.picked_seed(case.name)
    recording = case.record(settings, seed)
    found = [_panel_and_row(case, recording, seed, method) for method in METHODS]
    truth = truth_panel("true places", truth_of(recording), units=recording.units)
    figure = gallery_figure(
        f"Figure {number}. {body}, bombardment, seed {seed}",
        [truth, *(panel for panel, _ in found)],
        5,
        _AS_IN_FIGURES,
    )
    name = f"figure-{number.lower()}"
    caption = f"The bombarded {body}, by every method. Randomly chosen seed: {seed}."
    table = Table(name, caption, _COLUMNS, tuple(row for _, row in found), shown=False)
    return Outcome((Picture(name, caption, figure),), (table,))


FIGURE_1 = Experiment(
    "figure-1",
    "Figure 1: typical reconstructions by r-ANISOMAP",
    "The paper shows one randomly chosen reconstruction each of cylinder, plane, Y-shape and "
    "sphere after 2,000 frames of bombardment by small balls.",
    figure_1,
    cost=20,
)
SUPPLEMENTARY = tuple(
    Experiment(
        f"figure-{number.lower()}",
        f"Figure {number}: {body}, bombardment, all methods",
        f"The randomly chosen run of the {body}, reconstructed by each of the four methods.",
        partial(supplementary, body, number),
        cost=12,
    )
    for number, body in (
        ("S1", "cylinder"),
        ("S2", "plane"),
        ("S3", "y-shape"),
        ("S4", "sphere"),
    )
)
