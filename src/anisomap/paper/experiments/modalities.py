"""What the paper builds on: other senses, mapped with the same calls; how many dimensions."""

from __future__ import annotations

import numpy as np

from anisomap.drawing.figures.charts import METHOD_LOOKS, CurvePanel, curves_figure
from anisomap.drawing.figures.gallery import Panel, gallery_figure, map_panel, truth_panel
from anisomap.methods import MethodOptions, find_method
from anisomap.numerics.precision import Reals
from anisomap.paper.experiment import Experiment, Outcome, Picture, Row, Settings, Table, Tables
from anisomap.paper.experiments.stimuli import PHOTOGRAPHS, cochlea, retina
from anisomap.paper.measures import chosen_dimension, spectrum
from anisomap.paper.runs import CASES, METHODS, make_map, patch_run, truth_of
from anisomap.reconstruction import dissimilarities
from anisomap.recording import Recording
from anisomap.stages.pairs import compare

_SCORES = {
    "sense": "sense",
    "sensors": "number of sensors",
    "frames": "number of frames",
    "seed": "seed",
    "method": "method",
    "dimensions": "of the space that was mapped into",
    "mantel_r": "Mantel r with the true positions",
    "null_most": "greatest Mantel r of random relabellings",
}
_DIMENSIONS = {
    "run": "body and scenario, patch, or sense",
    "true": "dimensions that the sensors need",
    **{method: f"dimensions chosen from the metric of {method}" for method in METHODS},
}
_SPECTRA = {
    "run": "body and scenario, patch, or sense",
    "method": "method",
    "dimension": "which, the one of most variance first",
    "share": "variance of classical scaling, as a share of the sum of the positive ones",
}
_MOST_DIMENSIONS = 8
_TRUE_DIMENSIONS = {"sphere": 3, "cylinder": 3, "y-shape": 3, "plane": 2}


def _map_sense(
    sense: str, recording: Recording, dimensions: tuple[int, ...], settings: Settings
) -> tuple[list[Panel], tuple[Row, ...]]:
    truth = truth_of(recording, 2)
    panels = [truth_panel("true places", truth, units=recording.units)]
    rows: list[Row] = []
    for k in dimensions:
        for method in METHODS:
            scored = make_map(recording, method, k, permutations=settings.permutations)
            r, null = scored.score.mantel.r, scored.score.mantel.null
            size = (sense, recording.n_sensors, recording.n_frames, settings.seed)
            rows.append((*size, method, k, r, float(null.max())))
            if k == 2:
                title = f"{METHOD_LOOKS[method].label}, r = {r:.3f}"
                panels.append(map_panel(title, scored.sensor_map, scored.score, truth))
    return panels, tuple(rows)


def figure_retina(settings: Settings, _: Tables) -> Outcome:
    """Map a retina."""
    recording = retina(settings.n_frames, settings.seed)
    panels, rows = _map_sense("retina", recording, (2,), settings)
    figure = gallery_figure(
        "A retina: 10 x 10 pixels that wander over photographs", panels, 5, recording.source
    )
    caption = f"Maps of a retina in 2D, seed {settings.seed}."
    table = Table("retina", "Scores of the retina's maps.", _SCORES, rows)
    return Outcome((Picture("retina", caption, figure),), (table,))


def figure_cochlea(settings: Settings, _: Tables) -> Outcome:
    """Map a cochlea."""
    recording = cochlea(settings.n_frames, settings.seed)
    panels, rows = _map_sense("cochlea", recording, (1, 2), settings)
    figure = gallery_figure("A cochlea: 32 bands of sound", panels, 5, recording.source)
    caption = (
        f"Maps of a cochlea in 2D, seed {settings.seed}. Truly the bands lie on a line, by their "
        "frequency on the ERB-number scale."
    )
    table = Table("cochlea", "Scores of the cochlea's maps.", _SCORES, rows)
    return Outcome((Picture("cochlea", caption, figure),), (table,))


def _metric(recording: Recording, method: str) -> Reals:
    recipe, options = find_method(method), MethodOptions()
    varying = recording.select(recording.varying())
    pairs = compare([varying], recipe.similarity, bins=options.bins, with_noise=False)
    return recipe.metric(dissimilarities(pairs, method, options))


def dimensions(settings: Settings, _: Tables) -> Outcome:
    """Choose the number of dimensions of every body, the patch, and the senses."""
    seed, n_frames = settings.seed, settings.n_frames
    runs = [(case.name, case.record(settings, seed), _TRUE_DIMENSIONS[case.body]) for case in CASES]
    runs.append(("patch, run 1", patch_run(settings, 1), 2))
    runs.append(("retina", retina(n_frames, seed), 2))
    runs.append(("cochlea", cochlea(n_frames, seed), 1))
    panels: list[CurvePanel] = []
    rows: list[Row] = []
    shares: list[Row] = []
    for name, recording, true in runs:
        curves, chosen = {}, []
        for method in METHODS:
            variances = spectrum(_metric(recording, method))
            chosen.append(chosen_dimension(variances))
            share = variances[:_MOST_DIMENSIONS] / variances[variances > 0].sum()
            curves[method] = share[:, None]
            shares += [(name, method, i + 1, float(value)) for i, value in enumerate(share)]
        rows.append((name, true, *chosen))
        x = np.arange(1.0, _MOST_DIMENSIONS + 1)
        panels.append(CurvePanel(name, x, curves, float(true)))
    figure = curves_figure(
        "Variance by dimension of classical scaling",
        panels,
        x_label="dimension",
        y_label="share of variance",
    )
    caption = (
        "How much of the metric each further dimension of classical scaling takes up. Dotted: how "
        f"many dimensions the sensors need. Seed {seed}."
    )
    return Outcome(
        (Picture("dimensions", caption, figure),),
        (
            Table(
                "dimensions", "Dimensions chosen by the greatest drop.", _DIMENSIONS, tuple(rows)
            ),
            Table("spectra", "Variance by dimension.", _SPECTRA, tuple(shares), shown=False),
        ),
    )


EXPERIMENTS = (
    Experiment(
        "dimensions",
        "How many dimensions: Pierce & Kuipers' choice",
        "The paper assumes three dimensions from the outset, and mentions that the approach of "
        "Pierce & Kuipers (1997) could choose their number: scale classically, and take as many "
        "as there are before the greatest drop of variance.",
        dimensions,
        cost=20,
    ),
    Experiment(
        "retina",
        "Another sense: a retina",
        "The introduction rests on retinas: the same principle should order them. Here a square of "
        f"pixels wanders over the photographs {' and '.join(PHOTOGRAPHS)}, which scikit-learn "
        "ships, and is mapped with the same calls as the skins.",
        figure_retina,
        cost=5,
    ),
    Experiment(
        "cochlea",
        "Another sense: a cochlea",
        "And cochleas, which order frequency. Here 32 gammatone-like bands hear sounds that are "
        "synthesised from the seed (four at a time, voice-like: pitched or noise, with three "
        "random resonances each), for no library that we need ships recorded sound.",
        figure_cochlea,
        cost=4,
    ),
)
