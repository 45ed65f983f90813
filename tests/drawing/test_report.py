"""Reports: complete and reproducible."""

import base64
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.drawing.report import Touches, check_writable, render_report, write_report
from anisomap.drawing.report.interactive import MAX_DOTS
from anisomap.drawing.report.report_text import MAX_ROWS, UNKNOWN, number
from anisomap.errors import FileError, MissingExtraError
from anisomap.evaluation import score
from anisomap.health import STATUSES
from anisomap.sensor_map import UNPLACED, SensorMap
from reports import PNG, Page, assessed, example, scene_of, summary


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first.html", "second.html"):
        sensor_map, scored = example()
        write_report(
            tmp_path / name, sensor_map, score=scored, health=assessed(sensor_map), figure_png=PNG
        )
    assert (tmp_path / "first.html").read_bytes() == (tmp_path / "second.html").read_bytes()


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
@pytest.mark.parametrize("true_dimensions", [None, 2, 3])
def test_plotly_accepts_every_view(true_dimensions: int | None, dimensions: int) -> None:
    sensor_map, scored = example(true_dimensions, min(dimensions, 3))
    if dimensions == 4:
        sensor_map = SensorMap(np.pad(sensor_map.positions, ((0, 0), (0, 1))))
    (component,) = scene_of(Page(render_report(sensor_map, score=scored)))
    in_space = max(true_dimensions or 1, dimensions) > 2
    kinds = {trace["type"] for trace in component["traces"].values()}
    assert kinds == {"scatter3d" if in_space else "scatter"}
    assert ("error" in component["colours"]) == (scored is not None)
    for colours in component["colours"].values():
        assert len(colours["color"]) == 12
        traces = dict(component["traces"])
        traces["map"] = traces["map"] | {"marker": traces["map"]["marker"] | colours}
        go.Figure(
            list(traces.values()), component["layout"]
        )  # raises for properties unknown to plotly
    axes = component["layout"]["scene"] if in_space else component["layout"]
    units = "arbitrary units" if scored is None else "mm"
    for axis in "xyz" if in_space else "xy":
        assert axes[f"{axis}axis"]["title"]["text"] == f"{axis} ({units})"
    if not in_space:
        assert axes["yaxis"]["scaleanchor"] == "x"
        return
    assert axes["aspectmode"] == "manual"
    lengths = [np.ptp(axes[f"{axis}axis"]["range"]) for axis in "xyz"]
    scales = np.divide(lengths, [axes["aspectratio"][axis] for axis in "xyz"])
    assert scales == pytest.approx(scales[0], rel=1e-4), "all axes have the same scale"


def test_a_flat_map_and_a_planar_truth_are_shown_in_2d() -> None:
    sensor_map, scored = example(2, 2)
    assert scored is not None
    in_space = score(sensor_map, np.pad(scored.truth, ((0, 0), (0, 1))), units="mm", permutations=0)
    (component,) = scene_of(Page(render_report(sensor_map, score=in_space)))
    assert component["traces"]["map"]["type"] == "scatter"
    assert "scene" not in component["layout"]


def test_a_flat_map_of_a_curved_truth_has_a_caveat() -> None:
    sensor_map, scored = example(3, 2)
    caveats = Page(render_report(sensor_map, score=scored)).texts["li"]
    assert any("fewer dimensions than the truth (2 and 3)" in caveat for caveat in caveats)


def test_the_view_shows_the_map_aligned_with_the_truth() -> None:
    sensor_map, scored = example()
    assert scored is not None
    (component,) = scene_of(Page(render_report(sensor_map, score=scored)))
    for what, expected in (("map", scored.alignment.aligned), ("truth", scored.truth)):
        shown_places = np.column_stack([component["traces"][what][axis] for axis in "xyz"])
        np.testing.assert_allclose(shown_places, expected, rtol=1e-4, atol=1e-3)
    assert component["names"] == list(sensor_map.names)
    for name, hover in zip(sensor_map.names, component["traces"]["map"]["hovertext"], strict=True):
        assert all(said in hover for said in (name, "health: unassessed", "component 1", " mm"))


def test_every_component_has_a_view() -> None:
    component = np.repeat([0, 1, 2, UNPLACED], [6, 4, 1, 1])
    positions = np.random.default_rng(0).normal(size=(12, 3))
    positions[-1] = np.nan
    sensor_map = SensorMap(positions, component=component)
    page = Page(render_report(sensor_map))
    assert [component["label"] for component in scene_of(page)] == [
        "Component 1: 6 sensors",
        "Component 2: 4 sensors",
    ]
    assert "separate components that share no frame" in page.text
    assert "Sensors without a position: s11" in page.text
    assert [row[2] for row in page.sensor_rows].count("not placed") == 1


