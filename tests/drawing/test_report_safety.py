"""Reports are self-contained, and safe with any sensor names."""

import base64
import hashlib
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.base.wording import printable
from anisomap.drawing.report import render_report, write_report
from anisomap.evaluation import score
from anisomap.health import SensorHealth
from anisomap.sensor_map import SensorMap
from reports import LIBRARY, PNG, Page, example, scene_of, summary

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


def test_a_report_is_self_contained_and_runs_only_its_own_scripts(tmp_path):
    sensor_map, scored = example()
    path = tmp_path / "report.html"
    write_report(path, sensor_map, score=scored, figure_png=PNG, summary=summary())
    source = path.read_text(encoding="utf-8")
    page = Page(source, whole=True)
    addresses = [
        v for name in ("src", "href", "srcset", "action", "data") for v in page.values(name)
    ]
    assert addresses
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert not {"link", "base", "iframe", "object", "embed", "a"} & set(page.tags)
    (style,) = page.texts["style"]
    assert "@import" not in style
    assert "url(" not in style
    scripts = page.texts["script"]
    assert len(scripts) == source.lower().count("</script") == 3
    assert any("plotly.js" in text[:200] for text in scripts)
    assert not [text for text in scripts if "<!--" in text or "\r" in text]
    (policy,) = [value for value in page.values("content") if "default-src" in value]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data: blob:"
    assert "connect-src" not in rules
    assert "http" not in policy
    run = [text for text in scripts if not text.startswith("[{")]
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in run]
    assert rules["script-src"].split() == [*(f"'sha256-{h}'" for h in hashes), "'unsafe-eval'"]
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]


def hostile_report(texts):
    places = np.random.default_rng(0).normal(size=(len(texts), 3))
    facts = dict.fromkeys(("names", "health", "notes"), texts)
    facts |= {"units": texts[0], "method": texts[0], "provenance": {text: text for text in texts}}
    sensor_map = SensorMap(places, **facts)
    scored = score(sensor_map, places[::-1], units=texts[0], permutations=9)
    health = [SensorHealth(text, "noisy", text, 0, 1, 2, 0.1, 3, 0.2, 0.3) for text in texts]
    told = {"health": health, "summary": summary(*texts), "title": texts[0]}
    source = render_report(sensor_map, score=scored, figure_png=PNG, **told)
    return source.replace(LIBRARY, "")


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
    in_view = json.dumps(scene_of(page))
    assert not re.search(r"<(?!/?b>|br>)", in_view), "plotly interprets markup in its labels"
    sensor_map, scored = example()
    half = score(sensor_map, scored.truth, units="\ud800", permutations=9)
    write_report(tmp_path / "report.html", sensor_map, score=half, title="\ud800")
    (tmp_path / "report.html").read_bytes().decode("utf-8")


@pytest.fixture(scope="module")
def harmless_tags():
    return Page(hostile_report(tuple("abcde"))).tags


@settings(max_examples=12)
@given(st.lists(st.text(min_size=1), min_size=5, max_size=5, unique=True).map(tuple))
def test_names_do_not_change_the_structure_of_the_page(harmless_tags, names):
    page = Page(hostile_report(names))
    # Notes that are equal once printable are listed once.
    elements, expected = (
        [tag for tag in tags if tag != "li"] for tags in (page.tags, harmless_tags)
    )
    assert elements == expected
    assert sorted(row[0] for row in page.sensor_rows) == sorted(map(printable, names))
    scene_of(page)
