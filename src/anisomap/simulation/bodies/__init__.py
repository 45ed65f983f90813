"""Bodies with sensors on their surface.

To add a body, add one function and one line to `BODIES`.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from anisomap.simulation.bodies import lattice, poisson_disc
from anisomap.simulation.bodies.body import UNITS, Body
from anisomap.simulation.bodies.imported import (
    body_from_mesh,
    body_from_mjcf,
    body_from_points,
    load_body,
)
from anisomap.simulation.bodies.lattice import hexagon

__all__ = [
    "BODIES",
    "UNITS",
    "Body",
    "body_from_mesh",
    "body_from_mjcf",
    "body_from_points",
    "load_body",
]

BODIES: Mapping[str, Callable[..., Body]] = MappingProxyType(
    {
        "sphere": lattice.sphere,
        "cylinder": lattice.cylinder,
        "y-shape": lattice.y_shape,
        "plane": lattice.plane,
        "hexagon": hexagon,
        "torus": poisson_disc.torus,
        "cube": poisson_disc.cube,
        "hemisphere": poisson_disc.hemisphere,
        "hand": poisson_disc.hand,
        "tube": poisson_disc.tube,
        "holed-plate": poisson_disc.holed_plate,
        "uneven-sphere": poisson_disc.uneven_sphere,
    }
)
"""Functions ``make(n_sensors)`` with a default number of sensors. The paper's bodies come first."""
