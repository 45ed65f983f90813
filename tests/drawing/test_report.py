"""Reports: what they show, that they are self-contained, and safe with any names."""

import base64
import hashlib
import math
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.base.wording import UNKNOWN, number, printable
from anisomap.drawing.report import MAX_DOTS, MAX_ROWS, Touches, render_report, write_report
from anisomap.evaluation import score
from anisomap.health import STATUSES, SensorHealth, touch_coverage
from anisomap.map_verdict import Verdict
from anisomap.recording import Recording
from anisomap.sensor_map import UNPLACED, SensorMap, is_faulty
from reports import Page, assessed, example, page_of, scene_of, summary

HOSTILE = (
    "</script><script>alert(1)</script>",
    "<img src=x onerror=alert(2)>",
    '"><svg onload=alert(3)>',
    "';alert(4)//",
    "{{ 7 * 7 }}{% raw %}",
    '%{x}<a href="https://example.org/">link</a>',
    "javascript:alert(5)",
    "<!--<script>",
    "&lt;script&gt;alert(6)&lt;/script&gt;",
    "\u2028\u202e\x00\ud800",
    "</style></textarea></title>",
    "plain",
)


def lattice(n_rows):
    return np.argwhere(np.ones((n_rows, n_rows))).astype(float)


def touched(sensor_map):
    """Every sensor has ten contacts but the first, and neighbours are never touched together."""
    readings = np.kron(np.eye(sensor_map.n_sensors), np.ones((10, 1)))
    readings[:, 0] = 0
    readings = np.insert(readings, range(len(readings)), 0, axis=0)
    coverage = touch_coverage(sensor_map, Recording(readings, names=sensor_map.names))
    return Touches({"touch next": "around <b>s1</b>"}, coverage, b"series")


@pytest.mark.parametrize(
    ("true_dimensions", "dimensions"), [(None, 1), (None, 4), (2, 2), (2, 3), (3, 2), (3, 3)]
)
def test_the_view_holds_every_sensor_at_its_place_with_its_unit(true_dimensions, dimensions):
    sensor_map, scored = example(true_dimensions, min(dimensions, 3))
    if dimensions == 4:
        sensor_map = SensorMap(np.pad(sensor_map.positions, ((0, 0), (0, 1))))
    (view,) = scene_of(page_of(sensor_map, scored))
    drawn = min(max(true_dimensions or 2, dimensions), 3)
    assert np.shape(view["points"]) == (12, drawn)
    assert (view["view"] is None) == (drawn == 2)
    assert view["units"] == ("arbitrary units" if scored is None else "mm")
    assert view["names"] == list(sensor_map.names)
    assert len(view["pairs"])
    if scored is not None:
        places = np.pad(scored.truth, ((0, 0), (0, drawn - scored.truth.shape[1])))
        for key, expected in (("points", scored.alignment.aligned), ("truth", places)):
            np.testing.assert_allclose(view[key], expected, atol=1e-3 * np.ptp(expected))
        errors = view["colours"]["error"]["ramp"]
        np.testing.assert_allclose(errors, scored.alignment.errors, rtol=1e-3)


def test_every_component_has_a_view():
    component = np.repeat([0, 1, 2, UNPLACED], [6, 4, 1, 1])
    positions = np.random.default_rng(0).normal(size=(12, 3))
    positions[-1] = np.nan
    page = page_of(SensorMap(positions, component=component))
    labels = [component["label"] for component in scene_of(page)]
    assert labels == ["Component 1: 6 sensors", "Component 2: 4 sensors"]
    assert "separate components that share no frame" in page.text
    assert "Sensors without a position: s11" in page.text
    assert [row[2] for row in page.sensor_rows].count("not placed") == 1
    nowhere = page_of(SensorMap(np.full((5, 3), np.nan)))
    assert "0 of 5" in nowhere.text
    assert "form" not in nowhere.tags


def test_ellipses_are_offered_only_where_they_differ():
    sensor_map, scored = example(2, 2)
    alike = replace(sensor_map, covariances=np.tile(0.01 * np.eye(2), (12, 1, 1)))
    unlike = replace(alike, covariances=alike.covariances * np.arange(1, 13)[:, None, None])
    for made, offered in ((sensor_map, False), (alike, False), (unlike, True)):
        page = page_of(made, scored)
        assert ("ellipses" in scene_of(page)[0]) == offered
        assert ("ellipses" in page.values("name")) == offered
        assert ("95% (mm)" in page.header) == offered
    checked = [name for tag, name, _ in page.attributes if tag == "input" and name == "checked"]
    assert len(checked) == 1, "only neighbours are shown at first"
    metres = replace(
        unlike, positions=unlike.positions / 1000, covariances=unlike.covariances / 1e6, units="m"
    )
    again = page_of(metres, score(metres, scored.truth, units="mm", permutations=0))
    assert again.sensor_rows == page.sensor_rows, "in the unit of the errors beside them"


