"""Reports: complete, self-contained, repeatable, and inert whatever the sensors are called."""

import base64
import hashlib
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plotly.offline import get_plotlyjs

from anisomap.drawing.report import check_writable, render_report, write_report
from anisomap.drawing.report._words import UNKNOWN, number
from anisomap.drawing.view import shown
from anisomap.errors import FileError, MissingExtraError
from anisomap.evaluation import Score, score
from anisomap.health import STATUSES, RecordingSummary, SensorHealth
from anisomap.sensor_map import UNPLACED, SensorMap

PNG = b"\x89PNG\r\n\x1a\n not looked into"
VOID = {"meta", "img", "input", "br", "link", "base"}
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


LIBRARY = get_plotlyjs()


class Page(HTMLParser):
    """Elements, attributes and texts of a report, as a browser parses them.

    The 5 MB of plotly's library are left out unless `whole`.
    """

    def __init__(self, source: str, *, whole: bool = False) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.texts: dict[str, list[str]] = {}
        self.rows: list[list[str]] = []
        self._open: list[str] = []
        self.feed(source if whole else source.replace(LIBRARY, ""))
        self.close()
        assert not self._open, f"left open: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self._open.append(tag)
            self.texts.setdefault(tag, []).append("")
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        if self._open:
            self.texts[self._open[-1]][-1] += data
        if {"td", "th"} & set(self._open):
            self.rows[-1][-1] += data

    def values(self, attribute: str) -> list[str]:
        return [value for _, name, value in self.attributes if name == attribute]

    @property
    def sensor_rows(self) -> list[list[str]]:
        width = next(len(row) for row in self.rows if row[0] == "Sensor")
        return [row for row in self.rows if len(row) == width][1:]

    @property
    def text(self) -> str:
        skipped = {"script", "style"}
        words = " ".join(
            text for tag, texts in self.texts.items() if tag not in skipped for text in texts
        )
        return " ".join(words.split())


def judged(sensor_map: SensorMap) -> list[SensorHealth]:
    return [
        SensorHealth(
            name=name,
            status=status,
            reason="" if status == "ok" else f"looks {status}",
            minimum=0.0,
            maximum=float("nan") if i % 5 == 0 else 7.5 * i,
            distinct=i + 1,
            active=0.01 * i,
            contacts=i,
            lag_correlation=0.5,
            best_match=float("nan"),
        )
        for i, (name, status) in enumerate(zip(sensor_map.names, sensor_map.health, strict=True))
    ]


def summary(*warnings: str) -> RecordingSummary:
    return RecordingSummary(
        n_frames=2345,
        n_sensors=12,
        rate_hz=None,
        duration=None,
        minimum=-1.5,
        maximum=255.0,
        share_of_zeros=0.875,
        distinct_values=41,
        missing=3,
        n_constant=1,
        warnings=warnings,
    )


def example(
    true_dimensions: int | None = 3, dimensions: int = 3, n_sensors: int = 12, **rest: Any
) -> tuple[SensorMap, Score | None]:
    rng = np.random.default_rng(0)
    places = 50 * rng.normal(size=(n_sensors, 3))
    positions = places[:, :dimensions] + rng.normal(size=(n_sensors, dimensions))
    sensor_map = SensorMap(positions, **{"method": "r-anisomap", "stress": 0.125} | rest)
    if true_dimensions is None:
        return sensor_map, None
    truth = places[:, :true_dimensions]
    return sensor_map, score(sensor_map, truth, units="mm", permutations=50)


def scene_of(page: Page) -> list[dict[str, Any]]:
    def refuse(word: str) -> NoReturn:
        raise AssertionError(f"{word} is no JSON")

    (data,) = [text for text in page.texts["script"] if text.startswith("[{")]
    scene: list[dict[str, Any]] = json.loads(data, parse_constant=refuse)
    return scene


