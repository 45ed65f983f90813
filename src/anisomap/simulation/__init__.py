"""Simulated recordings with known sensor positions: bodies, scenarios and readings.

Running a simulation requires the extra ``simulation`` (MuJoCo); importing the package does not.
"""

from anisomap.simulation.bodies import BODIES as BODIES
from anisomap.simulation.bodies import body_from_points as body_from_points
from anisomap.simulation.body import Body as Body
from anisomap.simulation.bombardment import BombardmentOptions as BombardmentOptions
from anisomap.simulation.kinematic import RubbingOptions as RubbingOptions
from anisomap.simulation.locomotion import LocomotionOptions as LocomotionOptions
from anisomap.simulation.scenarios import SCENARIOS as SCENARIOS
from anisomap.simulation.scenarios import Simulation as Simulation
from anisomap.simulation.scenarios import find_body as find_body
from anisomap.simulation.scenarios import find_scenario as find_scenario
from anisomap.simulation.scenarios import run_simulation as run_simulation
from anisomap.simulation.scenarios import simulate as simulate
