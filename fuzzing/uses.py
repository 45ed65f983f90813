"""Hostile maps with recordings, and bytes from sources of live sessions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from anisomap import io
from anisomap.evaluation import align, compare_maps
from anisomap.layout import check_layout
from anisomap.live.batches import Batch, Names, Notice
from anisomap.live.quick_map import QuickMapper, read_levels
from anisomap.live.sources.lines import LineParser
from anisomap.names import default_names
from anisomap.placement import Anchors, place
from fuzzing.checks import Findings

BEFORE, AFTER, SKIN = "before.json", "after.json", "skin.csv"
"""Files of a case with two maps and a recording."""

_MAX_SENSORS, _MAX_FRAMES = 60, 400


def check_maps(_: Path, found: Findings, rng: Generator) -> None:
    """Compare, align, place and check maps of the folder, by a recording."""
    before, after = (_read(found, io.read_map, name) for name in (BEFORE, AFTER))
    skin = _read(found, io.read, SKIN)
    uses: tuple[tuple[str, Sequence[Any], Callable[[], Any]], ...] = (
        ("compare_maps", (before, after), lambda: compare_maps(before, after)),
        ("align", (before, after), lambda: align(before.positions, after.positions)),
        ("place", (before, after), lambda: place(before, _anchors(after, rng))),
        ("check_layout", (before, skin), lambda: check_layout(before, skin, n_shifts=19, rng=0)),
    )
    name, needed, use = uses[rng.integers(len(uses))]
    small = skin is None or skin.readings.size <= _MAX_SENSORS * _MAX_FRAMES
    if small and all(one is not None and len(one.names) <= _MAX_SENSORS for one in needed):
        found.accepted |= found.attempt(name, use) is not None


def _read(found: Findings, reader: Callable[[Path], Any], name: str) -> Any:
    return found.attempt(f"read {name}", lambda: reader(found.folder / name))


def _anchors(sensor_map: Any, rng: Generator) -> Anchors:
    count = int(rng.integers(1, 9))
    return Anchors(sensor_map.names[:count], sensor_map.positions[:count])


def check_source(path: Path, found: Findings, rng: Generator) -> None:
    """Parse bytes as they come from a port or socket, in parts, and count their contacts."""
    content = path.read_bytes()
    cuts = np.sort(rng.integers(len(content) + 1, size=int(rng.integers(6))))
    ends = [0, *cuts.tolist(), len(content)]
    parser = LineParser()

    def received() -> list[Any]:
        items = [
            item
            for start, end in pairwise(ends)
            for item in parser.feed(content[start:end], complete=end == len(content))
        ]
        items += parser.end()
        mappers: dict[int, QuickMapper] = {}
        for item in items:
            if not isinstance(item, Batch | Names | Notice):
                raise TypeError(f"an item is of type {type(item).__name__}")
            if isinstance(item, Batch) and item.readings.shape[1] <= 2 * _MAX_SENSORS:
                width = item.readings.shape[1]
                mappers.setdefault(width, QuickMapper(default_names(width), 2)).add(item.readings)
                if not np.isfinite(read_levels(item.readings, item.readings[0], None)).all():
                    raise ValueError("a level is not finite")
        for mapper in mappers.values():
            mapper.make()
        return items

    found.accepted |= any(isinstance(i, Batch) for i in found.attempt("feed", received) or ())