@pytest.mark.parametrize("true_dimensions", [None, 3])
def test_a_report_needs_nothing_from_elsewhere(tmp_path: Path, true_dimensions: int | None) -> None:
    sensor_map, scored = example(true_dimensions)
    path = tmp_path / "report.html"
    write_report(path, sensor_map, score=scored, figure_png=PNG, summary=summary())
    page = Page(path.read_text(encoding="utf-8"), whole=True)
    addresses = [
        v for name in ("src", "href", "srcset", "action", "data") for v in page.values(name)
    ]
    assert addresses
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert not {"link", "base", "iframe", "object", "embed", "a"} & set(page.tags)
    (style,) = page.texts["style"]
    assert "@import" not in style
    assert "url(" not in style
    assert len(page.texts["script"]) == 3
    assert any("plotly.js" in script[:200] for script in page.texts["script"])


def test_the_browser_is_told_to_fetch_nothing_and_run_only_our_scripts() -> None:
    sensor_map, scored = example()
    page = Page(render_report(sensor_map, score=scored), whole=True)
    (policy,) = [value for value in page.values("content") if "default-src" in value]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data: blob:"
    assert "connect-src" not in rules
    assert "http" not in policy
    run = [text for text in page.texts["script"] if not text.startswith("[{")]
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in run]
    assert rules["script-src"].split() == [*(f"'sha256-{h}'" for h in hashes), "'unsafe-eval'"]
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]


def test_same_input_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "second"):
        sensor_map, scored = example()
        write_report(
            tmp_path / name, sensor_map, score=scored, health=judged(sensor_map), figure_png=PNG
        )
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
@pytest.mark.parametrize("true_dimensions", [None, 2, 3])
def test_plotly_takes_every_view(true_dimensions: int | None, dimensions: int) -> None:
    sensor_map, scored = example(true_dimensions, min(dimensions, 3))
    if dimensions == 4:
        sensor_map = SensorMap(np.pad(sensor_map.positions, ((0, 0), (0, 1))))
    (piece,) = scene_of(Page(render_report(sensor_map, score=scored)))
    in_space = max(true_dimensions or 1, dimensions) > 2
    kinds = {trace["type"] for trace in piece["traces"].values()}
    assert kinds == {"scatter3d" if in_space else "scatter"}
    assert ("error" in piece["colours"]) == (scored is not None)
    for colours in piece["colours"].values():
        assert len(colours["color"]) == 12
        traces = dict(piece["traces"])
        traces["map"] = traces["map"] | {"marker": traces["map"]["marker"] | colours}
        go.Figure(list(traces.values()), piece["layout"])  # refuses what plotly does not know
    axes = piece["layout"]["scene"] if in_space else piece["layout"]
    units = "arbitrary units" if scored is None else "mm"
    for axis in "xyz" if in_space else "xy":
        assert axes[f"{axis}axis"]["title"]["text"] == f"{axis} ({units})"
    assert axes["aspectmode"] == "data" if in_space else axes["yaxis"]["scaleanchor"] == "x"


def test_the_view_shows_the_map_laid_onto_the_truth() -> None:
    sensor_map, scored = example()
    assert scored is not None
    (piece,) = scene_of(Page(render_report(sensor_map, score=scored)))
    for what, expected in (("map", scored.alignment.aligned), ("truth", scored.truth)):
        shown_places = np.column_stack([piece["traces"][what][axis] for axis in "xyz"])
        np.testing.assert_allclose(shown_places, expected, rtol=1e-4, atol=1e-3)
    assert piece["names"] == list(sensor_map.names)
    for name, hover in zip(sensor_map.names, piece["traces"]["map"]["hovertext"], strict=True):
        assert all(said in hover for said in (name, "health: ok", "piece 1", " mm"))


def test_every_piece_has_a_view() -> None:
    component = np.repeat([0, 1, 2, UNPLACED], [6, 4, 1, 1])
    positions = np.random.default_rng(0).normal(size=(12, 3))
    positions[-1] = np.nan
    sensor_map = SensorMap(positions, component=component)
    page = Page(render_report(sensor_map))
    assert [piece["label"] for piece in scene_of(page)] == [
        "Piece 1: 6 sensors",
        "Piece 2: 4 sensors",
    ]
    assert "separate pieces that share no frame" in page.text
    assert "Not on the map: s11" in page.text
    assert [row[2] for row in page.sensor_rows].count("not placed") == 1


def test_a_map_of_nothing_is_reported_without_a_view() -> None:
    page = Page(render_report(SensorMap(np.full((5, 3), np.nan))))
    assert "0 of 5 sensors are placed" in page.text
    assert "form" not in page.tags


