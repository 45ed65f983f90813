"""Find the moment, the sensors and the values of events by the names of columns or keys."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from anisomap.io.parsing.columns import is_time

_NOUNS = {
    **dict.fromkeys(("id", "ids", "taxel", "taxels", "contacts", "active", "touched"), "taxel"),
    **dict.fromkeys(("sensor", "sensors"), "sensor"),
    **dict.fromkeys(("channel", "channels"), "channel"),
    **dict.fromkeys(("electrode", "electrodes"), "electrode"),
    **dict.fromkeys(("unit", "units"), "unit"),
    **dict.fromkeys(("neuron", "neurons"), "neuron"),
}
_BESIDE_NOUNS = {"index", "indices", "list", "activated", "contact", "number", "no"}
_MOMENTS = {"event", "events", "contact", "touch", "frame", "sample", "index", "no", "number"}
_VALUES = {"value", "values", "pressure", "force", "amplitude", "reading", "weight"}


@dataclass(frozen=True)
class EventColumns:
    """Columns of a list of events, by index from 0.

    Parameters
    ----------
    moment : int
        Column of times, or of numbers of events.
    sensor : int
        Column of sensors.
    value : int
        Column of values; -1 without one.
    """

    moment: int
    sensor: int
    value: int = -1


def find_columns(names: Sequence[str]) -> EventColumns | None:
    """Find the columns of events.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    EventColumns or None
        None unless exactly one name denotes a moment, one sensors, and at most one values.
    """
    words = [_words(name) for name in names]
    moments = [
        i
        for i, name in enumerate(names)
        if is_time(name, i) or (words[i] and _MOMENTS.issuperset(words[i]))
    ]
    sensors = [i for i, each in enumerate(words) if _is_sensor(each)]
    values = [i for i, each in enumerate(words) if each and _VALUES.issuperset(each)]
    if (len(moments), len(sensors)) != (1, 1) or moments == sensors or len(values) > 1:
        return None
    return EventColumns(moments[0], sensors[0], (values or [-1])[0])


def noun_of(name: str) -> str:
    """Return what precedes the numbers of sensors in a column: ``channel`` for ``channel_ids``."""
    return next((_NOUNS[word] for word in reversed(_words(name)) if _is_specific(word)), "taxel")


def _is_specific(word: str) -> bool:
    return word in _NOUNS and word not in ("id", "ids")


def _is_sensor(words: Sequence[str]) -> bool:
    known = all(word in _NOUNS or word in _BESIDE_NOUNS for word in words)
    return known and any(word in _NOUNS for word in words)


def _words(name: str) -> list[str]:
    return re.findall(r"[^\W\d_]+", name.lower())