def test_a_map_without_positions_has_no_view() -> None:
    page = Page(render_report(SensorMap(np.full((5, 3), np.nan))))
    assert "0 of 5 sensors have a position" in page.text
    assert "form" not in page.tags


@pytest.mark.parametrize("with_score", [True, False])
@pytest.mark.parametrize("with_health", [True, False])
def test_the_table_lists_every_sensor_and_the_worst_first(
    with_score: bool, with_health: bool
) -> None:
    statuses = (["ok"] * 5 + list(STATUSES))[:12]
    sensor_map, scored = example(3 if with_score else None, health=statuses)
    health = assessed(sensor_map) if with_health else ()
    page = Page(render_report(sensor_map, score=scored, health=health))
    rows = page.sensor_rows
    assert sorted(row[0] for row in rows) == sorted(sensor_map.names)
    assert {row[0]: row[1] for row in rows} == dict(
        zip(sensor_map.names, sensor_map.health, strict=True)
    )
    if scored is None:
        problems = [row[1] != "ok" for row in rows]
        assert problems == sorted(problems, reverse=True)
    if with_health:
        assert {row[-1] for row in rows} >= {f"looks {status}" for status in STATUSES[1:]}
    if scored is not None:
        errors = dict(zip(sensor_map.names, scored.alignment.errors, strict=True))
        worst_first = sorted(errors, key=lambda name: -errors[name])
        assert [row[0] for row in rows] == worst_first
        assert page.text.index(worst_first[0]) < page.text.index("The map is known up to")
        assert all(float(row[2]) == pytest.approx(errors[row[0]], rel=0.01) for row in rows)


def test_every_caveat_is_listed_once() -> None:
    notes = ("scaling did not converge", "two sensors never vary")
    sensor_map, scored = example(notes=notes)
    assert scored is not None
    scored = score(sensor_map, scored.truth, exclude=["s3"], units="mm", permutations=50)
    page = Page(render_report(sensor_map, score=scored, summary=summary("only 2 frames", notes[0])))
    listed = [text.lower() for text in page.texts["li"]]
    for caveat in (*notes, "only 2 frames", "1 of 12 sensors not compared: excluded"):
        assert listed.count(caveat) == 1
    for fact in ("2345", "-1.5 to 255", "87.5%", "unknown", "1 constant"):
        assert fact in page.text
    (component,) = scene_of(page)
    hover = dict(zip(component["names"], component["traces"]["map"]["hovertext"], strict=True))
    assert [name for name in hover if "not compared" in hover[name]] == ["s3"]
    assert "No warnings" in Page(render_report(example()[0])).text


def test_the_verdict_comes_first_with_the_scores() -> None:
    sensor_map, scored = example()
    assert scored is not None
    good = Page(render_report(sensor_map, score=scored))
    quantiles = scored.mantel.quantiles()
    assert good.text.index("very closely") < good.text.index("Null")
    for part in (
        f"Mantel r {scored.mantel.r:.3f}",
        f"min {quantiles[0.0]:.3f}, median {quantiles[0.5]:.3f}, max {quantiles[1.0]:.3f}",
        f"below {quantiles[0.95]:.3f}",
        f"{number(scored.rms)} mm",
        number(scored.rms_in_spacings, 2),
        "known up to rotation, translation, scale and reflection",
    ):
        assert part in good.text
    elsewhere = np.random.default_rng(8).normal(size=(12, 3))
    random = score(sensor_map, elsewhere, permutations=200)
    assert random.mantel.r < random.mantel.quantiles()[0.95]
    assert (
        "not agree with the truth better than random permutations"
        in Page(render_report(sensor_map, score=random)).text
    )
    flattened = SensorMap(sensor_map.positions * [1, 0, 0])
    coarse = Page(render_report(flattened, score=score(flattened, scored.truth, permutations=50)))
    for page, unreliable in ((good, False), (coarse, True)):
        assert ("Neighbourhoods are unreliable" in page.text) == unreliable
        assert ("not which sensors are neighbours" in page.text) == unreliable


def test_without_truth_the_verdict_gives_what_is_known() -> None:
    text = Page(render_report(example()[0])).text
    assert "12 of 12 sensors have a position." in text
    assert "Verdict: unknown." in text
    assert "known up to rotation, translation, scale and reflection" in text
    assert "0.125" in text
    assert "Mantel r" not in text.split("Method and provenance")[0].replace("expected Mantel r", "")


