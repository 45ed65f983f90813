"""Panels drawn into given axes, figures that combine them, and simulated scenes."""

import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from anisomap.drawing import figures as fig
from anisomap.drawing.figures import charts, maps, scenes
from anisomap.errors import InputError, MissingExtraError
from anisomap.evaluation import score
from anisomap.health import SensorHealth
from anisomap.layout import LayoutCheck, LayoutFinding
from anisomap.numerics.surfaces import Mesh
from anisomap.placement import Anchors, place
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.simulation import SCENARIOS, run_simulation
from reports import UNFRIENDLY, small_scene

TRUTH = np.random.default_rng(0).normal(size=(20, 3))
NAMES = (*UNFRIENDLY, *(f"s{i}" for i in range(len(UNFRIENDLY), 20)))
MAPS = {k: SensorMap(TRUTH[:, :k], names=NAMES) for k in (2, 3)}
SCORE = score(MAPS[3], TRUTH, exclude=[NAMES[3]], units="mm", permutations=0)
RECORDING = Recording(np.random.default_rng(1).uniform(size=(50, 20)) > 0.8, names=NAMES)
DOUBTED = [SensorHealth(NAMES[0], "noisy", "", 0, 1, 2, 0.1, 3, 0.2, 0.3)]
TRIANGLE = Mesh(np.eye(3), [[0, 1, 2]])
SCENE = small_scene()
SCORES = {"isomap": [0.8, 0.9]}
NULL = {"whislo": -0.1, "q1": 0, "med": 0, "q3": 0, "whishi": 0.1, "fliers": []}
GROUPS = [charts.ScoreGroup("run", SCORES, {"isomap": NULL})]
VALUES = np.array([[0.1, np.nan], [np.nan, np.nan]])
CURVES = charts.CurvePanel("title", np.array([1.0, 2]), {"isomap": VALUES})
COUNTS = charts.CountPanel(
    "runs", ["a", "b"], np.array([[2, 1], [0, 0]]), np.array([[2, 3], [4, 0]])
)


def placed(k):
    rows = [0, 1, 2, 9, 15, 17]
    anchors = Anchors(tuple(NAMES[i] for i in rows), TRUTH[rows, :k])
    return place(SensorMap(3 * TRUTH[:, :k], names=NAMES), anchors), anchors


def checked(k):
    """Sensors 0 and 1 are swapped, and sensor 2 is dead."""
    right = SensorMap(MAPS[k].positions[[1, 0, *range(2, 20)]], names=NAMES)
    findings = tuple(LayoutFinding(kind, np.array(rows), "") for kind, *rows in (
        ("swapped", 0, 1), ("dead", 2),
    ))  # fmt: skip
    status = ("swapped", "swapped", "dead", *["ok"] * 17)
    nothing = np.full(20, np.nan)
    return LayoutCheck(MAPS[k], right, status, findings, nothing, np.zeros(20, int), 1.0)


PANELS = {
    f"{name} in {k}D": (k, lambda ax, k=k, plot=plot: plot(k, ax))
    for k in (2, 3)
    for name, plot in {
        "plot": lambda k, ax: fig.plot(MAPS[k], SCORE if k == 3 else None, ax=ax),
        "plot_placement": lambda k, ax: fig.plot_placement(*placed(k), TRIANGLE, ax=ax),
        "plot_layout": lambda k, ax: fig.plot_layout(checked(k), ax=ax),
    }.items()
}
FIGURES = {
    "map": lambda: fig.map_figure(MAPS[3]),
    "series": lambda: fig.series_figure(RECORDING, DOUBTED),
    "placement": lambda: fig.plot_placement(*placed(3), TRIANGLE).figure,
    "layout": lambda: fig.plot_layout(checked(2)).figure,
    "scores": lambda: charts.scores_figure("title", [GROUPS]),
    "curves": lambda: charts.curves_figure("title", [CURVES], x_label="x"),
    "counts": lambda: charts.counts_figure("title", [COUNTS], ["first", "second"], "note"),
    "gallery": lambda: maps.gallery_figure("title", [maps.truth_panel("", TRUTH)], 1, "note"),
    "scene": lambda: scenes.scene_figure(SCENE),
    "bodies": lambda: scenes.bodies_figure("title", [SCENE], ["body"]),
}


