"""Immutable values: frozen dataclasses whose arrays and mappings are read-only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Self

import numpy as np


@dataclass(frozen=True, eq=False)
class Immutable:
    """A frozen dataclass whose arrays and mappings are read-only, and which can be pickled.

    Dataclasses with a `__post_init__` of their own call `set_fields` at its end.
    """

    def __post_init__(self) -> None:
        self.set_fields()

    def set_fields(self, **values: object) -> None:
        """Set checked values of fields, before anyone sees them; the others are made read-only."""
        for name, value in (
            {one.name: getattr(self, one.name) for one in fields(self)} | values
        ).items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            fixed = MappingProxyType(dict(value)) if isinstance(value, Mapping) else value
            object.__setattr__(self, name, fixed)

    def __reduce__(self) -> tuple[Callable[..., Self], tuple[type[Self], dict[str, object]]]:
        # A mappingproxy cannot be pickled, and cached properties need not be.
        own = {one.name: getattr(self, one.name) for one in fields(self)}
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in own.items()}
        return _rebuilt, (type(self), plain)


def _rebuilt(kind: Callable[..., Any], values: dict[str, Any]) -> Any:
    return kind(**values)
