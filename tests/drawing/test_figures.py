"""Pictures: what is in them, that they are true to the map, and that they repeat."""

import io
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from anisomap.drawing.figures import KINDS, check_writable, figure_bytes, map_figure, save_figure
from anisomap.drawing.view import (
    VIEWS,
    best_view,
    bodies,
    neighbour_pairs,
    place_colours,
    shown,
    view_axes,
)
from anisomap.errors import FileError, InputError, MissingExtraError
from anisomap.evaluation import Score, score
from anisomap.sensor_map import UNPLACED, SensorMap

UNFRIENDLY = (
    "$\\frac{$",
    "a_b^c$",
    "日本",
    "line\nbreak",
    "\x00\u202e\ud800",
    "<b>",
    "n" * 300,
    "%s{}",
)


def spread(n_sensors: int, dimensions: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(size=(n_sensors, dimensions)) * 40


def mapped(truth: NDArray[np.float64], dimensions: int, **rest: object) -> SensorMap:
    """A map of sensors near their true places, turned, mirrored, scaled and moved."""
    rng = np.random.default_rng(1)
    places = np.pad(truth, ((0, 0), (0, 3)))[:, :dimensions]
    places = places + rng.normal(size=places.shape)
    turn = np.linalg.qr(rng.normal(size=(dimensions, dimensions)))[0]
    return SensorMap(0.01 * places @ turn + 5, method="r-anisomap", **rest)


def compared(n_sensors: int, true_dimensions: int, dimensions: int) -> tuple[SensorMap, Score]:
    truth = spread(n_sensors, true_dimensions)
    sensor_map = mapped(truth, dimensions)
    return sensor_map, score(sensor_map, truth, units="mm", permutations=20)


def in_pieces() -> SensorMap:
    """Pieces of 12, 6 and 5 sensors, one alone, and one that is not placed."""
    component = np.repeat([0, 1, 2, 3, UNPLACED], [12, 6, 5, 1, 1])
    positions = spread(25, 3)
    positions[-1] = np.nan
    return SensorMap(positions, component=component)


def spaces(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.name == "3d"]


def texts(figure: Figure) -> str:
    titles = [axes.get_title() for axes in figure.axes]
    return "\n".join([text.get_text() for text in figure.texts] + titles)


def opened(content: bytes) -> NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


@pytest.mark.parametrize("dimensions", [1, 2, 3])
@pytest.mark.parametrize("true_dimensions", [2, 3])
@pytest.mark.parametrize("n_sensors", [4, 90])
def test_truth_map_and_distances_stand_side_by_side(
    n_sensors: int, true_dimensions: int, dimensions: int
) -> None:
    figure = map_figure(*compared(n_sensors, true_dimensions, dimensions))
    truth, found, distances = figure.axes
    in_space = max(true_dimensions, dimensions) > 2
    assert len(spaces(figure)) == (2 if in_space else 0)
    for axis in "xyz" if in_space else "xy":
        assert getattr(truth, f"get_{axis}label")() == f"{axis} (mm)"
        limits = [getattr(axes, f"get_{axis}lim")() for axes in (truth, found)]
        assert limits[0] == limits[1], "one scale for both"
    assert "(mm)" in distances.get_xlabel()
    assert "(mm)" in distances.get_ylabel()
    assert distances.get_xlim() == distances.get_ylim()
    assert distances.get_aspect() == 1.0


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_millimetre_is_as_long_on_every_axis(dimensions: int) -> None:
    truth = spread(30, dimensions) * [1, 0.2, 0.05][:dimensions]
    figure = map_figure(*((m := mapped(truth, dimensions)), score(m, truth, permutations=0)))
    for axes in figure.axes[:2]:
        if dimensions == 2:
            assert axes.get_aspect() == 1.0
        else:
            limits = [getattr(axes, f"get_{axis}lim")() for axis in "xyz"]
            ratios = np.ptp(limits, axis=1) / axes._box_aspect
            assert ratios == pytest.approx(ratios[0])


def test_every_sensor_is_drawn_where_it_belongs_in_one_colour() -> None:
    sensor_map, scored = compared(40, 2, 2)
    figure = map_figure(sensor_map, scored)
    drawn = []
    for axes in figure.axes[:2]:
        (dots,) = axes.collections
        drawn.append((np.asarray(dots.get_offsets()), dots.get_facecolor()))
    (true_places, true_colours), (places, colours) = drawn
    np.testing.assert_allclose(true_places, scored.truth)
    np.testing.assert_allclose(places, scored.alignment.aligned)
    np.testing.assert_array_equal(true_colours, colours)


def test_the_picture_shows_what_its_panels_promise() -> None:
    picture = opened(figure_bytes(map_figure(*compared(60, 3, 3))))
    height, width, _ = picture.shape
    assert width > 1500
    colourful = np.ptp(picture.astype(int), axis=2) > 40
    for left, right in ((0.05, 0.33), (0.38, 0.65), (0.72, 0.98)):
        panel = colourful[
            int(0.2 * height) : int(0.8 * height), int(left * width) : int(right * width)
        ]
        assert panel.mean() > 0.002, "a panel is empty"
    for edge in (picture[:8], picture[-8:], picture[:, :8], picture[:, -8:]):
        assert (edge == 255).all(), "something runs off the picture"


def test_the_title_says_how_good_the_map_is() -> None:
    sensor_map, scored = compared(30, 3, 3)
    said = texts(map_figure(sensor_map, scored))
    assert f"r-anisomap, 30 sensors, Mantel r {scored.mantel.r:.3f}" in said
    assert f"null 95 %: {scored.mantel.quantiles()[0.95]:.2f}" in said
    assert f"{scored.rms:.3g} mm" in said
    assert "null" not in texts(
        map_figure(sensor_map, score(sensor_map, scored.truth, permutations=0))
    )


@pytest.mark.parametrize(("dimensions", "n_panels"), [(1, 1), (2, 1), (3, 3), (5, 3)])
def test_without_truth_the_map_is_shown_alone_and_its_limits_are_said(
    dimensions: int, n_panels: int
) -> None:
    figure = map_figure(SensorMap(spread(30, dimensions)))
    assert len(figure.axes) == n_panels
    assert "known up to rotation, translation, scale and mirror image" in texts(figure)
    assert all("arbitrary units" in axes.get_xlabel() for axes in figure.axes)


def test_of_many_dimensions_three_are_drawn() -> None:
    sensor_map, scored = compared(30, 3, 6)
    figure = map_figure(sensor_map, scored)
    assert len(spaces(figure)) == 2
    assert "the first three of 6 dimensions" in texts(figure)


def test_pieces_have_panels_of_their_own() -> None:
    sensor_map = in_pieces()
    alone = map_figure(sensor_map)
    assert [axes.get_title().split(":")[0] for axes in alone.axes] == [
        "Piece 1",
        "Piece 2",
        "Piece 3",
    ]
    for said in ("separate pieces", "single sensor, not drawn: 1", "Not on the map: s24"):
        assert said in texts(alone).replace("\n", " ")
    scored = score(sensor_map, np.nan_to_num(sensor_map.positions), permutations=0)
    titles = [axes.get_title() for axes in map_figure(sensor_map, scored).axes]
    assert [title.split(":")[0] for title in titles[3:]] == ["Piece 2", "Piece 3"]


def test_many_pieces_do_not_make_an_endless_picture() -> None:
    figure = map_figure(SensorMap(spread(60, 2), component=np.repeat(np.arange(30), 2)))
    assert len(figure.axes) < 30
    assert f"not drawn: {30 - len(figure.axes)}" in texts(figure)


def test_unhealthy_and_uncompared_sensors_are_marked() -> None:
    truth = spread(20, 2)
    plain = mapped(truth, 2)
    marked = mapped(truth, 2, health=["noisy"] + ["ok"] * 19, excluded=np.arange(20) == 5)
    for sensor_map, marks in ((plain, set()), (marked, {"unhealthy", "not compared"})):
        figure = map_figure(sensor_map, score(sensor_map, truth, permutations=0))
        legends = [label.get_text() for legend in figure.legends for label in legend.get_texts()]
        assert set(legends) == marks
    (true_dots, *_), (dots, *others) = (axes.collections for axes in figure.axes[:2])
    assert len(true_dots.get_offsets()) == 19
    assert len(dots.get_offsets()) == 20
    assert len(others) == 2


def test_names_are_drawn_as_they_are() -> None:
    sensor_map = SensorMap(
        spread(len(UNFRIENDLY), 3),
        names=UNFRIENDLY,
        method="$\\frac{$",
        units="$\\frac{$\ud800\n",
        notes=UNFRIENDLY,
        health=UNFRIENDLY,
    )
    truth = spread(len(UNFRIENDLY), 3, seed=3)
    for scored in (None, score(sensor_map, truth, units="$\\frac{$\ud800\n", permutations=0)):
        for kind in KINDS:
            assert figure_bytes(map_figure(sensor_map, scored), kind)


@pytest.mark.parametrize("n_sensors", [1, 2, 3])
def test_a_handful_of_sensors_can_be_drawn(n_sensors: int) -> None:
    assert figure_bytes(map_figure(SensorMap(spread(n_sensors, 3))))


def test_sensors_in_one_place_can_be_drawn() -> None:
    assert figure_bytes(map_figure(SensorMap(np.ones((7, 3)))))


def test_a_map_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="no sensor"):
        map_figure(SensorMap(np.full((5, 3), np.nan)))


