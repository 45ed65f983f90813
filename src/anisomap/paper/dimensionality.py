"""Number of dimensions of each body, chosen from the spectrum of classical scaling."""

from __future__ import annotations

import warnings

import numpy as np

from anisomap.drawing.figures.charts import CurvePanel, curves_figure
from anisomap.errors import AnisomapWarning
from anisomap.paper.cases import CASES, METHODS, patch_run
from anisomap.paper.experiment import Outcome, Picture, Row, Settings, Table, Tables, experiment
from anisomap.paper.map_scores import n_dimensions, published_metric, spectrum
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording

COLUMNS = {
    "run": "body and scenario, or patch",
    "true": "dimensions of the true configuration",
    "auto": "dimensions that anisomap chooses, by the elbow of the stress",
    **{method: f"dimensions chosen from the metric of {method}" for method in METHODS},
}
_SPECTRA = {
    "run": "body and scenario, or patch",
    "method": "method",
    "dimension": "number of the dimension, by descending variance",
    "share": "variance of classical scaling, relative to the sum of the positive variances",
}
_MAX_DIMENSIONS = 8  # shown in the figure
_TRUE_DIMENSIONS = {"sphere": 3, "cylinder": 3, "y-shape": 3, "plane": 2}


@experiment(
    "dimensions",
    "Number of dimensions",
    "The paper assumes three dimensions and mentions that the approach of Pierce & Kuipers (1997) "
    "could choose their number: apply classical scaling, and keep the dimensions before the "
    "largest drop in variance. It errs on thin bodies and long contacts; the column auto gives the "
    "choice of anisomap.",
    cost=20,
)
def dimensions(settings: Settings, _: Tables) -> Outcome:
    """Choose the number of dimensions of every body and of the patch."""
    seed = settings.seed
    runs = [(case.name, case.record(settings, seed), _TRUE_DIMENSIONS[case.body]) for case in CASES]
    runs.append(("patch, run 1", patch_run(settings, 1), 2))
    panels: list[CurvePanel] = []
    rows: list[Row] = []
    shares: list[Row] = []
    for name, recording, true in runs:
        curves, chosen = {}, []
        for method in METHODS:
            variances = spectrum(published_metric(recording, method))
            chosen.append(n_dimensions(variances))
            share = variances[:_MAX_DIMENSIONS] / variances[variances > 0].sum()
            curves[method] = share[:, None]
            shares += [(name, method, i + 1, float(value)) for i, value in enumerate(share)]
        rows.append((name, true, _chosen(recording), *chosen))
        x = np.arange(1.0, _MAX_DIMENSIONS + 1)
        panels.append(CurvePanel(name, x, curves, float(true)))
    figure = curves_figure(
        "Variance by dimension of classical scaling",
        panels,
        x_label="dimension",
        y_label="share of variance",
    )
    caption = (
        "Share of variance of each dimension of classical scaling. Dotted line: dimensions of the "
        f"true configuration. Seed {seed}."
    )
    tables = (
        Table("dimensions", "Dimensions chosen by the largest drop.", COLUMNS, tuple(rows)),
        Table("spectra", "Variance by dimension.", _SPECTRA, tuple(shares), shown=False),
    )
    return Outcome((Picture("dimensions", caption, figure),), tables)


def _chosen(recording: Recording) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # the notes of the map are not shown
        return reconstruct(recording, "r-anisomap").dimensions
