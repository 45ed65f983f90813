"""The hardware patch of McGregor et al. (2011): a hexagon of six IIT triangles.

A triangle has 12 capacitive pads, two of which are thermal and not used as sensors. See Maiolino
et al. (2013), "A flexible and robust large scale capacitive tactile system for robots", IEEE
Sensors Journal 13(10): 3910-3917, doi:10.1109/JSEN.2013.2258149.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import Body, straight_lines
from anisomap.simulation.geometry import solids

TRIANGLES = 6

# Pads in the order of their channels, in mm, relative to the middle of the triangle. They lie on a
# triangular lattice with a pitch of 6.533 mm, except for the thermal pads.
_PADS_MM = np.array(
    [
        (6.533, 0.0),
        (9.8, -5.66),
        (3.267, -5.66),
        (0.0, 0.0),
        (-3.267, -5.66),
        (-9.8, -5.66),
        (-6.51, -3.75),
        (-6.533, 0.0),
        (-3.267, 5.66),
        (0.0, 11.317),
        (0.0, 7.507),
        (3.267, 5.66),
    ]
)
THERMAL_PADS = (6, 10)
_N_PADS = len(_PADS_MM)

_APEX_MM = 18.6  # from the middle of a triangle, with edges of 32.2 mm, to its corner
_MARGIN_MM = 8.0  # between the outer pads and the edge of the patch; chosen by hand
_THICKNESS_MM = 5.0  # chosen by hand
_MM = 1e-3


def hexagon(n_sensors: int = 60) -> Body:
    """Make a hexagonal patch of six triangles with ten sensors each, as in the paper.

    Parameters
    ----------
    n_sensors : int
        Must be 60.

    Returns
    -------
    Body
        Sensors are named by triangle and pad, ``t0p0`` to ``t5p11``, without the thermal pads.

    Raises
    ------
    InputError
        If `n_sensors` is not 60.
    """
    sensing = [pad for pad in range(_N_PADS) if pad not in THERMAL_PADS]
    expected = TRIANGLES * len(sensing)
    if n_sensors != expected:
        raise InputError(f"n_sensors of the hexagonal patch must be {expected}, got {n_sensors}")
    flat = _MM * np.vstack([_triangle(i)[sensing] for i in range(TRIANGLES)])
    height = _MM * _THICKNESS_MM / 2
    half = np.abs(flat).max() + _MM * _MARGIN_MM
    return Body(
        name="hexagon",
        positions=np.column_stack([flat, np.full(len(flat), height)]),
        normals=np.tile([0.0, 0.0, 1.0], (len(flat), 1)),
        solids=[solids.box((half, half, height))],
        names=tuple(f"t{i}p{pad}" for i in range(TRIANGLES) for pad in sensing),
        geodesic=straight_lines,
    )


def _triangle(index: int) -> NDArray[np.float64]:
    """Return the pads of a triangle with its corner in the middle of the patch; shape (12, 2)."""
    angle = index * np.pi / 3
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray((_PADS_MM - [0, _APEX_MM]) @ rotation.T)
