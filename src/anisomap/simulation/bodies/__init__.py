"""Bodies with sensors on their surface: to add one, add a function and a line to `BODIES`."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from anisomap.simulation.bodies.body import UNITS, Body
from anisomap.simulation.bodies.hexagonal_patch import hexagon
from anisomap.simulation.bodies.imported import (
    body_from_mesh,
    body_from_mjcf,
    body_from_points,
    load_body,
)
from anisomap.simulation.bodies.lattice import cylinder, plane, sphere, y_shape
from anisomap.simulation.bodies.poisson_disc import (
    cube,
    hand,
    hemisphere,
    holed_plate,
    torus,
    tube,
    uneven_sphere,
)

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
        "sphere": sphere,
        "cylinder": cylinder,
        "y-shape": y_shape,
        "plane": plane,
        "hexagon": hexagon,
        "torus": torus,
        "cube": cube,
        "hemisphere": hemisphere,
        "hand": hand,
        "tube": tube,
        "holed-plate": holed_plate,
        "uneven-sphere": uneven_sphere,
    }
)
"""Each takes the number of its sensors, and has a default for it. The paper's come first."""
