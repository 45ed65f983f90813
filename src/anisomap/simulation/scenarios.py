"""Simulating a recording: a body, what happens to it, and what its sensors read.

To add a scenario, add one function and one line to `SCENARIOS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from anisomap._version import __version__
from anisomap.errors import InputError
from anisomap.recording import Recording, Scalar
from anisomap.simulation.bodies import BODIES, UNITS
from anisomap.simulation.bombardment import BombardmentOptions, bombardment
from anisomap.simulation.world import Progress, Run, check_count, load_mujoco

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
    """

    summary: str
    options: Callable[[], Any]
    run: Callable[..., Run]


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        "bombardment": Scenario(
            "elastic balls fly about the body in a box without gravity",
            BombardmentOptions,
            bombardment,
        ),
    }
)


def simulate(
    body: str = "sphere",
    scenario: str = "bombardment",
    *,
    n_frames: int = DEFAULT_FRAMES,
    seed: int | np.random.Generator = DEFAULT_SEED,
    n_sensors: int | None = None,
    options: BombardmentOptions | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Simulate a recording whose truth is known.

    Parameters
    ----------
    body : str
        A name in `BODIES`.
    scenario : str
        A name in `SCENARIOS`.
    n_frames : int
        How many frames to record.
    seed : int or numpy.random.Generator
        Same seed, same recording, byte for byte on one machine. A generator gives the seed that
        is then used and recorded, so that the recording can be made again from its metadata.
    n_sensors : int, optional
        Sensors on the body; the body's own number unless given (60 on the sphere).
    options : BombardmentOptions, optional
        Parameters of the scenario.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Recording
        With true positions in metres. Its metadata hold body, scenario, seed, versions, every
        parameter, and what was measured of the physics: ``energy_drift`` (as a share) and
        ``deepest_overlap`` (metres).

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
    check_count("n_frames", n_frames)
    chosen = _find("scenario", SCENARIOS, scenario)
    make = _find("body", BODIES, body)
    used = chosen.options() if options is None else options
    if type(used) is not chosen.options:
        raise InputError(
            f"options of {scenario} cannot be of type {type(used).__name__}; "
            f"give {chosen.options.__name__}"
        )
    number = _seed_number(seed)
    skin = make() if n_sensors is None else make(n_sensors)
    run = chosen.run(skin, n_frames, used, np.random.default_rng(number), progress)
    return Recording(
        run.readings,
        rate_hz=run.rate_hz,
        positions=skin.positions,
        units=UNITS,
        source=f"simulated {scenario} of a {skin.name}, seed {number}",
        metadata={
            "body": skin.name,
            "scenario": scenario,
            "seed": number,
            **{name: _plain(value) for name, value in run.facts.items()},
            "anisomap": __version__,
            "mujoco": load_mujoco().__version__,
        },
    )


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