def test_contacts_are_a_colour_of_the_one_map():
    sensor_map = SensorMap(lattice(4))
    page = page_of(sensor_map, touches=touched(sensor_map))
    (view,) = scene_of(page)
    contacts = view["colours"]["contacts"]
    assert contacts["values"] == [0] + [10] * 15
    assert [contacts["classes"][k][0] for k in contacts["of"]] == ["none"] + ["5 to 11"] * 15
    assert [0, 1] in contacts["apart"]
    assert any(0 in place for place in contacts["places"])
    assert [0, 1] in view["pairs"]
    sources = [text.removeprefix("data:image/png;base64,") for text in page.values("src")]
    assert [base64.b64decode(source) for source in sources] == [b"series"]
    assert page.tags.count("canvas") == 1
    assert "around <b>s1</b>" in page.text, "shown as text"


def test_exchanged_sensors_are_named():
    sensor_map = SensorMap(lattice(6)[[0, 20, *range(2, 20), 1, *range(21, 36)]])
    scored = score(sensor_map, lattice(6), units="mm", permutations=0)
    assert scored.exchanged == ((1, 20),)
    page = page_of(sensor_map, scored)
    assert "These look exchanged (run anisomap check): s1 and s20." in page.text
    reasons = {row[0]: row[-1] for row in page.sensor_rows if row[-1]}
    assert reasons == {
        "s1": "looks exchanged with s20: run anisomap check",
        "s20": "looks exchanged with s1: run anisomap check",
    }
    assert not score(SensorMap(lattice(6)), lattice(6), permutations=0).exchanged


@pytest.mark.parametrize("with_score", [True, False])
@pytest.mark.parametrize("with_health", [True, False])
def test_the_table_lists_every_sensor_and_the_worst_first(with_score, with_health):
    statuses = ["ok"] * (12 - len(STATUSES)) + list(STATUSES)
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
    (view,) = scene_of(page)
    assert [view["names"][i] for i in view["uncompared"]] == ["s3"]
    assert "No warnings" in page_of(example()[0]).text
    caveats = page_of(*example(3, 2)).texts["li"]
    assert any("fewer dimensions than the truth (2 and 3)" in caveat for caveat in caveats)


def test_the_verdict_comes_first_and_nothing_is_said_twice():
    sensor_map, scored = example()
    good = page_of(sensor_map, scored)
    assert good.text.index("Verdict: cannot tell.") < good.text.index("Mantel r")
    for part in (
        f"{scored.mantel.r:.3f}",
        f"at most {scored.mantel.quantiles()[0.95]:.3f} in 95% of random permutations",
        f"{number(scored.rms)} mm",
        number(scored.rms_in_spacings, 3),
        "known up to rotation, translation, scale and reflection",
    ):
        assert part in good.text
    random = score(sensor_map, np.random.default_rng(8).normal(size=(12, 3)), permutations=200)
    assert "no better than random permutations" in page_of(sensor_map, random).text
    assert "no better than random permutations" not in good.text
    errors = dict.fromkeys(("expected_error", "region_error"), 0.25)
    for low in ("expected_error_low", "region_error_low", "neighbours_kept_low"):
        errors |= {low: 0.1, low.replace("low", "high"): 0.5}
    judged = Verdict("usable", **errors, neighbours_kept=0.9, reasons=("halves agree",))
    provenance = {"elbow_1": 0.785, "source": "day 1"}
    page = page_of(replace(sensor_map, verdict=judged, provenance=provenance))
    assert [page.text.count(sentence) for sentence in judged.told()] == [1] * 4
    assert page.text.count("0.25") == 1
    assert "up to the expected error" not in page.text
    assert "elbow" not in page.text
    assert "day 1" in page.text


