"""Reports: complete and reproducible."""

import base64
import math
import sys
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.base.wording import UNKNOWN, number
from anisomap.drawing.report import MAX_ROWS, Touches, check_writable, render_report
from anisomap.drawing.report.interactive import MAX_DOTS
from anisomap.errors import MissingExtraError
from anisomap.evaluation import score
from anisomap.health import STATUSES
from anisomap.sensor_map import UNPLACED, SensorMap, is_faulty
from anisomap.usability import Verdict
from reports import PNG, assessed, example, page_of, scene_of, summary


def test_the_same_input_gives_the_same_text():
    first, again = (
        render_report(made, score=scored, health=assessed(made), figure_png=PNG)
        for made, scored in (example(), example())
    )
    assert first == again


@pytest.mark.parametrize(
    ("true_dimensions", "dimensions"), [(None, 1), (None, 4), (2, 2), (2, 3), (3, 2), (3, 3)]
)
def test_plotly_accepts_every_view(true_dimensions, dimensions):
    sensor_map, scored = example(true_dimensions, min(dimensions, 3))
    if dimensions == 4:
        sensor_map = SensorMap(np.pad(sensor_map.positions, ((0, 0), (0, 1))))
    (component,) = scene_of(page_of(sensor_map, scored))
    in_space = max(true_dimensions or 1, dimensions) > 2
    kinds = {trace["type"] for trace in component["traces"].values()}
    assert kinds == {"scatter3d" if in_space else "scatter"}
    assert ("error" in component["colours"]) == (scored is not None)
    traces = component["traces"]
    for colours in component["colours"].values():
        assert len(colours["color"]) == 12
        coloured = traces["map"] | {"marker": traces["map"]["marker"] | colours}
        # Raises for properties that plotly does not know.
        go.Figure([*traces.values(), coloured], component["layout"])
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


def test_the_view_shows_the_map_aligned_with_the_truth():
    sensor_map, scored = example()
    (component,) = scene_of(page_of(sensor_map, scored))
    for what, expected in (("map", scored.alignment.aligned), ("truth", scored.truth)):
        shown_places = np.column_stack([component["traces"][what][axis] for axis in "xyz"])
        np.testing.assert_allclose(shown_places, expected, rtol=1e-4, atol=1e-3)
    assert component["names"] == list(sensor_map.names)
    for name, hover in zip(sensor_map.names, component["traces"]["map"]["hovertext"], strict=True):
        assert all(said in hover for said in (name, "health: unassessed", "component 1", " mm"))


def test_every_component_has_a_view():
    component = np.repeat([0, 1, 2, UNPLACED], [6, 4, 1, 1])
    positions = np.random.default_rng(0).normal(size=(12, 3))
    positions[-1] = np.nan
    sensor_map = SensorMap(positions, component=component)
    page = page_of(sensor_map)
    labels = [component["label"] for component in scene_of(page)]
    assert labels == ["Component 1: 6 sensors", "Component 2: 4 sensors"]
    assert "separate components that share no frame" in page.text
    assert "Sensors without a position: s11" in page.text
    assert [row[2] for row in page.sensor_rows].count("not placed") == 1
    nowhere = page_of(SensorMap(np.full((5, 3), np.nan)))
    assert "0 of 5" in nowhere.text
    assert "form" not in nowhere.tags


@pytest.mark.parametrize("with_score", [True, False])
@pytest.mark.parametrize("with_health", [True, False])
def test_the_table_lists_every_sensor_and_the_worst_first(with_score, with_health):
    statuses = (["ok"] * 5 + list(STATUSES))[:12]
    sensor_map, scored = example(3 if with_score else None, health=statuses)
    health = assessed(sensor_map) if with_health else ()
    page = page_of(sensor_map, scored, health=health)
    rows = page.sensor_rows
    known = zip(sensor_map.names, sensor_map.health, strict=True)
    assert sorted((row[0], row[1]) for row in rows) == sorted(known)
    if with_health:
        assert {row[-1] for row in rows} >= {f"looks {status}" for status in STATUSES[1:]}
    if scored is None:
        problems = [is_faulty(row[1]) for row in rows]
        assert problems == sorted(problems, reverse=True)
        return
    worst_first = np.argsort(-scored.alignment.errors)
    assert [row[0] for row in rows] == [sensor_map.names[i] for i in worst_first]
    assert page.text.index(rows[0][0]) < page.text.index("The map is known up to")
    shown = [float(row[2]) for row in rows]
    np.testing.assert_allclose(shown, scored.alignment.errors[worst_first], rtol=0.01)


def test_every_caveat_is_listed_once():
    notes = ("scaling did not converge", "two sensors never vary")
    sensor_map, scored = example(notes=notes)
    scored = score(sensor_map, scored.truth, exclude=["s3"], units="mm", permutations=50)
    page = page_of(sensor_map, scored, summary=summary("only 2 frames", notes[0]))
    listed = [text.lower() for text in page.texts["li"]]
    for caveat in (*notes, "only 2 frames", "1 of 12 sensors not compared: excluded"):
        assert listed.count(caveat) == 1
    for fact in ("2345", "-1.5 to 255", "87.5%", "unknown", "1 constant"):
        assert fact in page.text
    (component,) = scene_of(page)
    hover = dict(zip(component["names"], component["traces"]["map"]["hovertext"], strict=True))
    assert [name for name in hover if "not compared" in hover[name]] == ["s3"]
    assert "No warnings" in page_of(example()[0]).text
    caveats = page_of(*example(3, 2)).texts["li"]
    assert any("fewer dimensions than the truth (2 and 3)" in caveat for caveat in caveats)