def test_a_score_without_null_is_reported_without_null() -> None:
    sensor_map, scored = example()
    assert scored is not None
    bare = score(sensor_map, scored.truth, permutations=0)
    text = Page(render_report(sensor_map, score=bare)).text
    assert "not computed" in text
    assert "random permutations of the sensors have" not in text


@pytest.mark.parametrize(
    ("units", "title"), [("mm", "95 % (mm)"), ("arbitrary", "95 %"), ("", "95 %")]
)
def test_the_column_of_ellipses_has_the_unit_of_the_map(units: str, title: str) -> None:
    covariances = np.tile(0.01 * np.eye(3), (12, 1, 1))
    sensor_map = replace(example()[0], covariances=covariances, units=units)
    header = next(row for row in Page(render_report(sensor_map)).rows if row[0] == "Sensor")
    assert title in map(str.strip, header)


def test_large_maps_are_shown_in_part() -> None:
    count = MAX_DOTS + 100
    health = ["ok"] * (count - 1) + ["dead"]
    truth = np.random.default_rng(0).normal(size=(count, 2))
    sensor_map = SensorMap(truth, approximate=True, health=health, provenance={"n_landmarks": 7})
    scored = score(sensor_map, truth, permutations=0)
    page = Page(render_report(sensor_map, score=scored))
    assert f"{count} sensors; the view shows {MAX_DOTS}" in page.text
    (component,) = scene_of(page)
    assert len(component["names"]) == MAX_DOTS
    assert f"s{count - 1}" in component["names"], "faulty sensors are shown"
    assert f"The first {MAX_ROWS} are listed; the other {count - MAX_ROWS}" in page.text
    assert len(page.sensor_rows) == MAX_ROWS
    assert [f"s{count - 1}", "dead"] in [row[:2] for row in page.sensor_rows]
    assert "This map is approximate" in page.text
    assert "n_landmarks" in page.text


def test_the_picture_is_embedded_and_described() -> None:
    sensor_map, scored = example()
    page = Page(render_report(sensor_map, score=scored, figure_png=PNG))
    (picture,) = page.values("src")
    assert base64.b64decode(picture.removeprefix("data:image/png;base64,")) == PNG
    (described,) = page.values("alt")
    assert "12 sensors" in described
    assert "img" not in Page(render_report(sensor_map, score=scored)).tags


def test_contacts_and_doubted_sensors_have_a_section() -> None:
    sensor_map, _ = example(None)
    told = Touches({"touch next": "around <b>s1</b>"}, b"map", b"series")
    page = render_report(sensor_map, touches=told)
    assert "How the skin was touched" in page
    assert "<b>s1</b>" not in page
    for png in (b"map", b"series"):
        assert base64.b64encode(png).decode() in page
    assert "How the skin was touched" not in render_report(sensor_map)


def test_a_failure_keeps_the_old_report(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    no_bytes: Any = "a text"
    with pytest.raises(TypeError):
        write_report(path, example()[0], figure_png=no_bytes)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_cannot_be_written_are_rejected(tmp_path: Path) -> None:
    for try_it in (check_writable, lambda path: write_report(path, example()[0])):
        with pytest.raises(FileError, match="does not exist"):
            try_it(tmp_path / "nowhere" / "report.html")
        with pytest.raises(FileError, match="it is a folder"):
            try_it(tmp_path)
        for name in ("report.pdf", "report", "html"):
            with pytest.raises(FileError, match=r"must end in \.html or \.htm"):
                try_it(tmp_path / name)
    for name in ("report.html", "report.HTM"):
        check_writable(tmp_path / name)
    assert not list(tmp_path.iterdir()), "the check writes nothing"


@pytest.mark.parametrize("library", ["jinja2", "plotly"])
def test_without_the_extra_the_error_names_it(
    monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    for module in [name for name in sys.modules if name.split(".")[0] == library]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, library, None)
    for call in (lambda: render_report(example()[0]), lambda: check_writable("report.html")):
        with pytest.raises(MissingExtraError, match=r"a report needs .*anisomap\[report\]"):
            call()


@given(st.floats(-1e9, 1e9), st.integers(1, 6))
def test_numbers_keep_their_significant_digits(value: float, digits: int) -> None:
    assert float(number(value, digits)) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))


@pytest.mark.parametrize("nothing", [None, float("nan"), float("inf"), -float("inf")])
def test_unknown_numbers_are_dashes(nothing: float | None) -> None:
    assert number(nothing, unit="mm") == UNKNOWN