@pytest.mark.parametrize("with_score", [True, False])
@pytest.mark.parametrize("with_health", [True, False])
def test_the_table_has_every_sensor_and_problems_first(with_score: bool, with_health: bool) -> None:
    statuses = (["ok"] * 5 + list(STATUSES))[:12]
    sensor_map, scored = example(3 if with_score else None, health=statuses)
    health = judged(sensor_map) if with_health else ()
    page = Page(render_report(sensor_map, score=scored, health=health))
    rows = page.sensor_rows
    assert sorted(row[0] for row in rows) == sorted(sensor_map.names)
    assert {row[0]: row[1] for row in rows} == dict(
        zip(sensor_map.names, sensor_map.health, strict=True)
    )
    problems = [row[1] != "ok" for row in rows]
    assert problems == sorted(problems, reverse=True)
    if with_health:
        assert {row[-1] for row in rows} >= {f"looks {status}" for status in STATUSES[1:]}
    if scored is not None:
        errors = dict(zip(sensor_map.names, scored.alignment.errors, strict=True))
        assert all(float(row[2]) == pytest.approx(errors[row[0]], rel=0.01) for row in rows)


def test_every_doubt_is_said() -> None:
    notes = ("scaling did not converge", "two sensors never vary")
    sensor_map, scored = example(notes=notes, exclude=[3])
    page = Page(render_report(sensor_map, score=scored, summary=summary("only 2 frames", notes[0])))
    said = [text.lower() for text in page.texts["li"]]
    for doubt in (*notes, "only 2 frames", "1 of 12 sensors were excluded"):
        assert said.count(doubt) == 1
    for fact in ("2345", "-1.5 to 255", "87.5%", "not known", "1 of them never vary"):
        assert fact in page.text
    assert "No warning came up" in Page(render_report(example()[0])).text


def test_the_verdict_comes_first_and_says_how_sure_it_is() -> None:
    sensor_map, scored = example()
    assert scored is not None
    good = Page(render_report(sensor_map, score=scored))
    assert good.text.index("very closely") < good.text.index("Null")
    for said in (
        f"Mantel r {scored.mantel.r:.3f}",
        f"{scored.mantel.quantiles()[0.95]:.3f}",
        f"{number(scored.rms)} mm",
        number(scored.rms_in_spacings, 2),
        "known up to rotation, translation, scale and mirror image",
    ):
        assert said in good.text
    elsewhere = np.random.default_rng(8).normal(size=(12, 3))
    chance = score(sensor_map, elsewhere, permutations=200)
    assert chance.mantel.r < chance.mantel.quantiles()[0.95]
    assert "no better than chance" in Page(render_report(sensor_map, score=chance)).text
    flattened = SensorMap(sensor_map.positions * [1, 0, 0])
    coarse = Page(render_report(flattened, score=score(flattened, scored.truth)))
    for page, doubted in ((good, False), (coarse, True)):
        assert ("neighbourhoods cannot be relied on" in page.text) == doubted
        assert ("not which sensors are neighbours" in page.text) == doubted
    unknown = Page(render_report(sensor_map)).text
    assert "12 of 12 sensors are placed" in unknown
    assert "known up to rotation, translation, scale and mirror image" in unknown
    assert "0.125" in unknown
    assert "Mantel r" not in unknown.split("How it was made")[0]


def test_a_score_without_null_does_not_claim_one() -> None:
    sensor_map, scored = example()
    assert scored is not None
    bare = score(sensor_map, scored.truth, permutations=0)
    text = Page(render_report(sensor_map, score=bare)).text
    assert "was not computed" in text
    assert "random labellings" not in text


def test_the_picture_is_in_it_and_described() -> None:
    sensor_map, scored = example()
    page = Page(render_report(sensor_map, score=scored, figure_png=PNG))
    (picture,) = page.values("src")
    assert base64.b64decode(picture.removeprefix("data:image/png;base64,")) == PNG
    (described,) = page.values("alt")
    assert "12 sensors" in described
    assert "img" not in Page(render_report(sensor_map, score=scored)).tags


