"""Isolation of the failing sensor as a function of how often it saturates."""

from __future__ import annotations

import numpy as np

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.paper.cases import FAILING, FIRST_FAILED_RUN, METHODS, PATCH_RUNS, patch_run
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.experiments.hardware_patch import map_patch

_GAP = 100.0  # mean number of frames between failures
_SPANS = (5.0, 11.0, 25.0, 50.0, 100.0, 200.0)  # mean number of frames of a failure
_QUICK_SPANS = (20.0, 100.0)

_COLUMNS = {
    "run": "number of the run",
    "saturated": "share of frames in which the failing sensor is saturated",
    "method": "method",
    "dimensions": "dimensions of the map",
    "mantel_r": "Mantel r without the failing sensor",
    "isolation": "distance of the failing sensor to its nearest neighbour on the map, divided by "
    "the median of that distance over all other sensors",
}


def isolation_by_saturation(settings: Settings, _: Tables) -> Outcome:
    """Measure the isolation of the failing sensor for several durations of its failures."""
    spans = _QUICK_SPANS if settings.quick else _SPANS
    numbers = [number for number in PATCH_RUNS if number >= FIRST_FAILED_RUN]
    rows: list[Row] = []
    panels = []
    for k in (2, 3):
        curves = {method: np.empty((len(spans), len(numbers))) for method in METHODS}
        shares = np.empty((len(spans), len(numbers)))
        for i, span in enumerate(spans):
            for j, number in enumerate(numbers):
                recording = patch_run(settings, number, mean_gap=_GAP, mean_span=span)
                failing = recording.readings[:, recording.names.index(FAILING)]
                shares[i, j] = np.mean(failing == recording.readings.max())
                for method in METHODS:
                    patch_map = map_patch(recording, method, k)
                    curves[method][i, j] = patch_map.isolation
                    scores = (patch_map.mantel_r, patch_map.isolation)
                    rows.append((number, float(shares[i, j]), method, k, *scores))
        x = np.round(shares.mean(axis=1), 2)
        panels.append(CurvePanel(f"{k}D", x, curves))
    figure = curves_figure(
        "Isolation of the failing sensor",
        panels,
        x_label="share of frames in which it is saturated",
        y_label="isolation",
        columns=2,
    )
    caption = (
        "Distance of sensor 30 to its nearest neighbour on the map, divided by the median of that "
        "distance over all other sensors, in runs 4 and 5 (dots: runs, lines: means). At about 1 "
        "it lies among the others. In Figure 2 it is saturated in a sixth of the frames."
    )
    table = Table("failing-sensor", "Isolation of sensor 30.", _COLUMNS, tuple(rows), shown=False)
    return Outcome((Picture("failing-sensor", caption, figure),), (table,))


EXPERIMENT = Experiment(
    "failing-sensor",
    "Isolation of the failing sensor",
    "In the paper's Figure 2, sensor 30 lies apart from all others. The paper does not state how "
    "often it was saturated; the isolation depends on it.",
    isolation_by_saturation,
    cost=10,
)