def test_the_verdict_comes_first_with_the_scores():
    sensor_map, scored = example()
    good = page_of(sensor_map, scored)
    quantiles = scored.mantel.quantiles()
    assert good.text.index("Verdict: cannot tell.") < good.text.index("Null")
    for part in (
        f"{scored.mantel.r:.3f}",
        f"min {quantiles[0.0]:.3f}, median {quantiles[0.5]:.3f}, max {quantiles[1.0]:.3f}",
        f"{quantiles[0.95]:.3f}",
        f"{number(scored.rms)} mm",
        number(scored.rms_in_spacings, 3),
        "known up to rotation, translation, scale and reflection",
    ):
        assert part in good.text
    elsewhere = np.random.default_rng(8).normal(size=(12, 3))
    random = score(sensor_map, elsewhere, permutations=200)
    assert random.mantel.r < random.mantel.quantiles()[0.95]
    said = page_of(sensor_map, random).text
    assert "no better than random permutations" in said
    assert "no better than random permutations" not in good.text
    flattened = SensorMap(sensor_map.positions * [1, 0, 0])
    coarse = page_of(flattened, score(flattened, scored.truth, permutations=0))
    assert "not computed" in coarse.text
    assert "no better than random permutations" not in coarse.text


def test_without_truth_the_verdict_gives_what_is_known():
    judged = Verdict("usable", expected_error=0.25, reasons=("halves agree", "contacts vary"))
    told = page_of(replace(example()[0], verdict=judged)).text
    assert [told.count(sentence) for sentence in judged.sentences] == [1] * 4
    text = page_of(example()[0]).text
    pose = "known up to rotation, translation, scale and reflection"
    for part in ("12 of 12", "Verdict: cannot tell.", pose, "0.125"):
        assert part in text
    assert "Mantel r" not in text.split("Method and provenance")[0].replace("expected Mantel r", "")


def test_ellipses_have_the_unit_of_the_errors_beside_them():
    sensor_map, scored = example(3, 3, covariances=np.tile(0.01 * np.eye(3), (12, 1, 1)))
    positions, covariances = sensor_map.positions / 1000, sensor_map.covariances / 1e6
    smaller = replace(sensor_map, positions=positions, covariances=covariances, units="m")
    again = score(smaller, scored.truth, units="mm", permutations=0)
    page, same = page_of(sensor_map, scored), page_of(smaller, again)
    assert page.sensor_rows == same.sensor_rows
    assert {"Error (mm)", "95 % (mm)"} <= set(same.header)
    assert "95 % (m)" in page_of(smaller).header


def test_large_maps_are_shown_in_part():
    count = MAX_DOTS + 100
    health = ["ok"] * (count - 1) + ["dead"]
    truth = np.random.default_rng(0).normal(size=(count, 2))
    sensor_map = SensorMap(truth, approximate=True, health=health, provenance={"n_landmarks": 7})
    scored = score(sensor_map, truth, permutations=0)
    page = page_of(sensor_map, scored)
    assert f"{count} sensors; the view shows {MAX_DOTS}" in page.text
    (component,) = scene_of(page)
    assert len(component["names"]) == MAX_DOTS
    assert f"s{count - 1}" in component["names"], "faulty sensors are shown"
    assert f"The first {MAX_ROWS} are listed; the other {count - MAX_ROWS}" in page.text
    assert len(page.sensor_rows) == MAX_ROWS
    assert [f"s{count - 1}", "dead"] in [row[:2] for row in page.sensor_rows]
    assert "This map is approximate" in page.text
    assert "n_landmarks" in page.text


def test_pictures_are_embedded_and_described():
    sensor_map, scored = example()
    told = Touches({"touch next": "around <b>s1</b>"}, b"map", b"series")
    page = page_of(sensor_map, scored, figure_png=PNG, touches=told)
    sources = [text.removeprefix("data:image/png;base64,") for text in page.values("src")]
    assert [base64.b64decode(source) for source in sources] == [PNG, b"map", b"series"]
    assert any("12 sensors" in described for described in page.values("alt"))
    assert "How the skin was touched" in page.text
    assert "around <b>s1</b>" in page.text, "shown as text"
    bare = page_of(sensor_map, scored)
    assert "img" not in bare.tags
    assert "How the skin was touched" not in bare.text


@pytest.mark.parametrize("library", ["jinja2", "plotly"])
def test_without_the_extra_the_error_names_it(monkeypatch, library):
    for module in [name for name in sys.modules if name.split(".")[0] == library]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, library, None)
    for call in (lambda: render_report(example()[0]), lambda: check_writable("report.html")):
        with pytest.raises(MissingExtraError, match=r"a report needs .*anisomap\[report\]"):
            call()


@given(st.floats(-1e9, 1e9), st.integers(1, 6))
def test_numbers_keep_their_significant_digits(value, digits):
    assert float(number(value, digits)) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))
    for nothing in (None, math.nan, math.inf, -math.inf):
        assert number(nothing, unit="mm") == UNKNOWN
