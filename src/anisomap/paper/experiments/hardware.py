"""Figures 2 and S5 to S10: the hexagonal patch, simulated, and real where a recording is given."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from anisomap import io
from anisomap.drawing.figures.charts import METHOD_LOOKS
from anisomap.drawing.figures.gallery import Panel, gallery_figure, map_panel, truth_panel
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.experiments.quality import PATCH_RUNS
from anisomap.paper.measures import isolation
from anisomap.paper.runs import (
    FAILING,
    METHODS,
    PATCH_FRAMES,
    SCORE_COLUMNS,
    SILENT,
    make_map,
    patch_run,
    score_rows,
    truth_of,
)
from anisomap.recording import Recording

REAL = "icub_hexagon.npz"

_ISOLATION = {
    "run": "number of the run",
    "frames": "frames of the run",
    "seed": "seed of the run",
    "method": "method",
    "dimensions": "of the space that was mapped into",
    "mantel_r": "Mantel r, the failing sensor left out",
    "isolation": "distance of the failing sensor to its nearest neighbour on the map, over the "
    "median of that distance of all others: about 1 for a sensor among others",
}
_HOW_MADE = (
    "Six triangles of ten pads each, rubbed by a hand; one triangle (rings) is silent throughout. "
    f"Sensor 30 ({FAILING}, square) saturates now and then from run 4 on. It takes part in the "
    "maps, and is left out of the scores."
)


def _labelled(recording: Recording) -> dict[int, str]:
    return {recording.names.index(FAILING): "30"}


def _truth(recording: Recording, dimensions: int, title: str = "true places") -> Panel:
    failing = np.array([name == FAILING for name in recording.names])
    return truth_panel(
        title,
        truth_of(recording, dimensions),
        units=recording.units,
        on_maps=recording.varying(),
        excluded=failing,
        labels=_labelled(recording),
    )


def patch_map(
    recording: Recording, method: str, dimensions: int, title: str = ""
) -> tuple[Panel, float, float]:
    """Draw a map; give its Mantel r, and how isolated the failing sensor is."""
    scored = make_map(recording, method, dimensions, exclude=[FAILING])
    r = scored.score.mantel.r
    placed = np.flatnonzero(scored.sensor_map.placed)
    row = int(np.searchsorted(placed, recording.names.index(FAILING)))
    panel = map_panel(
        f"{title or METHOD_LOOKS[method].label}, r = {r:.3f}",
        scored.sensor_map,
        scored.score,
        truth_of(recording, dimensions),
        labels=_labelled(recording),
    )
    return panel, r, isolation(scored.sensor_map.positions[placed], row)


def figure_2(settings: Settings, _: Tables) -> Outcome:
    """Draw r-ANISOMAP's maps of all runs on the patch."""
    runs = {number: patch_run(settings, number) for number in PATCH_RUNS}
    panels = [_truth(runs[1], 2, "actual configuration")]
    panels += [patch_map(run, "r-anisomap", 2, f"run {number}")[0] for number, run in runs.items()]
    figure = gallery_figure(
        "Figure 2. r-ANISOMAP's maps of the simulated patch", panels, 3, _HOW_MADE
    )
    rows: list[Row] = []
    for number, run in runs.items():
        seed = settings.seed + number - 1
        for method in METHODS:
            for k in (2, 3):
                _panel, r, alone = patch_map(run, method, k)
                rows.append((number, run.n_frames, seed, method, k, r, alone))
    seeds = f"{settings.seed} to {settings.seed + len(PATCH_RUNS) - 1}"
    caption = f"r-ANISOMAP on the simulated patch, runs 1 to 5 (seeds {seeds}), in 2D."
    table = Table("figure-2", "How isolated sensor 30 is.", _ISOLATION, tuple(rows), shown=False)
    return Outcome((Picture("figure-2", caption, figure),), (table,))


def supplementary(number: int, settings: Settings, _: Tables) -> Outcome:
    """Draw the maps that every method makes of one run, in 2D and 3D."""
    recording = patch_run(settings, number)
    panels, rows = [], []
    for k in (2, 3):
        panels.append(_truth(recording, k))
        for method in METHODS:
            panel, r, alone = patch_map(recording, method, k)
            panels.append(panel)
            seed = settings.seed + number - 1
            rows.append((number, recording.n_frames, seed, method, k, r, alone))
    name = f"figure-s{4 + number}"
    title = f"Figure S{4 + number}. Simulated patch, run {number}: {recording.n_frames} frames"
    figure = gallery_figure(title, panels, 5, _HOW_MADE)
    caption = f"All methods on run {number} (seed {settings.seed + number - 1}), in 2D and 3D."
    table = Table(name, caption, _ISOLATION, tuple(rows), shown=False)
    return Outcome((Picture(name, caption, figure),), (table,))


