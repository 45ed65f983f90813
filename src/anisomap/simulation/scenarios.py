"""Simulation of recordings from a body and a scenario.

To add a scenario, add one function and one line to `SCENARIOS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from inspect import getdoc
from types import MappingProxyType
from typing import Any

import numpy as np

from anisomap._version import __version__
from anisomap.errors import InputError
from anisomap.map_verdict import CONTACTS
from anisomap.numerics.ranges import COUNT
from anisomap.recording import Recording, Scalar
from anisomap.simulation.bodies import BODIES
from anisomap.simulation.body import Body
from anisomap.simulation.bombardment import BombardmentOptions, bombardment
from anisomap.simulation.kinematic import RubbingOptions, rubbing
from anisomap.simulation.locomotion import LocomotionOptions, locomotion
from anisomap.simulation.options import Progress, ScenarioResult, Scene, no_progress, options_for
from anisomap.simulation.physics import load_mujoco

DEFAULT_FRAMES = 2000  # as in the paper
DEFAULT_SEED = 1


@dataclass(frozen=True)
class Scenario:
    """A way to stimulate the skin of a body.

    options: Subclass of `ScenarioOptions`.
    function: Takes a `Body`, the number of frames, the options and a numpy Generator, and returns a
        `ScenarioResult`. With `uses_mujoco`, it also takes a `Progress`. Its docstring begins with
        "Simulate" and names the stimulus. It refuses bodies that it cannot move.
    """

    options: type[Any]
    function: Callable[..., ScenarioResult]
    uses_mujoco: bool = False

    @property
    def summary(self) -> str:
        """The stimulus in one line."""
        first_line = (getdoc(self.function) or "").partition("\n")[0]
        return first_line.removeprefix("Simulate ").removesuffix(".")


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated recording and its scene.

    scene: Objects and sensors in each frame, for drawing.
    """

    recording: Recording
    scene: Scene


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        "bombardment": Scenario(BombardmentOptions, bombardment, uses_mujoco=True),
        "locomotion": Scenario(LocomotionOptions, locomotion, uses_mujoco=True),
        "rubbing": Scenario(RubbingOptions, rubbing),
    }
)


def simulate(
    body: str | Body = "sphere",
    scenario: str = "bombardment",
    *,
    n_frames: int = DEFAULT_FRAMES,
    seed: int | np.random.Generator = DEFAULT_SEED,
    n_sensors: int | None = None,
    progress: Progress | None = None,
    **parameters: Any,
) -> Recording:
    """Simulate a recording with known sensor positions.

    Parameters
    ----------
    body : str or Body
        A name in `BODIES`, or a body, such as one made by `body_from_points`.
    scenario : str
        A name in `SCENARIOS`.
    n_frames : int
        Number of frames.
    seed : int or numpy.random.Generator
        The same seed gives the same recording, byte for byte on one machine. A seed drawn from a
        generator is stored in the metadata, so that the recording can be reproduced.
    n_sensors : int, optional
        Number of sensors on a named body. Defaults to the number of the body, such as 60 on the
        sphere.
    progress : callable, optional
        Receives the completed share, from 0 to 1.
    **parameters
        Options of the scenario. Defaults scale with the body.

    Returns
    -------
    Recording
        With true positions, normals and distances along the surface. Metadata contain the body, the
        scenario, the seed, versions, all options, and measured physical quantities.

    Raises
    ------
    InputError
        If a name is unknown, or a parameter is outside its range.
    MissingExtraError
        If the scenario requires MuJoCo, which is not installed.

    Notes
    -----
    McGregor et al. (2011), section "Tactile Data: Simulated Environment",
    doi:10.1371/journal.pone.0026561.
    """
    made = find_body(body, n_sensors)
    return run_simulation(made, scenario, n_frames, seed, progress, **parameters).recording


def run_simulation(
    body: str | Body = "sphere",
    scenario: str = "bombardment",
    n_frames: int = DEFAULT_FRAMES,
    seed: int | np.random.Generator = DEFAULT_SEED,
    progress: Progress | None = None,
    **parameters: Any,
) -> Simulation:
    """Simulate a recording and its scene; see `simulate`."""
    COUNT.check("n_frames", n_frames)
    chosen = find_scenario(scenario)
    given = find_body(body)
    options = options_for(chosen.options, given, parameters)
    if isinstance(seed, np.random.Generator):
        number = int(seed.integers(2**63))
    elif isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed must be a non-negative integer or a numpy Generator, got {seed!r}")
    else:
        number = int(seed)
    rng, report = np.random.default_rng(number), progress or no_progress
    reported = (report,) if chosen.uses_mujoco else ()
    result = chosen.function(given, n_frames, options, rng, *reported)
    report(1.0)
    metadata: dict[str, Scalar] = {"body": given.name, "scenario": scenario, "seed": number}
    for name, value in {**asdict(options), **result.facts}.items():
        if value is not None:  # files cannot store None or numpy scalars
            metadata[name] = value.item() if isinstance(value, np.generic) else value
    rolls = scenario == "locomotion" and given.solids[0].kind == "cylinder"
    metadata["contacts"] = CONTACTS[rolls]
    metadata["anisomap"] = __version__
    if chosen.uses_mujoco:
        metadata["mujoco"] = load_mujoco().__version__
    rate_hz = 1 / options.frame_interval
    recording = Recording(
        result.readings,
        names=given.names,
        rate_hz=rate_hz,
        positions=given.positions + given.origin,
        normals=given.normals,
        surface_distances=given.surface_distances,
        units=given.units,
        source=f"simulated {scenario} of {given.name}, seed {number}",
        metadata=metadata,
    )
    scene = Scene(
        f"{given.name}, {scenario}",
        result.props,
        given.positions[None] if result.sensors is None else result.sensors,
        recording.readings,
        np.arange(n_frames) / rate_hz,
        given.units,
    )
    return Simulation(recording, scene)


def find_scenario(name: str) -> Scenario:
    """Look up a scenario by name."""
    if name not in SCENARIOS:
        raise InputError(f"there is no scenario {name!r}; choose from {', '.join(SCENARIOS)}")
    return SCENARIOS[name]


def find_body(body: str | Body, n_sensors: int | None = None) -> Body:
    """Create a body by name. A `Body` is returned unchanged.

    Parameters
    ----------
    body : str or Body
    n_sensors : int, optional

    Raises
    ------
    InputError
        If there is no such body, or `n_sensors` is given with a `Body`.
    """
    if isinstance(body, Body):
        if n_sensors is not None:
            raise InputError(f"n_sensors cannot be given: {body.name} has {body.n_sensors} sensors")
        return body
    if body not in BODIES:
        raise InputError(f"there is no body {body!r}; choose from {', '.join(BODIES)}")
    return _named_body(body, n_sensors)


@lru_cache(maxsize=16, typed=True)  # runs of a body with many seeds share surface distances
def _named_body(name: str, n_sensors: int | None) -> Body:
    return BODIES[name]() if n_sensors is None else BODIES[name](n_sensors)
