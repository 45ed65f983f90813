"""Immutable values: frozen dataclasses whose arrays and mappings are read-only.

If a field is NaN, generated comparisons of dataclasses depend on the version of Python.
Comparisons of `Value` do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Self

import numpy as np

_NAN = object()


@dataclass(frozen=True, eq=False)
class Immutable:
    """A frozen dataclass whose arrays and mappings are read-only, and which can be pickled.

    Dataclasses with a `__post_init__` of their own call `set_fields` at its end.
    """

    def __post_init__(self) -> None:
        self.set_fields()

    def set_fields(self, **values: object) -> None:
        """Set checked values of fields during initialisation, and make other fields read-only."""
        for name, value in (
            {one.name: getattr(self, one.name) for one in fields(self)} | values
        ).items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            fixed = MappingProxyType(dict(value)) if isinstance(value, Mapping) else value
            object.__setattr__(self, name, fixed)

    def __reduce__(self) -> tuple[Callable[..., Self], tuple[type[Self], dict[str, object]]]:
        # A mappingproxy cannot be pickled; cached properties can be computed again.
        own = {one.name: getattr(self, one.name) for one in fields(self)}
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in own.items()}
        return _rebuilt, (type(self), plain)


@dataclass(frozen=True, eq=False)
class Value:
    """A frozen dataclass; two are equal if all fields are equal, where NaN equals NaN."""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Value) or type(other) is not type(self):
            return NotImplemented
        return self._compared() == other._compared()

    def __hash__(self) -> int:
        return hash(self._compared())

    def _compared(self) -> object:
        return _with_nan(tuple(getattr(self, one.name) for one in fields(self) if one.compare))


def _with_nan(value: object) -> object:
    """Replace NaN by a value that equals itself, also within tuples."""
    if isinstance(value, tuple):
        return tuple(map(_with_nan, value))
    return _NAN if isinstance(value, float) and math.isnan(value) else value


def _rebuilt(kind: Callable[..., Any], values: dict[str, Any]) -> Any:
    return kind(**values)
