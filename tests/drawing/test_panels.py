"""Panels drawn into given axes, and figures that combine them."""

import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from anisomap.drawing.figures import check_writable, map_figure, plot_distances, plot_map
from anisomap.drawing.figures.charts import (
    METHOD_LOOKS,
    CurvePanel,
    NullBox,
    ScoreGroup,
    curves_figure,
    plot_curves,
    plot_scores,
    scores_figure,
)
from anisomap.drawing.figures.coverage import coverage_figure, plot_coverage
from anisomap.drawing.figures.gallery import (
    gallery_figure,
    map_panel,
    plot_panel,
    truth_panel,
)
from anisomap.drawing.figures.mds_diagnostics import (
    plot_shepard,
    plot_shift_test,
    plot_stress_per_point,
)
from anisomap.drawing.figures.scenes import bodies_figure, plot_scene, scene_figure
from anisomap.drawing.figures.touches import plot_series, plot_touches
from anisomap.errors import InputError, MissingExtraError
from anisomap.evaluation import ShiftTest, score, shepard, stress_per_point
from anisomap.health import touch_coverage
from anisomap.scene import Mesh, Prop, Scene
from anisomap.sensor_map import SensorMap

TRUTH = np.random.default_rng(0).normal(size=(20, 3))
FLAT = SensorMap(TRUTH[:, :2])
CURVED = SensorMap(TRUTH)
SCORE = score(CURVED, TRUTH, exclude=[3], units="mm", permutations=0)
WANTED = np.linalg.norm(TRUTH[:, None, :2] - TRUTH[:, :2], axis=2)
SPP = stress_per_point(WANTED, TRUTH)
TOUCHED = np.random.default_rng(1).uniform(size=(50, 20)) > 0.8
SCENE = Scene(
    "scene",
    (Prop("body", Mesh(np.eye(3), [[0, 1, 2]]), np.zeros((1, 1, 3))),),
    np.eye(3)[None],
    np.ones((4, 3), dtype=np.float32),
    np.arange(4.0),
    "m",
)
CURVES = CurvePanel("title", np.array([1.0, 2.0]), {"isomap": np.array([[0.1, 0.2], [0.3, 0.4]])})
GROUPS = [ScoreGroup("run", {"isomap": [0.8, 0.9]}, {"isomap": NullBox(-0.1, 0, 0, 0, 0.1)})]
SHARES = {"share": np.array([[0.1], [0.9]])}

PANELS = {
    "map in 2D": (2, lambda ax: plot_map(FLAT, ax=ax)),
    "map in 3D": (3, lambda ax: plot_map(CURVED, SCORE, ax=ax)),
    "distances": (2, lambda ax: plot_distances(SCORE, ax=ax)),
    "panel in 2D": (2, lambda ax: plot_panel(truth_panel("", TRUTH[:, :2]), ax=ax)),
    "panel in 3D": (3, lambda ax: plot_panel(map_panel("", CURVED, SCORE, TRUTH), ax=ax)),
    "scores": (2, lambda ax: plot_scores(GROUPS, ax=ax)),
    "curves": (2, lambda ax: plot_curves(CURVES, ax=ax)),
    "coverage": (2, lambda ax: plot_coverage(np.array([100, 200]), 20.0, SHARES, ax=ax)),
    "scene": (3, lambda ax: plot_scene(SCENE, 0, ax=ax)),
    "stress per point": (2, lambda ax: plot_stress_per_point(SPP, ax=ax)),
    "shepard": (2, lambda ax: plot_shepard(shepard(WANTED, TRUTH), ax=ax)),
    "shift test": (2, lambda ax: plot_shift_test(ShiftTest(0.1, np.arange(9.0), 0.1), ax=ax)),
    "series": (2, lambda ax: plot_series(np.sin(np.arange(2000.0)), rate_hz=20, ax=ax)),
    "touches in 2D": (2, lambda ax: plot_touches(FLAT, touch_coverage(FLAT, TOUCHED), ax=ax)),
    "touches in 3D": (3, lambda ax: plot_touches(CURVED, touch_coverage(CURVED, TOUCHED), ax=ax)),
}
FIGURES = {
    "map": lambda: map_figure(CURVED),
    "scores": lambda: scores_figure("title", [GROUPS]),
    "curves": lambda: curves_figure("title", [CURVES], x_label="x", logarithmic=True),
    "coverage": lambda: coverage_figure("title", np.array([100, 200]), 20.0, SHARES),
    "gallery": lambda: gallery_figure("title", [truth_panel("", TRUTH)], 1, "note"),
    "scene": lambda: scene_figure(SCENE),
    "bodies": lambda: bodies_figure("title", [SCENE], ["body"]),
}


