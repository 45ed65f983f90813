"""Figures 2 and S5 to S10: the hexagonal patch, simulated and real, and the failing sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from anisomap.drawing.figures.maps import gallery_figure, truth_panel
from anisomap.drawing.view import Panel
from anisomap.paper.cases import (
    FAILING,
    METHODS,
    PATCH_FRAMES,
    PATCH_RUNS,
    REAL_RECORDING,
    patch_run,
    real_recording,
    true_positions,
)
from anisomap.paper.experiment import Picture, Settings, Table, Tables, experiment
from anisomap.paper.map_scores import SCORE_COLUMNS, draw_run

_LABELS = {30: "30"}  # sensors with numbers in figures, left out of scores
_NOTE = (
    "Six triangles of twelve pads each, rubbed by a hand; one triangle (rings) is silent in all "
    f"runs. Sensor 30 ({FAILING}, square) saturates intermittently from run 4 on. It is included "
    "in the maps and excluded from the scores."
)


@experiment(
    "figure-2",
    "Figure 2: the hardware experiment (simulated)",
    "The paper's hexagonal patch of prototype skin was rubbed by hand in five runs of "
    f"{', '.join(map(str, PATCH_FRAMES[:-1]))} and {PATCH_FRAMES[-1]} frames. One of its six "
    "triangles did not respond. Sensor 30 failed between runs 3 and 4: it saturated "
    "intermittently, whether touched or not. According to the paper, r-ANISOMAP isolates it.\n\n"
    "Here the patch is simulated with the same numbers of triangles, sensors, frames and "
    "failures. (On later skins of this kind, two of the 12 pads of a triangle measure "
    "temperature.)",
    cost=12,
)
def figure_2(settings: Settings, _: Tables) -> Iterator[Picture]:
    """Draw the maps of all runs by r-ANISOMAP."""
    panels: list[Panel] = []
    for number in PATCH_RUNS:
        drawn, (scored,) = draw_run(
            patch_run(settings, number), settings, (2,), ("r-anisomap",), _LABELS
        )
        panels = panels or [replace(drawn[0], title="actual configuration")]
        panels.append(replace(drawn[1], title=f"run {number}, r = {scored.score.mantel.r:.3f}"))
    figure = gallery_figure("Figure 2. Maps of the simulated patch by r-ANISOMAP", panels, 3, _NOTE)
    seeds = f"{settings.seed} to {settings.seed + PATCH_RUNS[-1] - 1}"
    caption = f"r-ANISOMAP in 2D on the simulated patch, runs 1 to 5 (seeds {seeds})."
    yield Picture("figure-2", caption, figure)


def supplementary_figure(number: int, settings: Settings, _: Tables) -> Iterator[Picture]:
    """Draw the maps of one run by all methods, in 2D and 3D."""
    recording = patch_run(settings, number)
    panels, _maps = draw_run(recording, settings, (2, 3), METHODS, _LABELS)
    title = f"Figure S{4 + number}. Simulated patch, run {number}: {recording.n_frames} frames"
    caption = f"All methods on run {number}, in 2D and 3D."
    yield Picture(f"figure-s{4 + number}", caption, gallery_figure(title, panels, 5, _NOTE))


for _number in PATCH_RUNS:
    experiment(
        f"figure-s{4 + _number}",
        f"Figure S{4 + _number}: simulated patch, run {_number}",
        f"All reconstructions of hardware run {_number}.",
        cost=10,
    )(partial(supplementary_figure, _number))


@experiment(
    "figure-s10", "Figure S10: the patch", "Numbers and states of the sensors of the patch."
)
def figure_s10(settings: Settings, _: Tables) -> Iterator[Picture]:
    """Draw the patch with the numbers of its sensors."""
    recording = patch_run(settings, 1)
    names = recording.names
    positions = true_positions(recording, 2)
    panel = truth_panel(
        "sensor numbers",
        positions,
        units="mm",
        on_maps=recording.varying(),
        excluded=[name == FAILING for name in names],
        labels={i: str(i) for i in range(len(names))},
    )
    caption = (
        "Schematic of the patch: six IIT triangles around a vertex. Rings: the silent triangle."
    )
    figure = gallery_figure("Figure S10. The patch", [panel], 1, _NOTE, size=6.5)
    yield Picture("figure-s10", caption, figure)


@experiment(
    "real-skin",
    "Figure 2 from real skin",
    "The same figure from a recording of real skin of the same kind: six triangles around a "
    "vertex on the torso of an iCub, touched by hand (binary readings).",
    files=(REAL_RECORDING,),
    absent=(
        f"The recording {REAL_RECORDING} was not given. It can be made from the public repository "
        "matejhof/robotic-homunculus-supporting-materials (GPL-3.0; MATLAB files), which anisomap "
        "does not contain. From its recordings of touch on the torso, keep taxels 3169 to 3240 "
        "(six triangles of twelve) without the 7th and 11th of each triangle, which measure "
        "temperature, and keep the frames in which at least one of them is touched. Write the "
        "readings (frames x 60, 0 or 1) and positions (60 x 2, in mm) with "
        'anisomap.write(anisomap.Recording(readings, positions=positions, units="mm"), '
        f'"{REAL_RECORDING}"), and run anisomap paper --recordings FOLDER.'
    ),
    needs=("runs-real",),
)
def real_patch(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Map a real patch of the same triangles by all methods, in 2D and 3D."""
    recording = real_recording(settings)
    panels, _maps = draw_run(recording, settings, (2, 3))
    figure = gallery_figure(
        f"Real skin: {recording.n_sensors} sensors of an iCub, {recording.n_frames} frames",
        panels,
        5,
        "Binary readings (0 or 1) of a thumb sweeping over the skin; positions from CAD.",
    )
    caption = "Real IIT skin, six triangles around a vertex, by all methods in 2D and 3D."
    yield Picture("real-skin", caption, figure)
    rows = tables["scores-real"].rows
    yield Table("real-skin", "Scores of the maps of real skin.", SCORE_COLUMNS, rows)
