"""Reports of small maps and what a browser makes of their pages, and a small scene."""

import json
from html.parser import HTMLParser

import numpy as np

from anisomap.drawing.report import render_report
from anisomap.evaluation import score
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.numerics.surfaces import Mesh
from anisomap.sensor_map import SensorMap
from anisomap.simulation.options import Prop, Scene

PNG = b"\x89PNG\r\n\x1a\n not decoded"
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
"""Names that are markup, mathematics or templates, long, or cannot be drawn."""

VOID = {"meta", "img", "input", "br", "link", "base"}


class Page(HTMLParser):
    """Elements, attributes and texts of a report, as a browser parses them."""

    def __init__(self, source):
        super().__init__(convert_charrefs=True)
        self.tags = []
        self.attributes = []
        self.texts = {}
        self.rows = []
        self._open = []
        self.feed(source)
        self.close()
        assert not self._open, f"left open: {self._open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self._open.append(tag)
            self.texts.setdefault(tag, []).append("")
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self._open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data):
        if self._open:
            self.texts[self._open[-1]][-1] += data
        if {"td", "th"} & set(self._open):
            self.rows[-1][-1] += data

    def values(self, attribute):
        return [value for _, name, value in self.attributes if name == attribute]

    @property
    def header(self):
        return next(row for row in self.rows if row[0] == "Sensor")

    @property
    def sensor_rows(self):
        return [row for row in self.rows if len(row) == len(self.header)][1:]

    @property
    def text(self):
        skipped = {"script", "style"}
        words = " ".join(
            text for tag, texts in self.texts.items() if tag not in skipped for text in texts
        )
        return " ".join(words.split())


def page_of(sensor_map, scored=None, **rest):
    """Render a report, and read it as a browser would."""
    return Page(render_report(sensor_map, score=scored, **rest))


def assessed(sensor_map):
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


def summary(*warnings):
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


def example(true_dimensions=3, dimensions=3, n_sensors=12, **rest):
    rng = np.random.default_rng(0)
    places = 50 * rng.normal(size=(n_sensors, 3))
    positions = places[:, :dimensions] + rng.normal(size=(n_sensors, dimensions))
    sensor_map = SensorMap(positions, **{"method": "r-anisomap", "stress": 0.125} | rest)
    if true_dimensions is None:
        return sensor_map, None
    truth = places[:, :true_dimensions]
    return sensor_map, score(sensor_map, truth, units="mm", permutations=50)


def scene_of(page):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    (data,) = [text for text in page.texts["script"] if text.startswith("[{")]
    return json.loads(data, parse_constant=refuse)


def small_scene(n_frames=6):
    """Two triangles of different sizes that move past a triangular body."""
    triangle = Mesh(np.eye(3), [[0, 1, 2]])
    ways = np.linspace(0, 3, n_frames)[:, None, None] * np.ones((1, 2, 3))
    readings = np.zeros((n_frames, 3), dtype=np.float32)
    readings[4, :2] = 1
    body = Prop("body", triangle, np.zeros((1, 1, 3)))
    stimulus = Prop("stimulus", triangle, ways, scales=np.array([1.0, 2.0]))
    times = np.arange(n_frames) / 20
    return Scene("a small scene", (body, stimulus), np.eye(3)[None], readings, times, "m")
