"""Recordings with known truth: bodies, what happens to them, what sensors read, what breaks.

Needs the extra ``simulation`` (MuJoCo) when a simulation runs, and not before.
"""

from anisomap.simulation.bodies import BODIES, Body
from anisomap.simulation.bombardment import BombardmentOptions
from anisomap.simulation.faults import (
    FAULTS,
    Fault,
    dead,
    fault_mask,
    inflicted_faults,
    noisy,
    saturating,
)
from anisomap.simulation.scenarios import (
    SCENARIOS,
    Simulation,
    run_simulation,
    simulate,
    simulate_runs,
)

__all__ = [
    "BODIES",
    "FAULTS",
    "SCENARIOS",
    "Body",
    "BombardmentOptions",
    "Fault",
    "Simulation",
    "dead",
    "fault_mask",
    "inflicted_faults",
    "noisy",
    "run_simulation",
    "saturating",
    "simulate",
    "simulate_runs",
]