def axes_of(dimensions):
    return Figure().add_subplot(projection="3d" if dimensions == 3 else None)


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_is_drawn_into_the_given_axes_or_a_figure_of_its_own(name):
    dimensions, plot = PANELS[name]
    given = axes_of(dimensions)
    assert not given.has_data()
    assert plot(given) is given
    own = plot(None)
    for axes in (given, own):
        assert axes.has_data()
        assert axes.figure.axes == [axes]
    assert (own.name == "3d") == (dimensions == 3)
    with pytest.raises(InputError, match=r"the data need [23]D axes"):
        plot(axes_of(5 - dimensions))


@pytest.mark.parametrize("name", ["series", "layout", "counts", "scene"])
def test_the_same_figure_gives_the_same_bytes_whatever_the_names(name):
    first, again = (fig.figure_bytes(FIGURES[name](), "svg") for _ in range(2))
    assert first == again


def test_without_matplotlib_the_error_names_the_extra(monkeypatch):
    for module in [name for name in sys.modules if name.startswith("matplotlib")]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for call in (*FIGURES.values(), lambda: fig.check_writable("map.png")):
        with pytest.raises(MissingExtraError, match=r"a picture needs .*\[report\]"):
            call()


def test_charts_show_every_score_mean_and_null():
    (axes,) = charts.scores_figure("title", [GROUPS]).axes
    drawn = [list(line.get_ydata()) for line in axes.lines]
    assert [0.8, 0.9] in drawn
    assert any(np.allclose(values, 0.85) for values in drawn)
    assert {-0.1, 0.1} <= {value for values in drawn for value in values}
    assert axes.get_ylabel() == "Mantel r"


def test_counts_are_drawn_unless_their_total_is_0_and_framed_where_whole():
    (axes,) = FIGURES["counts"]().axes
    assert [text.get_text() for text in axes.texts] == ["2/2", "1/3", "0/4"]
    assert len(axes.patches) == 1


def test_a_map_panel_shows_the_aligned_map_and_marks_excluded_sensors():
    panel = maps.map_panel("", MAPS[3], SCORE, TRUTH)
    np.testing.assert_allclose(panel.points[SCORE.sensors], SCORE.alignment.aligned)
    assert np.flatnonzero(panel.uncompared).tolist() == [3]
    assert not (panel.pairs == 3).any()


def test_the_figure_shows_the_busiest_frame_with_axes_in_units():
    figure = scenes.scene_figure(SCENE)
    space, body, raster = figure.axes[:3]
    assert space.get_title() == "Frame 4 of 6, 0.20 s"
    assert (space.get_xlabel(), space.get_zlabel()) == ("x (m)", "z (m)")
    assert (raster.get_xlabel(), raster.get_ylabel()) == ("time (s)", "sensor")
    assert "reading (m)" in {axes.get_ylabel() for axes in figure.axes}
    shape = np.array([np.ptp(getattr(body, f"get_{name}lim")()) for name in "xyz"])
    np.testing.assert_allclose(body._box_aspect / body._box_aspect.max(), shape / shape.max())
    for frame in (-1, 6):
        with pytest.raises(InputError, match=f"frame must be from 0 to 5, got {frame}"):
            scenes.scene_figure(SCENE, frame)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")  # sensors that nothing touches
def test_every_scenario_can_be_drawn(scenario):
    pytest.importorskip("mujoco")
    body = "cylinder"
    scene = run_simulation(body, scenario, n_frames=10).scene
    assert scene.n_frames == 10
    assert scene.sensors.shape[1:] == (scene.readings.shape[1], 3)
    assert {prop.role for prop in scene.props} >= {"body"}
    space, *_ = scenes.scene_figure(scene, 9).axes
    assert any(len(drawn.get_facecolor()) > 10 for drawn in space.collections)