def test_thousands_of_sensors_can_be_drawn() -> None:
    picture = opened(figure_bytes(map_figure(*compared(2000, 3, 3))))
    assert (picture < 200).any()


@pytest.mark.parametrize("kind", KINDS)
def test_same_map_same_bytes(kind: str, tmp_path: Path) -> None:
    first, second = (figure_bytes(map_figure(*compared(30, 3, 3)), kind) for _ in range(2))
    assert first == second
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "red", "svg.hashsalt": "other"}):
        assert figure_bytes(map_figure(*compared(30, 3, 3)), kind) == first
    save_figure(map_figure(*compared(30, 3, 3)), tmp_path / f"map.{kind.upper()}")
    assert (tmp_path / f"map.{kind.upper()}").read_bytes() == first


def test_drawing_leaves_no_trace_in_matplotlib() -> None:
    before = dict(mpl.rcParams)
    figure_bytes(map_figure(*compared(30, 3, 3)))
    assert dict(mpl.rcParams) == before
    code = (
        "import sys, numpy, anisomap.drawing.figures as f;"
        "from anisomap.sensor_map import SensorMap;"
        "assert 'matplotlib' not in sys.modules;"
        "f.figure_bytes(f.map_figure(SensorMap(numpy.eye(3))));"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


class Undrawable(Artist):
    def draw(self, renderer: RendererBase) -> None:
        raise MemoryError


def test_a_failure_leaves_the_old_picture_whole(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    path.write_bytes(b"old")
    figure = map_figure(SensorMap(spread(5, 2)))
    figure.add_artist(Undrawable())
    with pytest.raises(MemoryError):
        save_figure(figure, path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_places_that_cannot_be_written_to_are_named(tmp_path: Path) -> None:
    figure = map_figure(SensorMap(spread(5, 2)))
    for try_it in (check_writable, lambda path: save_figure(figure, path)):
        for name in ("map.jpg", "map", "png"):
            with pytest.raises(FileError, match="png"):
                try_it(tmp_path / name)
        with pytest.raises(FileError, match="no folder"):
            try_it(tmp_path / "nowhere" / "map.png")
    check_writable(tmp_path / "map.PNG")
    assert not list(tmp_path.iterdir()), "to ask writes nothing"
    with pytest.raises(InputError, match="gif"):
        figure_bytes(figure, "gif")


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.startswith("anisomap.drawing.figures._")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"a picture needs .*anisomap\[report\]"):
        map_figure(SensorMap(spread(5, 2)))
    with pytest.raises(MissingExtraError):
        check_writable("map.png")


points = arrays(
    np.float64,
    st.tuples(st.integers(1, 30), st.integers(2, 3)),
    elements=st.floats(-1e3, 1e3).map(lambda value: round(value, 3)),
)


@given(points)
def test_colours_are_colours_and_do_not_know_the_scale(places: NDArray[np.float64]) -> None:
    colours = place_colours(places)
    assert colours.shape == (len(places), 3)
    assert ((colours >= 0) & (colours <= 1)).all()
    if np.ptp(places, axis=0).max() > 1:
        np.testing.assert_allclose(place_colours(4 * places + 8), colours, atol=1e-6)


def test_colours_differ_for_the_colour_blind_too() -> None:
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


def edges_of_length(places: NDArray[np.float64], length: float) -> set[tuple[int, int]]:
    distances = np.linalg.norm(places[:, None] - places, axis=2)
    return {(i, j) for i, j in np.argwhere(np.isclose(distances, length)).tolist() if i < j}


@pytest.mark.parametrize("slant", [0.0, 0.5])
def test_neighbours_on_a_lattice_are_those_a_side_apart(slant: float) -> None:
    rows, columns = np.divmod(np.arange(48), 8)
    places = np.column_stack([columns + slant * rows, rows * np.sqrt(1 - slant**2)])
    assert {tuple(pair) for pair in neighbour_pairs(places).tolist()} == edges_of_length(places, 1)


def test_neighbours_do_not_bridge_a_gap() -> None:
    places = np.random.default_rng(0).uniform(size=(60, 2))
    places[30:, 0] += 4
    assert all((i < 30) == (j < 30) for i, j in neighbour_pairs(places))


@given(points, st.randoms(use_true_random=False))
def test_neighbours_do_not_depend_on_the_order(places: NDArray[np.float64], random: object) -> None:
    places = np.unique(places, axis=0)
    order = list(range(len(places)))
    random.shuffle(order)
    pairs = neighbour_pairs(places)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    back = np.sort(np.array(order)[neighbour_pairs(places[order])], axis=1)
    if len(np.unique(np.round(np.linalg.norm(places[:, None] - places, axis=2), 6))) > (
        len(places) * (len(places) - 1) // 2
    ):  # only where no two distances tie: of tied candidates either may be taken
        assert sorted(map(tuple, back.tolist())) == sorted(map(tuple, pairs.tolist()))


@given(st.floats(-89, 89), st.floats(-180, 180))
def test_a_view_is_a_right_handed_frame(elevation: float, azimuth: float) -> None:
    axes = view_axes((elevation, azimuth))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[0, 2] == 0, "the horizon is level"


@pytest.mark.parametrize("thin", [0, 1, 2])
def test_no_flat_body_is_seen_edge_on(thin: int) -> None:
    places = spread(80, 3)
    places[:, thin] *= 0.01
    right, up, _ = view_axes(best_view(places))
    seen = places @ np.column_stack([right, up])
    assert np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)[1] > 0.3 * 40 * np.sqrt(80)


def test_a_round_body_is_seen_from_the_usual_side() -> None:
    ball = spread(400, 3)
    assert best_view(ball / np.linalg.norm(ball, axis=1, keepdims=True)) == VIEWS[0]


@settings(max_examples=30)
@given(st.integers(1, 3), st.integers(2, 3), st.integers(0, 100))
def test_a_body_laid_on_the_truth_has_the_errors_of_the_score(
    dimensions: int, true_dimensions: int, seed: int
) -> None:
    truth = spread(9, true_dimensions, seed)
    sensor_map = SensorMap(spread(9, dimensions, seed + 1), excluded=np.arange(9) % 4 == 3)
    scored = score(sensor_map, truth, permutations=0)
    (body,) = bodies(sensor_map, scored)
    assert sorted(body.sensors) == list(range(9))
    errors = np.linalg.norm(body.points[body.compared] - body.truth, axis=1)
    np.testing.assert_allclose(errors, scored.alignment.errors)


@given(st.text(), st.integers(1, 20))
def test_any_text_can_be_shown(text: str, longest: int) -> None:
    clean = shown(text, longest)
    assert clean.isprintable()
    assert len(clean) == min(len(text), longest)
    clean.encode()
