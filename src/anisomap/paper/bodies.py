"""Figures 1 and S1 to S4: maps of the bombarded bodies.

Figures 4 and 7: axial compression and spherisation.

Figures 5 and 6: the bodies and the scenarios.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np

from anisomap.drawing.figures.panels import Panel, gallery_figure, map_panel, truth_panel
from anisomap.drawing.figures.scenes import bodies_figure, scene_figure
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.cases import BOMBARDED, CASES, METHODS, Case, find_case, true_positions
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.map_scores import map_and_score
from anisomap.recording import Recording
from anisomap.simulation import find_body, run_simulation

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
_NOTE_SHAPE_DISTORTION = "A sensor has the same colour in all panels; lines join true neighbours."


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
    figure = gallery_figure(
        f"Figure 4. Cylinder, locomotion, seed {seed}", panels, 5, _NOTE_SHAPE_DISTORTION
    )
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
        _NOTE_SHAPE_DISTORTION,
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


_MAX_FRAMES = 400  # enough to find a frame with many contacts
_BODIES = {
    "body": "body",
    "sensors": "number of sensors",
    "reach_m": "distance of the outermost sensor from the centre, m",
    "spacing_m": "median distance between neighbouring sensors, m",
}
_SCENARIOS = {
    "body": "body",
    "scenario": "scenario",
    "seed": "seed of the run",
    "frames": "frames of the run",
    "zeros": "share of readings that are zero",
    "touched": "mean number of sensors with a positive reading per frame",
}


def figure_5(settings: Settings, _: Tables) -> Outcome:
    """Draw the four bodies."""
    bodies = [find_body(case.body) for case in BOMBARDED]
    scenes = [
        run_simulation(body, "bombardment", n_frames=1, seed=settings.seed).scene for body in bodies
    ]
    figure = bodies_figure(
        "Figure 5. The bodies and their sensors",
        scenes,
        [f"{body.name}, {body.n_sensors} sensors" for body in bodies],
    )
    rows = tuple((body.name, body.n_sensors, body.reach, body.spacing) for body in bodies)
    caption = (
        "Sphere, cylinder (no sensors on its ends), Y-shape and plane. Yellow dots are sensors."
    )
    table = Table("figure-5", "The bodies.", _BODIES, rows)
    return Outcome((Picture("figure-5", caption, figure),), (table,))


def figure_6(settings: Settings, _: Tables) -> Outcome:
    """Draw every scenario."""
    pictures, rows = [], []
    n_frames = min(settings.n_frames, _MAX_FRAMES)
    for case in CASES:
        run = run_simulation(case.body, case.scenario, n_frames=n_frames, seed=settings.seed)
        readings = run.recording.readings
        caption = (
            f"{case.body}, {case.scenario}, seed {settings.seed}: the frame with the most contacts "
            f"of {n_frames}, the body, and all readings."
        )
        pictures.append(Picture(f"figure-6-{case.name}", caption, scene_figure(run.scene)))
        zeros = float((readings == 0).mean())
        touched = float((readings > 0).sum(axis=1).mean())
        rows.append((case.body, case.scenario, settings.seed, n_frames, zeros, touched))
    table = Table("figure-6", "The scenarios.", _SCENARIOS, tuple(rows))
    return Outcome(tuple(pictures), (table,))


EXPERIMENTS = (
    Experiment(
        "figure-5",
        "Figure 5: simulated sensor geometries",
        "60 sensors on a sphere; 60 on a cylinder in 10 columns of 6, none on its ends; 105 on a "
        "Y-shape; 169 on one face of a cuboid in a grid of 13 x 13. The paper gives no lengths; "
        "here each body extends about 1 m from its centre.",
        figure_5,
    ),
    Experiment(
        "figure-6",
        "Figure 6: simulated scenarios",
        "Bombardment: the body is fixed in a box of elastic balls without gravity. Locomotion: a "
        "sphere or a cylinder rolls over uneven ground. Objects in contact with the body are "
        "orange; sensors range from violet (no contact) to yellow (largest reading).",
        figure_6,
        cost=25,
    ),
)
