"""Simulated recordings with known sensor positions: bodies, scenarios, readings and faults.

Running a simulation needs the extra ``simulation`` (MuJoCo); importing the package does not.
"""

from anisomap.simulation.bodies import BODIES
from anisomap.simulation.body import Body
from anisomap.simulation.coverage import CoverageCurve, coverage_curve
from anisomap.simulation.faults import dead, noisy, saturating
from anisomap.simulation.imported import (
    body_from_mesh,
    body_from_mjcf,
    body_from_points,
    load_body,
)
from anisomap.simulation.injection import (
    FAULTS,
    FRAME_FAULTS,
    Fault,
    fault_mask,
    inject,
    injected_faults,
    parse_fault,
)
from anisomap.simulation.kinematic import (
    PressingOptions,
    PulsesOptions,
    RollerOptions,
    RubbingOptions,
    SelfTouchOptions,
)
from anisomap.simulation.physics.bombardment import BombardmentOptions
from anisomap.simulation.physics.locomotion import LocomotionOptions
from anisomap.simulation.scenarios import (
    SCENARIOS,
    Simulation,
    find_body,
    find_scenario,
    run_simulation,
    simulate,
    simulate_runs,
)

__all__ = [
    "BODIES",
    "FAULTS",
    "FRAME_FAULTS",
    "SCENARIOS",
    "Body",
    "BombardmentOptions",
    "CoverageCurve",
    "Fault",
    "LocomotionOptions",
    "PressingOptions",
    "PulsesOptions",
    "RollerOptions",
    "RubbingOptions",
    "SelfTouchOptions",
    "Simulation",
    "body_from_mesh",
    "body_from_mjcf",
    "body_from_points",
    "coverage_curve",
    "dead",
    "fault_mask",
    "find_body",
    "find_scenario",
    "inject",
    "injected_faults",
    "load_body",
    "noisy",
    "parse_fault",
    "run_simulation",
    "saturating",
    "simulate",
    "simulate_runs",
]