def figure_s10(settings: Settings, _: Tables) -> Outcome:
    """Draw the patch with the names of its sensors."""
    recording = patch_run(settings, 1)
    names = recording.names
    rows = [
        (i, name, "silent" if name in SILENT else "fails" if name == FAILING else "sound", x, y)
        for i, (name, (x, y)) in enumerate(zip(names, truth_of(recording, 2).tolist(), strict=True))
    ]
    panel = truth_panel(
        "number of each sensor",
        truth_of(recording, 2),
        units="mm",
        on_maps=recording.varying(),
        excluded=[name == FAILING for name in names],
        labels={i: str(i) for i in range(len(names))},
    )
    figure = gallery_figure("Figure S10. The patch", [panel], 1, _HOW_MADE, size=6.5)
    columns = {
        "sensor": "number, from 0",
        "name": "t for the triangle, p for its pad; pads 6 and 10 measure temperature",
        "state": "silent in all runs, fails from run 4 on, or sound",
        "x_mm": "true place, mm",
        "y_mm": "true place, mm",
    }
    table = Table("figure-s10", "The sensors of the patch.", columns, tuple(rows), shown=False)
    caption = (
        "Schematic of the patch: six IIT triangles about a corner. Rings: the silent triangle."
    )
    return Outcome((Picture("figure-s10", caption, figure),), (table,))


def real_patch(settings: Settings, _: Tables) -> Outcome:
    """Map a real patch of the same triangles, by every method, in 2D and 3D."""
    path = (settings.recordings or Path()) / REAL
    recording = io.read(path)
    panels = []
    for k in (2, 3):
        flat = truth_of(recording, 2)
        truth = flat if k == 2 else np.pad(flat, ((0, 0), (0, 1)))
        panels.append(
            truth_panel("true places", truth, units=recording.units, on_maps=recording.varying())
        )
        for method in METHODS:
            scored = make_map(recording, method, k)
            title = f"{METHOD_LOOKS[method].label}, r = {scored.score.mantel.r:.3f}"
            panels.append(map_panel(title, scored.sensor_map, scored.score, truth))
    figure = gallery_figure(
        f"Real skin: {recording.n_sensors} sensors of an iCub, {recording.n_frames} frames",
        panels,
        5,
        "Thresholded readings (0 or 1), a thumb sweeping over the skin; positions from CAD.",
    )
    rows = tuple(score_rows("real", recording, 0, (2, 3), settings))
    table = Table("real-skin", "Scores of the maps of real skin.", SCORE_COLUMNS, rows)
    caption = "Real IIT skin, the six triangles around a corner, by every method in 2D and 3D."
    return Outcome((Picture("real-skin", caption, figure),), (table,))


FIGURE_2 = Experiment(
    "figure-2",
    "Figure 2: the hardware experiment (simulated twin)",
    "The paper rubbed a hexagonal patch of prototype skin by hand, in five runs of "
    f"{', '.join(map(str, PATCH_FRAMES[:-1]))} and {PATCH_FRAMES[-1]} frames. One of six triangles "
    "never answered, and sensor 30 failed between runs 3 and 4: it saturated now and then, "
    "touched or not. r-ANISOMAP isolates it. Ours is a twin in simulation: the same triangles, "
    "frames and failures. (The paper counts 12 sensors a triangle; two of the 12 pads of a "
    "triangle measure temperature, so ours has 10, and 50 of 60 answer.)",
    figure_2,
    cost=12,
)
REAL_SKIN = Experiment(
    "real-skin",
    "Figure 2 from real skin",
    "The same figure from a recording of real skin of the same kind: six triangles around a "
    "corner on the torso of an iCub, touched by hand (readings thresholded to 0 and 1).",
    real_patch,
    files=(REAL,),
    absent=(
        f"The recording {REAL} was not given. It is made from the public repository "
        "matejhof/robotic-homunculus-supporting-materials (GPL-3.0; MATLAB files), of which "
        "anisomap holds no copy. To make it, get that repository. From its recordings of touch on "
        "the torso keep taxels 3169 to 3240, six triangles of twelve, without the 7th and 11th "
        "of each, which measure temperature; keep the frames in which one of them is touched. Then "
        "write readings (frames x 60, 0 or 1) and positions (60 x 2, in mm) with "
        f'anisomap.write(anisomap.Recording(readings, positions=positions, units="mm"), "{REAL}"), '
        "and run anisomap paper --recordings FOLDER."
    ),
    cost=8,
)
SUPPLEMENTARY = (
    *(
        Experiment(
            f"figure-s{4 + number}",
            f"Figure S{4 + number}: simulated patch, run {number}",
            f"All reconstructions of hardware run {number}.",
            partial(supplementary, number),
            cost=10,
        )
        for number in PATCH_RUNS
    ),
    Experiment(
        "figure-s10",
        "Figure S10: the patch",
        "Which sensor is where, which triangle is silent, and which sensor fails.",
        figure_s10,
    ),
)