def test_reports_of_large_maps_are_small():
    n_sensors = MAX_DOTS + 100
    health = ["ok"] * (n_sensors - 1) + ["dead"]
    truth = 1000 * np.random.default_rng(0).normal(size=(n_sensors, 3))
    sensor_map = SensorMap(truth, health=health)
    source = render_report(sensor_map, score=score(sensor_map, truth, permutations=0))
    assert len(source.encode()) < 2e6
    page = Page(source)
    (view,) = scene_of(page)
    assert len(view["names"]) == MAX_DOTS
    assert not view["pairs"]
    assert f"s{n_sensors - 1}" in view["names"], "faulty sensors are shown"
    assert f"the view shows {MAX_DOTS}" in page.text
    assert f"The first {MAX_ROWS} are listed; the other {n_sensors - MAX_ROWS}" in page.text
    assert [f"s{n_sensors - 1}", "dead"] in [row[:2] for row in page.sensor_rows]


def test_a_report_is_self_contained_and_runs_only_its_own_script(tmp_path):
    sensor_map, scored = example()
    path = tmp_path / "report.html"
    told = {"touches": touched(sensor_map), "summary": summary()}
    write_report(path, sensor_map, score=scored, **told)
    source = path.read_text(encoding="utf-8")
    assert source == render_report(sensor_map, score=scored, **told), "it is reproducible"
    page = Page(source)
    addresses = [
        v for name in ("src", "href", "srcset", "action", "data") for v in page.values(name)
    ]
    assert all(address.startswith("data:") for address in addresses)
    assert not {"link", "base", "iframe", "object", "embed", "a"} & set(page.tags)
    (style,) = page.texts["style"]
    assert "@import" not in style
    assert "url(" not in style
    _, script = page.texts["script"]
    assert source.lower().count("</script") == 2
    assert "<!--" not in script
    (policy,) = [value for value in page.values("content") if "default-src" in value]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert "connect-src" not in rules
    for kind, text in (("script", script), ("style", style)):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[f"{kind}-src"] == f"'sha256-{digest}'"
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]


def hostile_report(texts):
    places = np.random.default_rng(0).normal(size=(len(texts), 3))
    facts = dict.fromkeys(("names", "health", "notes"), texts)
    facts |= {"units": texts[0], "method": texts[0], "provenance": {"source": texts[0]}}
    sensor_map = SensorMap(places, **facts)
    scored = score(sensor_map, places[::-1], units=texts[0], permutations=9)
    health = [SensorHealth(text, "noisy", text, 0, 1, 2, 0.1, 3, 0.2, 0.3) for text in texts]
    told = {"health": health, "summary": summary(*texts), "title": texts[0]}
    return render_report(sensor_map, score=scored, **told)


def test_hostile_names_are_escaped(tmp_path):
    source = hostile_report(HOSTILE)
    page = Page(source)
    harmless = Page(hostile_report(tuple(f"name {i}" for i in range(len(HOSTILE)))))
    assert page.tags == harmless.tags
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]
    for sample in ("<script>alert", "<img src=x", "<svg onload", "<a href"):
        assert sample not in source
    assert "{{ 7 * 7 }}" in page.text, "names are not templates"
    assert sorted(row[0] for row in page.sensor_rows) == sorted(map(printable, HOSTILE))
    sensor_map, scored = example()
    half = score(sensor_map, scored.truth, units="\ud800", permutations=9)
    write_report(tmp_path / "report.html", sensor_map, score=half, title="\ud800")
    (tmp_path / "report.html").read_bytes().decode("utf-8")


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_browser_draws_the_map(tmp_path, dimensions):
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs Chromium")
    sensor_map, scored = example(dimensions, dimensions, covariances=np.einsum(
        "n,ij->nij", np.arange(12.0), np.eye(dimensions)
    ))  # fmt: skip
    write_report(tmp_path / "r.html", sensor_map, score=scored, touches=touched(sensor_map))
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking")
    options += (f"--user-data-dir={tmp_path / 'browser'}", "--enable-logging=stderr", "--dump-dom")
    run = subprocess.run(
        [browser, *options, (tmp_path / "r.html").as_uri()], capture_output=True, text=True,
        check=True, timeout=60,
    )  # fmt: skip
    assert "CONSOLE" not in run.stderr, "no errors, and nothing that the policy refuses"
    assert "light is up" in Page(run.stdout).text, "the script has run to its end"


@given(st.floats(-1e9, 1e9), st.integers(1, 6))
def test_numbers_keep_their_significant_digits(value, digits):
    assert float(number(value, digits)) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))
    for nothing in (None, math.nan, math.inf, -math.inf):
        assert number(nothing, unit="mm") == UNKNOWN
