"""Options of scenarios, with validation and scaling to the body, and results of scenarios.

Documented defaults are for a sphere of 60 sensors with a radius of 1 m, spaced by 0.43 m.
For other bodies, lengths scale with the reach or the sensor spacing of the body.
"""

from __future__ import annotations

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self, TypeAlias

import numpy as np
from docstring_parser import parse as parse_docstring
from numpy.typing import NDArray

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError
from anisomap.numerics.ranges import POSITIVE, Range
from anisomap.numerics.surfaces import Mesh
from anisomap.recording import Scalar
from anisomap.simulation.bodies import sphere
from anisomap.simulation.body import Body

REACH, SPACING = "reach", "spacing"
_ROUNDING = 1e-9  # relative error of scaled lengths


def option(default: float | None, values: Range, unit: str = "", per: str = "") -> Any:
    """Declare an option with a default for a sphere of 1 m; None if other options determine it.

    unit: Unit in messages.
    per: Length of the body to which the default is proportional: `REACH`, `SPACING` or none.
    """
    return field(default=default, metadata={"values": values, "unit": unit, "per": per})


def positive(default: float | None, unit: str = "", per: str = "") -> Any:
    """Declare an option that must be positive; see `option`."""
    return option(default, POSITIVE, unit, per)


@dataclass(frozen=True)
class ScenarioOptions:
    """Base class of the options of a scenario; all options are declared by `option`."""

    frame_interval: float = positive(0.05, "s")

    def __post_init__(self) -> None:
        for entry in fields(self):
            if (value := getattr(self, entry.name)) is not None:
                entry.metadata["values"].check(entry.name, value, entry.metadata["unit"])

    def at_most(self, name: str, limit: float, bound: str, advice: str = "") -> None:
        """Check that an option is at most a limit, with a tolerance for rounding when scaled."""
        value = getattr(self, name)
        if value > limit * (1 + _ROUNDING):
            unit = self.__dataclass_fields__[name].metadata["unit"]
            raise InputError(f"{name} must be at most {bound}, got {value:g} {unit}{advice}")

    def scaled(self, factor: float) -> Self:
        """Scale all lengths by `factor`, as for a larger body or another unit of length."""
        lengths = [entry.name for entry in fields(self) if entry.metadata["per"]]
        return replace(self, **{name: factor * getattr(self, name) for name in lengths})


def options_for(kind: type[Any], body: Body, given: Mapping[str, Any] | None = None) -> Any:
    """Create the options of a scenario; defaults are scaled to the body."""
    known = {entry.name: entry for entry in fields(kind)}
    for name in given or {}:
        if name not in known:
            raise InputError(f"there is no parameter {name!r}; choose from {', '.join(known)}")
    reference = sphere()
    scaled = {
        name: entry.default * (getattr(body, per) / getattr(reference, per))
        for name, entry in known.items()
        if (per := entry.metadata["per"])
    }
    return kind(**(scaled | dict(given or {})))


def parse_parameters(texts: Iterable[str]) -> dict[str, float]:
    """Parse texts ``NAME=VALUE``; values of digits only are whole numbers."""
    parsed: dict[str, float] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        try:
            number = int(value) if value.lstrip("+-").isdecimal() else float(value)
        except ValueError as error:
            hint = f"{value!r} is not a number" if equals else "write NAME=VALUE"
            raise InputError(f"parameter {text.strip()!r}: {hint}") from error
        parsed[name.replace("-", "_")] = number
    return parsed


def meanings_of(options: ScenarioOptions) -> dict[str, str]:
    """Return the meaning of each option by name; documented first, inherited before own options."""
    documented = {
        entry.arg_name: " ".join((entry.description or "").split())
        for kind in reversed(type(options).__mro__)
        for entry in parse_docstring(inspect.cleandoc(kind.__doc__ or "")).params
    }
    meanings = documented | {name: documented.get(name, "") for name in vars(options)}
    return {name: text for name, text in meanings.items() if name in vars(options)}


def count_steps(length: float, longest: float) -> int:
    """Return the number of equal steps in a length, each at most `longest` up to rounding."""
    return max(1, math.ceil(length / longest * (1 - 1e-12)))


@dataclass(frozen=True)
class PhysicsOptions(ScenarioOptions, ABC):
    """Base class of the options of a scenario with physics."""

    @property
    @abstractmethod
    def longest_step(self) -> float:
        """Longest step of the physics, in s."""

    @property
    def steps_per_frame(self) -> int:
        """Number of physics steps per frame."""
        return count_steps(self.frame_interval, self.longest_step)

    @property
    def step(self) -> float:
        """Effective step of the physics, in s."""
        return self.frame_interval / self.steps_per_frame


Progress: TypeAlias = Callable[[float], None]
"""Callback that receives the completed share, from 0 to 1."""


def no_progress(share: float) -> None:
    """Ignore progress."""


def report_frames(n_frames: int, progress: Progress) -> Iterator[int]:
    """Count frames, and report the completed share about a hundred times."""
    interval = max(1, n_frames // 100)
    for frame in range(n_frames):
        yield frame
        if frame % interval == 0:
            progress(frame / n_frames)


@dataclass(frozen=True, eq=False)
class Prop(Immutable):
    """Objects of one shape in a scene, static or moving.

    role: Determines the style of drawing; only the edges of a room are drawn.
    mesh: Surface in local coordinates.
    centres (T, B, 3): Positions of the local origins of B objects in each frame; T = 1 for static
        objects.
    rotations (T, B, 3, 3): Rotation matrix of each object in each frame. Default: identity.
    scales (B,): Size of each object relative to the mesh. Default: 1.
    """

    role: str
    mesh: Mesh
    centres: NDArray[np.float64]
    rotations: NDArray[np.float64] | None = None
    scales: NDArray[np.float64] | None = None

    def surfaces(self, frame: int) -> list[NDArray[np.float64]]:
        """Return the vertices of each of the B objects in a frame, each of shape (V, 3)."""
        centres = self.centres[frame % len(self.centres)]
        scales = np.ones(len(centres)) if self.scales is None else self.scales
        corners = scales[:, None, None] * self.mesh.vertices
        if self.rotations is not None:
            rotations = self.rotations[frame % len(self.rotations)]
            corners = np.einsum("bij,bvj->bvi", rotations, corners)
        return list(corners + centres[:, None])


@dataclass(frozen=True, eq=False)
class Scene(Immutable):
    """Objects, sensors and readings of a simulated run.

    sensors (T, N, 3): Sensor positions in each frame; T = 1 for static sensors.
    readings (T, N)
    times (T,): In seconds.
    units: Unit of lengths.
    """

    title: str
    props: tuple[Prop, ...]
    sensors: NDArray[np.float64]
    readings: NDArray[np.floating]
    times: NDArray[np.float64]
    units: str

    @property
    def n_frames(self) -> int:
        """Number of frames, T."""
        return len(self.readings)


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """Readings (T, N), and objects to draw, of one simulated run.

    facts: Measured quantities and effective parameters, in addition to the options.
    sensors (T, N, 3): Positions of the sensors in each frame; by default, positions on the body.
    """

    readings: NDArray[np.floating]
    props: tuple[Prop, ...]
    facts: Mapping[str, Scalar] = field(default_factory=dict)
    sensors: NDArray[np.float64] | None = None


def static_props(body: Body) -> tuple[Prop, ...]:
    """Return the props of a body that does not move."""
    return tuple(Prop("body", solid.outline, np.zeros((1, 1, 3))) for solid in body.solids)