def axes_of(dimensions):
    return Figure().add_subplot(projection="3d" if dimensions == 3 else None)


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_is_drawn_into_the_given_axes(name):
    dimensions, plot = PANELS[name]
    given = axes_of(dimensions)
    assert not given.has_data()
    assert plot(given) is given
    assert given.has_data()
    assert given.figure.axes == [given]


@pytest.mark.parametrize("name", PANELS)
def test_without_axes_a_figure_with_one_panel_is_created(name):
    dimensions, plot = PANELS[name]
    axes = plot(None)
    assert axes.has_data()
    assert axes.figure.axes == [axes]
    assert (axes.name == "3d") == (dimensions == 3)


@pytest.mark.parametrize("name", PANELS)
def test_axes_with_other_dimensions_are_rejected(name):
    dimensions, plot = PANELS[name]
    with pytest.raises(InputError, match=r"the data need [23]D axes"):
        plot(axes_of(5 - dimensions))


@pytest.mark.parametrize("name", FIGURES)
def test_without_matplotlib_the_error_names_the_extra(monkeypatch, name):
    for module in [name for name in sys.modules if name.startswith("matplotlib")]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for call in (FIGURES[name], lambda: check_writable("map.png")):
        with pytest.raises(MissingExtraError, match=r"a picture needs .*anisomap\[report\]"):
            call()


def test_charts_show_every_score_mean_and_null():
    (axes,) = scores_figure("title", [GROUPS]).axes
    drawn = [list(line.get_ydata()) for line in axes.lines]
    assert [0.8, 0.9] in drawn
    assert any(np.allclose(values, 0.85) for values in drawn)
    assert {-0.1, 0.1} <= {value for values in drawn for value in values}
    assert axes.get_ylabel() == "Mantel r"


def test_curves_show_every_run_and_the_mean_without_nan():
    values = np.array([[0.1, np.nan], [np.nan, np.nan], [0.3, 0.5]])
    figure = curves_figure(
        "title", [CurvePanel("panel", np.array([1.0, 2, 3]), {"isomap": values})], x_label="bins"
    )
    (axes,) = figure.axes
    mean = axes.lines[-1].get_ydata()
    np.testing.assert_allclose(mean, [0.1, np.nan, 0.4])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("bins", "Mantel r")


def test_every_method_has_its_own_colour_and_marker():
    for attribute in ("label", "colour", "marker"):
        values = {getattr(look, attribute) for look in METHOD_LOOKS.values()}
        assert len(values) == len(METHOD_LOOKS)


def test_a_map_panel_shows_the_aligned_map_and_marks_excluded_sensors():
    panel = map_panel("", CURVED, SCORE, TRUTH)
    np.testing.assert_allclose(panel.points[SCORE.sensors], SCORE.alignment.aligned)
    assert np.flatnonzero(panel.uncompared).tolist() == [3]
    assert not (panel.pairs == 3).any()


def test_a_truth_panel_shows_sensors_without_a_position_apart():
    on_maps = np.arange(20) != 7
    panel = truth_panel("", TRUTH, on_maps=on_maps, labels={7: "a", 8: "b"})
    np.testing.assert_array_equal(panel.unplaced, TRUTH[[7]])
    np.testing.assert_array_equal(panel.points, TRUTH[on_maps])
    assert panel.labels == {7: "b"}


@pytest.mark.parametrize(
    "draw",
    [
        lambda: gallery_figure("title", [], 2),
        lambda: scores_figure("title", [[]]),
        lambda: curves_figure("title", [], x_label="x"),
        lambda: bodies_figure("title", [SCENE], []),
    ],
)
def test_figures_without_content_are_rejected(draw):
    with pytest.raises(InputError):
        draw()
