"""Simulating a recording: a body, what happens to it, and what its sensors read.

To add a scenario, add one function and one line to `SCENARIOS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from anisomap._version import __version__
from anisomap.errors import InputError
from anisomap.recording import Recording, Scalar
from anisomap.scene import Scene
from anisomap.simulation.bodies import BODIES, Body
from anisomap.simulation.bodies.geodesics import surface_distances
from anisomap.simulation.checks import check_count
from anisomap.simulation.engine import load_mujoco
from anisomap.simulation.kinematic.pressing import PressingOptions, pressing
from anisomap.simulation.kinematic.pulses import PulsesOptions, pulses
from anisomap.simulation.kinematic.rolling import RollerOptions, roller
from anisomap.simulation.kinematic.rubbing import RubbingOptions, rubbing
from anisomap.simulation.kinematic.self_touch import SelfTouchOptions, self_touch
from anisomap.simulation.options import options_for
from anisomap.simulation.physics.bombardment import BombardmentOptions, bombardment
from anisomap.simulation.physics.driving import LocomotionOptions
from anisomap.simulation.physics.locomotion import locomotion, rolls
from anisomap.simulation.world import Progress, Run

Entry = TypeVar("Entry")

DEFAULT_FRAMES = 2000
"""As many as the paper's runs have."""

DEFAULT_SEED = 1


@dataclass(frozen=True)
class Scenario:
    """What can happen to a body.

    Attributes
    ----------
    summary : str
        A line on it.
    options : type
        The frozen dataclass of its parameters; called without arguments it gives the defaults.
    run : callable
        Takes body, number of frames, options, a numpy Generator and a progress callable or None;
        gives a `Run`.
    uses_mujoco : bool
        Whether it runs on the physics engine, whose version is then on the record.
    accepts : callable
        Takes a body; tells whether this can happen to it. `run` refuses others.
    """

    summary: str
    options: type[Any]
    run: Callable[..., Run]
    uses_mujoco: bool = False
    accepts: Callable[[Body], bool] = lambda _: True


@dataclass(frozen=True, eq=False)
class Simulation:
    """A recording, and how it came about.

    Attributes
    ----------
    recording : Recording
    scene : Scene
        What there was to be seen, for pictures.
    """

    recording: Recording
    scene: Scene


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        "bombardment": Scenario(
            "elastic balls fly about the body in a box without gravity",
            BombardmentOptions,
            bombardment,
            uses_mujoco=True,
        ),
        "locomotion": Scenario(
            "a sphere or cylinder rolls over uneven ground under gravity",
            LocomotionOptions,
            locomotion,
            uses_mujoco=True,
            accepts=rolls,
        ),
        "rubbing": Scenario(
            "a palm rubs the skin along lines and circles, pressing more and less",
            RubbingOptions,
            rubbing,
        ),
        "roller": Scenario(
            "a roller lies across the skin and is rolled along it", RollerOptions, roller
        ),
        "pressing": Scenario(
            "a large flat surface is pressed against the body from all sides",
            PressingOptions,
            pressing,
        ),
        "self-touch": Scenario(
            "a fingertip with sensors of its own strokes the body, and both feel it",
            SelfTouchOptions,
            self_touch,
        ),
        "pulses": Scenario(
            "point sources flash around the body, and the response falls off with distance",
            PulsesOptions,
            pulses,
        ),
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
    """Simulate a recording whose truth is known.

    Parameters
    ----------
    body : str or Body
        A name in `BODIES`, or a body of your own (`body_from_mesh` and its like).
    scenario : str
        A name in `SCENARIOS`.
    n_frames : int
        How many frames to record.
    seed : int or numpy.random.Generator
        Same seed, same recording, byte for byte on one machine. A generator gives the seed that
        is then used and recorded, so that the recording can be made again from its metadata.
    n_sensors : int, optional
        Sensors on a body that is named; its own number unless given (60 on the sphere).
    progress : callable, optional
        Told the share done, from 0 to 1.
    **parameters
        Those of the scenario, see its options; what is not given has a default that accepts the
        body.

    Returns
    -------
    Recording
        With true positions, normals and distances along the surface. Its metadata hold body,
        scenario, seed, versions, every parameter, and what was measured of the physics.

    Raises
    ------
    InputError
        If a name is unknown, or a parameter makes no sense.
    MissingExtraError
        If MuJoCo is not installed.

    Notes
    -----
    McGregor et al. (2011), section "Tactile Data: Simulated Environment",
    doi:10.1371/journal.pone.0026561.
    """
    return run_simulation(
        body,
        scenario,
        n_frames=n_frames,
        seed=seed,
        n_sensors=n_sensors,
        progress=progress,
        **parameters,
    ).recording


