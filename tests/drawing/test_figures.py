"""Figures of maps: their content, their agreement with the map, and their reproducibility."""

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.drawing.figures import KINDS, figure_bytes, map_figure, save_figure
from anisomap.drawing.figures.maps import MAX_VECTOR_DOTS
from anisomap.drawing.view import MAX_JOINED, best_view, neighbour_pairs, place_colours, view_axes
from anisomap.evaluation import score
from anisomap.sensor_map import UNPLACED, SensorMap
from reports import UNFRIENDLY


def spread(n_sensors, dimensions, seed=0):
    return np.random.default_rng(seed).normal(size=(n_sensors, dimensions)) * 40


def mapped(truth, dimensions, **rest):
    """A noisy map of the truth, rotated, reflected, scaled and translated."""
    rng = np.random.default_rng(1)
    places = np.pad(truth, ((0, 0), (0, 3)))[:, :dimensions]
    places = places + rng.normal(size=places.shape)
    turn = np.linalg.qr(rng.normal(size=(dimensions, dimensions)))[0]
    return SensorMap(0.01 * places @ turn + 5, method="r-anisomap", **rest)


def compared(n_sensors, true_dimensions, dimensions):
    truth = spread(n_sensors, true_dimensions)
    sensor_map = mapped(truth, dimensions)
    return sensor_map, score(sensor_map, truth, units="mm", permutations=20)


def in_components():
    """Components of 12, 6 and 5 sensors, a single sensor, and one without a position."""
    component = np.repeat([0, 1, 2, 3, UNPLACED], [12, 6, 5, 1, 1])
    positions = spread(25, 3)
    positions[-1] = np.nan
    return SensorMap(positions, component=component)


def texts(figure):
    titles = [axes.get_title() for axes in figure.axes]
    return "\n".join([text.get_text() for text in figure.texts] + titles)


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("true_k", [2, 3])
def test_truth_and_map_have_the_same_limits_and_one_scale(true_k, k):
    truth = spread(12 * k, true_k) * [1, 0.2, 0.05][:true_k]
    sensor_map = mapped(truth, k)
    figure = map_figure(sensor_map, score(sensor_map, truth, units="mm", permutations=0))
    *panels, distances = figure.axes
    names = "xyz"[: max(true_k, k)]
    assert {axes.name for axes in panels} == {"3d" if "z" in names else "rectilinear"}
    limits = [[getattr(axes, f"get_{axis}lim")() for axis in names] for axes in panels]
    assert limits[0] == limits[1]
    for axis in names:
        assert getattr(panels[0], f"get_{axis}label")() == f"{axis} (mm)"
    if "z" in names:
        ratios = np.ptp(limits[1], axis=1) / panels[1]._box_aspect
        assert ratios == pytest.approx(ratios[0])
    else:
        assert panels[1].get_aspect() == 1.0
    for label in (distances.get_xlabel(), distances.get_ylabel()):
        assert "(mm)" in label
    assert distances.get_xlim() == distances.get_ylim()
    assert distances.get_aspect() == 1.0
    note = " ".join(texts(figure).split())
    assert (f"fewer dimensions than the truth ({k} and {true_k})" in note) == (k < true_k)


def test_every_sensor_is_drawn_at_its_position_in_one_colour():
    sensor_map, scored = compared(40, 2, 2)
    (true_dots,), (dots,) = (axes.collections for axes in map_figure(sensor_map, scored).axes[:2])
    np.testing.assert_allclose(true_dots.get_offsets(), scored.truth)
    np.testing.assert_allclose(dots.get_offsets(), scored.alignment.aligned)
    np.testing.assert_array_equal(true_dots.get_facecolor(), dots.get_facecolor())


@pytest.mark.parametrize(("dimensions", "n_panels"), [(1, 1), (2, 1), (3, 3), (5, 3)])
def test_without_truth_the_map_is_drawn_alone(dimensions, n_panels):
    figure = map_figure(SensorMap(spread(30, dimensions)))
    assert len(figure.axes) == n_panels
    assert "known up to rotation, translation, scale and reflection" in texts(figure)
    assert all("arbitrary units" in axes.get_xlabel() for axes in figure.axes)


def test_every_component_has_a_panel():
    sensor_map = in_components()
    alone = map_figure(sensor_map)
    assert [axes.get_title()[:12] for axes in alone.axes] == [f"Component {i}:" for i in (1, 2, 3)]
    for said in ("separate components", "single sensor, not drawn: 1", "Without a position: s24"):
        assert said in texts(alone).replace("\n", " ")
    scored = score(sensor_map, np.nan_to_num(sensor_map.positions), permutations=0)
    titles = [axes.get_title() for axes in map_figure(sensor_map, scored).axes]
    assert [title[:12] for title in titles[3:]] == ["Component 2:", "Component 3:"]


