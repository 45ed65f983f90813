"""Figures 1 and S1 to S4: maps of the bombarded bodies."""

from __future__ import annotations

from functools import partial

from anisomap.drawing.figures.gallery import Panel, gallery_figure, map_panel, truth_panel
from anisomap.paper.cases import METHODS, Case, find_case, true_positions
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.map_scores import map_and_score
from anisomap.recording import Recording

_COLUMNS = {
    "body": "body",
    "seed": "randomly picked seed",
    "method": "method",
    "mantel_r": "Mantel r with the true positions",
    "rms_in_spacings": "RMS error after alignment, in distances between neighbouring sensors",
}
_NOTE = (
    "A sensor has the same colour in all panels; lines join true neighbours. Maps are aligned with "
    "the true positions by rotation, scale and reflection."
)


def figure_1(settings: Settings, _: Tables) -> Outcome:
    """Draw the maps of the four bodies by r-ANISOMAP."""
    truths, maps, rows = [], [], []
    for body in ("cylinder", "plane", "y-shape", "sphere"):
        case = find_case(body)
        seed = settings.picked_seed(case.name)
        recording = case.record(settings, seed)
        panel, row = _panel_and_row(case, recording, seed, "r-anisomap")
        truths.append(truth_panel(body, true_positions(recording), units=recording.units))
        maps.append(panel)
        rows.append(row)
    figure = gallery_figure(
        "Figure 1. Maps of bombarded bodies by r-ANISOMAP (bottom) and true positions (top)",
        [*truths, *maps],
        4,
        _NOTE,
    )
    seeds = ", ".join(f"{row[0]} {row[1]}" for row in rows)
    caption = f"Typical reconstructions by r-ANISOMAP. Randomly picked seeds: {seeds}."
    table = Table("figure-1", "Scores of the maps in Figure 1.", _COLUMNS, tuple(rows), shown=False)
    return Outcome((Picture("figure-1", caption, figure),), (table,))


def supplementary_figure(body: str, number: str, settings: Settings, _: Tables) -> Outcome:
    """Draw the maps of one bombarded body by all methods."""
    case = find_case(body)
    seed = settings.picked_seed(case.name)
    recording = case.record(settings, seed)
    found = [_panel_and_row(case, recording, seed, method) for method in METHODS]
    truth = truth_panel("true positions", true_positions(recording), units=recording.units)
    figure = gallery_figure(
        f"Figure {number}. {body}, bombardment, seed {seed}",
        [truth, *(panel for panel, _ in found)],
        5,
        _NOTE,
    )
    name = f"figure-{number.lower()}"
    caption = f"Maps of the bombarded {body} by all methods. Randomly picked seed: {seed}."
    table = Table(name, caption, _COLUMNS, tuple(row for _, row in found), shown=False)
    return Outcome((Picture(name, caption, figure),), (table,))


def _panel_and_row(case: Case, recording: Recording, seed: int, method: str) -> tuple[Panel, Row]:
    scored = map_and_score(recording, method, 3)
    result = scored.score
    panel = map_panel(scored.title, scored.sensor_map, result, true_positions(recording))
    return panel, (case.body, seed, method, result.mantel.r, result.rms_in_spacings)


FIGURE_1 = Experiment(
    "figure-1",
    "Figure 1: typical reconstructions by r-ANISOMAP",
    "The paper shows one randomly chosen reconstruction of each body (cylinder, plane, Y-shape and "
    "sphere) after 2,000 frames of bombardment by small balls.",
    figure_1,
    cost=20,
)
SUPPLEMENTARY = tuple(
    Experiment(
        f"figure-{number.lower()}",
        f"Figure {number}: {body}, bombardment, all methods",
        f"The randomly picked run of the {body}, reconstructed by each of the four methods.",
        partial(supplementary_figure, body, number),
        cost=12,
    )
    for number, body in (
        ("S1", "cylinder"),
        ("S2", "plane"),
        ("S3", "y-shape"),
        ("S4", "sphere"),
    )
)
