"""Texts with what they hold, and the check that it is read."""

import math
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning
from anisomap.live.batches import Batch, Names
from anisomap.live.sources.lines import LineParser
from anisomap.names import default_names

READINGS = np.where(np.random.default_rng(4).random((30, 4)) < 0.5, 0, 12.25)
READINGS[:3] = [[0.5, 0, 1, 0], [0, 2.75, 0, 0], [0, 0, 0, 3]]
COUNT, NAN = np.arange(30.0), math.nan


def hold(text: str, **facts: Any) -> tuple[str, dict[str, Any]]:
    """Return a text with what it holds, options of reading and a warning among it."""
    return text, facts


def table(
    values: Any, delimiter: str = ",", end: str = "\n", decimal: str = ".", names: Any = None
) -> str:
    """Format rows of numbers, with a name before each."""
    rows = [[f"{value:g}".replace(".", decimal) for value in row] for row in values]
    if names:
        rows = [[name, *row] for name, row in zip(names, rows, strict=True)]
    return "".join(delimiter.join(row) + end for row in rows)


def contact(part: int, *taxels: int, names: str = "") -> str:
    """Format a contact as the skin manager of the iCub does."""
    vectors = "(0.0 0.0 0.0) (1.5 -2.0 0.0) (0.0 0.0 0.0) (0.0 0.0 0.0) (0.0 0.0 1.0)"
    return f"((3 2 2 {part}) {vectors} ({' '.join(map(str, taxels))}) 21.5{names})"


def touches(*contacts: str) -> str:
    """Format a log of contacts, one line of them per frame."""
    return "".join(f"{i} {1.4e9 + i / 8:.6f} {each}\n" for i, each in enumerate(contacts))


def check(path: Any, facts: dict[str, Any]) -> None:
    """Check that a file is read as stated."""
    given = {key: facts[key] for key in facts.keys() & {"grid", "select"}}
    warned = facts.get("warns")
    with pytest.warns(AnisomapWarning, match=warned) if warned else nullcontext():
        found = io.read(path, options=io.ReadOptions(**given))
    compare(found, {fact: facts[fact] for fact in facts.keys() - {"warns", *given}})


def compare(found: Any, facts: dict[str, Any]) -> None:
    """Check what was read."""
    for fact, expected in facts.items():
        value = getattr(found, fact)
        if fact == "metadata":
            assert expected.items() <= value.items()
        elif fact == "times" and expected is not None:
            np.testing.assert_allclose(value, expected, atol=1e-5)
        elif isinstance(expected, list | np.ndarray):
            np.testing.assert_array_equal(value, expected)
        else:
            assert value == (pytest.approx(expected) if fact == "rate_hz" else expected)


def sent(text: bytes, grid: Any = None) -> tuple[Any, Any, Any]:
    """Return names, readings and times of a text that is sent to a live session in parts."""
    parser = LineParser(grid)
    parts = [text[i : i + 999] for i in range(0, len(text), 999)]
    items = [item for part in parts for item in parser.feed(part)]
    items += [*parser.feed(b"", complete=True), *parser.end()]
    batches = [item for item in items if isinstance(item, Batch)]
    if not batches:
        return (), [], None
    readings = np.concatenate([batch.readings for batch in batches])
    names = [item.names for item in items if isinstance(item, Names)]
    clocks = [batch.times for batch in batches]
    times = None if clocks[-1] is None else np.concatenate(clocks)
    return (*names, default_names(readings.shape[1]))[0], readings, times


def read_alike(path: Any, grid: Any = None) -> Any:
    """Read a text as a file; a live session must find the same names, frames and steps of time."""
    found = io.read(path, options=io.ReadOptions(grid=grid))
    names, readings, times = sent(path.read_bytes(), grid)
    np.testing.assert_array_equal(readings, found.readings)
    assert names == found.names
    if found.times is not None:
        np.testing.assert_allclose(np.diff(times), np.diff(found.times), atol=1e-5)
    return found
