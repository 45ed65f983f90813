"""Reports of small maps, and what a browser makes of their pages."""

import json
from html.parser import HTMLParser
from typing import Any, NoReturn

import numpy as np
from plotly.offline import get_plotlyjs

from anisomap.evaluation import Score, score
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.sensor_map import SensorMap

PNG = b"\x89PNG\r\n\x1a\n not decoded"
VOID = {"meta", "img", "input", "br", "link", "base"}
LIBRARY = get_plotlyjs()


class Page(HTMLParser):
    """Elements, attributes and texts of a report, as a browser parses them.

    Without `whole`, the 5 MB of plotly's library are removed first.
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


def assessed(sensor_map: SensorMap) -> list[SensorHealth]:
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
        raise AssertionError(f"{word} is not JSON")

    (data,) = [text for text in page.texts["script"] if text.startswith("[{")]
    scene: list[dict[str, Any]] = json.loads(data, parse_constant=refuse)
    return scene
