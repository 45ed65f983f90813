"""Texts with what they hold, and the check that it is read."""

import math
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning

READINGS = np.where(np.random.default_rng(4).random((30, 4)) < 0.5, 0, 12.25)
READINGS[:3] = [[0.5, 0, 1, 0], [0, 2.75, 0, 0], [0, 0, 0, 3]]
COUNT, NAN = np.arange(30.0), math.nan


def hold(text: str, **facts: Any) -> tuple[str, dict[str, Any]]:
    """Return a text with what it holds, options of reading and a warning among it."""
    return text, facts


def check(path: Any, facts: dict[str, Any]) -> None:
    """Check that a file is read as stated."""
    given = {key: facts[key] for key in facts.keys() & {"bin_s", "grid", "select"}}
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
