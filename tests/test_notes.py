"""Sentences agree with their counts in number."""

import re

import pytest

from anisomap.notes import Note

OF_ONE = [
    ("hidden-links", {"sensors": ["s3"], "total": 48}),
    ("unknown-pairs", {"count": 1, "sensors": ["s3", "s4"]}),
    ("apart", {"apart": 1, "placed": 48}),
    ("unlinked", {"count": 1, "total": 48}),
    ("few-sensors", {"count": 1, "least": 12}),
    ("few-frames", {"count": 1, "least": 80}),
]
SINGULAR = re.compile(r"\b1 (sensor|pair|frame)\b|\b1 of 48 sensors\b")
PLURAL = re.compile(r"\b(are|were|have|their|positions|distances)\b")


@pytest.mark.parametrize(("kind", "values"), OF_ONE)
def test_a_note_on_one_sensor_is_in_the_singular(kind, values):
    text = Note(kind, **values)
    assert SINGULAR.search(text)
    assert not PLURAL.search(text)
    doubled = {
        name: 2 * value if isinstance(value, list) else value for name, value in values.items()
    }
    several = Note(kind, **{name: 2 if value == 1 else value for name, value in doubled.items()})
    assert not SINGULAR.search(several)