def hostile_report(texts: tuple[str, ...]) -> str:
    places = np.random.default_rng(0).normal(size=(len(texts), 3))
    sensor_map = SensorMap(
        places,
        names=texts,
        health=texts,
        units=texts[0],
        method=texts[0],
        notes=texts,
        provenance={text: text for text in texts},
    )
    scored = score(sensor_map, places[::-1], units=texts[0], permutations=9)
    source = render_report(
        sensor_map,
        score=scored,
        health=[SensorHealth(text, "noisy", text, 0, 1, 2, 0.1, 3, 0.2, 0.3) for text in texts],
        summary=summary(*texts),
        figure_png=PNG,
        title=texts[0],
    )
    return source.replace(LIBRARY, "")


def test_hostile_names_are_inert(tmp_path: Path) -> None:
    source = hostile_report(HOSTILE)
    page = Page(source)
    harmless = Page(hostile_report(tuple(f"name {i}" for i in range(len(HOSTILE)))))
    assert page.tags == harmless.tags
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]
    for sample in ("<script>alert", "<img src=x", "<svg onload", "<a href"):
        assert sample not in source
    assert "{{ 7 * 7 }}" in page.text, "a name is no template"
    assert [row[0] for row in page.sensor_rows] == [shown(name) for name in HOSTILE]
    in_view = json.dumps(scene_of(page))
    assert not re.search(r"<(?!/?b>|br>)", in_view), "plotly reads markup in its labels"
    sensor_map, scored = example()
    assert scored is not None
    half = score(sensor_map, scored.truth, units="\ud800", permutations=9)
    write_report(tmp_path / "report.html", sensor_map, score=half, title="\ud800")
    (tmp_path / "report.html").read_bytes().decode("utf-8")


KNOWN_KEYS = {"approximate"}
"""Keys of the provenance that change the page by their meaning."""


@settings(max_examples=30)
@given(
    st.lists(
        st.text(min_size=1).filter(lambda text: text not in KNOWN_KEYS),
        min_size=5,
        max_size=5,
        unique=True,
    ).map(tuple)
)
def test_no_name_changes_what_the_page_is_made_of(names: tuple[str, ...]) -> None:
    page = Page(hostile_report(names))
    # Notes that differ in nothing that can be seen are told once, so items of lists may be fewer.
    elements, expected = (
        [tag for tag in tags if tag != "li"]
        for tags in (page.tags, Page(hostile_report(tuple("abcde"))).tags)
    )
    assert elements == expected
    assert [row[0] for row in page.sensor_rows] == [shown(name) for name in names]
    scene_of(page)


def test_a_script_ends_where_it_should() -> None:
    sensor_map, scored = example()
    source = render_report(sensor_map, score=scored)
    scripts = Page(source, whole=True).texts["script"]
    assert source.lower().count("</script") == len(scripts)
    assert not [text for text in scripts if "<!--" in text or "\r" in text]


def test_a_failure_leaves_the_old_report_whole(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    no_bytes: Any = "a text"
    with pytest.raises(TypeError):
        write_report(path, example()[0], figure_png=no_bytes)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_places_that_cannot_be_written_to_are_named(tmp_path: Path) -> None:
    for try_it in (check_writable, lambda path: write_report(path, example()[0])):
        with pytest.raises(FileError, match="no folder"):
            try_it(tmp_path / "nowhere" / "report.html")
        with pytest.raises(FileError, match="it is a folder"):
            try_it(tmp_path)
    check_writable(tmp_path / "report.html")
    assert not list(tmp_path.iterdir()), "to ask writes nothing"


@pytest.mark.parametrize("missing", ["jinja2", "plotly"])
def test_without_the_extra_its_name_is_told(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    monkeypatch.delitem(sys.modules, "anisomap.drawing.report._page")
    for module in [name for name in sys.modules if name.split(".")[0] == missing]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingExtraError, match=r"a report needs .*anisomap\[report\]"):
        render_report(example()[0])
    with pytest.raises(MissingExtraError):
        check_writable("report.html")


@given(st.floats(-1e9, 1e9), st.integers(1, 6))
def test_numbers_keep_their_digits(value: float, digits: int) -> None:
    assert float(number(value, digits)) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))


@pytest.mark.parametrize("nothing", [None, float("nan"), float("inf"), -float("inf")])
def test_what_is_no_number_is_a_dash(nothing: float | None) -> None:
    assert number(nothing, unit="mm") == UNKNOWN