def run_simulation(
    body: str | Body = "sphere",
    scenario: str = "bombardment",
    *,
    n_frames: int = DEFAULT_FRAMES,
    seed: int | np.random.Generator = DEFAULT_SEED,
    n_sensors: int | None = None,
    progress: Progress | None = None,
    **parameters: Any,
) -> Simulation:
    """Simulate as `simulate` does, and keep the scene, too."""
    check_count("n_frames", n_frames)
    chosen = find_scenario(scenario)
    skin = find_body(body, n_sensors)
    used = options_for(chosen.options, skin, parameters)
    number = _seed_number(seed)
    run = chosen.run(skin, n_frames, used, np.random.default_rng(number), progress)
    facts = {
        "body": skin.name,
        "scenario": scenario,
        "seed": number,
        **{name: _plain(value) for name, value in run.facts.items() if value is not None},
        "anisomap": __version__,
    }
    if chosen.uses_mujoco:
        facts["mujoco"] = load_mujoco().__version__
    carrier = run.body or skin
    recording = Recording(
        run.readings,
        names=carrier.names,
        rate_hz=run.rate_hz,
        positions=carrier.positions + carrier.origin,
        normals=carrier.normals,
        surface_distances=surface_distances(carrier),
        units=skin.units,
        source=f"simulated {scenario} of {skin.name}, seed {number}",
        metadata=facts,
    )
    times = np.arange(n_frames) / run.rate_hz
    title = f"{skin.name}, {scenario}"
    scene = Scene(title, run.props, run.sensors, recording.readings, times, skin.units)
    return Simulation(recording, scene)


def simulate_runs(
    body: str | Body,
    scenario: str,
    seeds: Iterable[int],
    *,
    workers: int | None = None,
    **settings: Any,
) -> list[Recording]:
    """Simulate with several seeds, in parallel over the cores.

    Parameters
    ----------
    body : str or Body
    scenario : str
    seeds : iterable of int
    workers : int, optional
        Processes; as many as there are cores unless given.
    **settings
        What `simulate` takes besides.

    Returns
    -------
    list of Recording
        In the order of the seeds; each the same as `simulate` gives.
    """
    one = partial(_simulate_seed, body, scenario, settings)
    chosen = list(seeds)
    if workers == 1 or len(chosen) < 2:
        return [one(seed) for seed in chosen]
    # Fresh processes, since forked ones inherit threads of the libraries below.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(one, chosen))


def find_scenario(name: str) -> Scenario:
    """Look a scenario up.

    Raises
    ------
    InputError
        If there is none of that name; the message lists those that there are.
    """
    return _find("scenario", SCENARIOS, name)


def find_body(body: str | Body, n_sensors: int | None = None) -> Body:
    """Make a body by its name, or take one that is made.

    Raises
    ------
    InputError
        If there is no body of that name, or `n_sensors` is given for one that is made.
    """
    if isinstance(body, Body):
        if n_sensors is not None:
            raise InputError(f"n_sensors is {n_sensors}, but the body {body.name} has its sensors")
        return body
    make = _find("body", BODIES, body)
    return make() if n_sensors is None else make(n_sensors)


def _simulate_seed(
    body: str | Body, scenario: str, settings: Mapping[str, Any], seed: int
) -> Recording:
    return simulate(body, scenario, seed=seed, **settings)


def _find(what: str, registry: Mapping[str, Entry], name: str) -> Entry:
    if name not in registry:
        raise InputError(f"there is no {what} {name!r}; choose from {', '.join(registry)}")
    return registry[name]


def _plain(value: Scalar) -> Scalar:
    """Make numpy's numbers Python's, which is what files hold."""
    return value.item() if isinstance(value, np.generic) else value


def _seed_number(seed: int | np.random.Generator) -> int:
    if isinstance(seed, np.random.Generator):
        return int(seed.integers(2**63))
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(
            f"seed is {seed!r}; it must be a whole number of at least 0, or a numpy Generator"
        )
    return int(seed)
