"""When a failing sensor is isolated: how often it must saturate."""

from __future__ import annotations

import numpy as np

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.experiments.hardware import patch_map
from anisomap.paper.experiments.quality import PATCH_RUNS
from anisomap.paper.runs import FAILING, FIRST_FAILED_RUN, METHODS, patch_run

_GAP = 100.0
_SPANS = (5.0, 11.0, 25.0, 50.0, 100.0, 200.0)
_QUICK_SPANS = (20.0, 100.0)

_COLUMNS = {
    "run": "number of the run",
    "saturated": "share of the frames in which the failing sensor is saturated",
    "method": "method",
    "dimensions": "of the space that was mapped into",
    "mantel_r": "Mantel r, the failing sensor left out",
    "isolation": "distance of the failing sensor to its nearest neighbour on the map, over the "
    "median of that distance of all others",
}


def failing_sensor(settings: Settings, _: Tables) -> Outcome:
    """Measure how isolated the failing sensor is, over the share of frames that it saturates."""
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
                    _panel, r, alone = patch_map(recording, method, k)
                    curves[method][i, j] = alone
                    rows.append((number, float(shares[i, j]), method, k, r, alone))
        x = np.round(shares.mean(axis=1), 2)
        panels.append(CurvePanel(f"{k}D", x, curves))
    figure = curves_figure(
        "How far the failing sensor lies from all others",
        panels,
        x_label="share of frames in which it is saturated",
        y_label="isolation",
        columns=2,
    )
    caption = (
        "Distance of sensor 30 to its nearest neighbour on the map, over the median of that "
        "distance of all others, in runs 4 and 5 (dots) and their mean. About 1: it lies among "
        "others. Figure 2 has it saturated a sixth of the time."
    )
    table = Table("failing-sensor", "Isolation of sensor 30.", _COLUMNS, tuple(rows), shown=False)
    return Outcome((Picture("failing-sensor", caption, figure),), (table,))


EXPERIMENT = Experiment(
    "failing-sensor",
    "When a failing sensor is isolated",
    "In the paper's Figure 2, sensor 30 lies apart from all others. How often it saturated is not "
    "told; this is what it decides.",
    failing_sensor,
    cost=10,
)