def test_faulty_and_excluded_sensors_are_marked():
    truth = spread(20, 2)
    plain = mapped(truth, 2)
    faulty = mapped(truth, 2, health=["noisy"] + ["ok"] * 19)
    for sensor_map, exclude, marks in (
        (plain, [], set()),
        (faulty, ["s5"], {"faulty", "not compared"}),
    ):
        scored = score(sensor_map, truth, exclude=exclude, permutations=0)
        figure = map_figure(sensor_map, scored)
        legends = [label.get_text() for legend in figure.legends for label in legend.get_texts()]
        assert set(legends) == marks
    (true_dots, *_), (dots, *others) = (axes.collections for axes in figure.axes[:2])
    assert len(true_dots.get_offsets()) == 19
    assert len(dots.get_offsets()) == 20
    crosses, squares = (np.asarray(mark.get_offsets()) for mark in others)
    (noisy,) = np.flatnonzero(scored.sensors == 0)
    np.testing.assert_allclose(crosses, scored.alignment.aligned[[noisy]])
    assert len(squares) == 1
    assert np.abs(squares - scored.alignment.aligned).sum(axis=1).min() > 1e-6


def test_names_are_drawn_literally_on_few_or_coincident_sensors():
    facts, odd = dict.fromkeys(("names", "notes", "health"), UNFRIENDLY), "$\\frac{$\ud800\n"
    sensor_map = SensorMap(spread(len(UNFRIENDLY), 3), method=odd, units=odd, **facts)
    truth = spread(len(UNFRIENDLY), 3, seed=3)
    scored = score(sensor_map, truth, units=odd, permutations=0)
    for places in (*(spread(n, 3) for n in (1, 2, 3)), np.ones((7, 3))):
        assert figure_bytes(map_figure(SensorMap(places)), "svg")
    assert figure_bytes(map_figure(sensor_map), "pdf")
    assert figure_bytes(map_figure(sensor_map, scored), "svg")


def test_many_sensors_are_drawn_without_lines_and_as_pixels():
    count = MAX_JOINED + 1
    assert count > MAX_VECTOR_DOTS
    figure = map_figure(SensorMap(spread(count, 2)))
    assert "Lines join" not in texts(figure)
    (axes,) = figure.axes
    assert not any(len(line.get_xdata()) for line in axes.lines)
    assert all(dots.get_rasterized() for dots in axes.collections)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_map_gives_the_same_bytes_whatever_the_settings(kind, tmp_path):
    before = dict(mpl.rcParams)
    first = figure_bytes(map_figure(*compared(8, 3, 3)), kind)
    assert dict(mpl.rcParams) == before
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "red", "svg.hashsalt": "other"}):
        save_figure(map_figure(*compared(8, 3, 3)), tmp_path / f"map.{kind.upper()}")
    assert (tmp_path / f"map.{kind.upper()}").read_bytes() == first


coordinates = st.floats(-1e3, 1e3).map(lambda value: round(value, 3))
shapes = st.tuples(st.integers(1, 30), st.integers(2, 3))


@given(arrays(np.float64, shapes, elements=coordinates))
def test_colours_are_valid_and_independent_of_scale(places):
    colours = place_colours(places)
    assert colours.shape == (len(places), 3)
    assert ((colours >= 0) & (colours <= 1)).all()
    if np.ptp(places, axis=0).max() > 1:
        np.testing.assert_allclose(place_colours(4 * places + 8), colours, atol=1e-6)


def test_colours_differ_with_colour_vision_deficiencies():
    """Machado, Oliveira & Fernandes (2009), Table 1: protanopia and deuteranopia."""
    lattice = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    srgb = place_colours(lattice)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    for matrix in (
        [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
        [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    ):
        seen = np.clip(linear @ np.transpose(matrix), 0, 1) ** (1 / 2.4)
        apart = np.abs(seen[:, None] - seen).max(axis=2)
        assert apart[~np.eye(len(seen), dtype=bool)].min() > 16 / 255


@pytest.mark.parametrize("slant", [0.0, 0.5])
def test_neighbours_on_a_lattice_are_one_side_apart(slant):
    rows, columns = np.divmod(np.arange(48), 8)
    places = np.column_stack([columns + slant * rows, rows * np.sqrt(1 - slant**2)])
    distances = np.linalg.norm(places[:, None] - places, axis=2)
    expected = np.argwhere(np.triu(np.isclose(distances, 1)))
    np.testing.assert_array_equal(neighbour_pairs(places), expected)


@pytest.mark.parametrize("thin", [0, 1, 2])
def test_flat_bodies_are_not_seen_edge_on(thin):
    places = spread(80, 3)
    places[:, thin] *= 0.01
    right, up, _ = view_axes(best_view(places))
    seen = places @ np.column_stack([right, up])
    assert np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)[1] > 0.3 * 40 * np.sqrt(80)
