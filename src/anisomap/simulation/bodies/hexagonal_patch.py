"""The hardware patch of McGregor et al. (2011): a hexagon of six IIT triangles.

A triangle has 12 capacitive pads, of which two are thermal and no sensors. Maiolino et al. (2013),
"A flexible and robust large scale capacitive tactile system for robots", IEEE Sensors Journal
13(10): 3910-3917, doi:10.1109/JSEN.2013.2258149, describe it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import Body, straight_lines
from anisomap.simulation.geometry import solids

TRIANGLES = 6

# Pads in the order of their channels, in mm, the middle of the triangle in the origin. They stand
# in rows of a triangular lattice with a pitch of 6.533 mm; the thermal pads lie beside it.
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
_PADS = len(_PADS_MM)

# From the middle of a triangle, whose edges are 32.2 mm, to its corner, where all six meet.
_APEX_MM = 18.6
_MARGIN_MM = 8.0
_THICKNESS_MM = 5.0
_MM = 1e-3


def hexagon(n_sensors: int = 60) -> Body:
    """Make the hexagonal patch: six triangles about a corner, each a turn of 60 degrees.

    Parameters
    ----------
    n_sensors : int
        60: the ten sensors of each of six triangles.

    Returns
    -------
    Body
        Its sensors are named after triangle and pad, ``t0p0`` to ``t5p11``, thermal pads left out.

    Raises
    ------
    InputError
        If `n_sensors` is not 60.
    """
    sensing = [pad for pad in range(_PADS) if pad not in THERMAL_PADS]
    if n_sensors != TRIANGLES * len(sensing):
        raise InputError(f"n_sensors is {n_sensors}; the hexagonal patch has 60")
    flat = _MM * np.vstack([_triangle(turn)[sensing] for turn in range(TRIANGLES)])
    height = _MM * _THICKNESS_MM / 2
    half = np.abs(flat).max() + _MM * _MARGIN_MM
    return Body(
        name="hexagon",
        positions=np.column_stack([flat, np.full(len(flat), height)]),
        normals=np.tile([0.0, 0.0, 1.0], (len(flat), 1)),
        solids=[solids.box((half, half, height))],
        names=tuple(f"t{turn}p{pad}" for turn in range(TRIANGLES) for pad in sensing),
        geodesic=straight_lines,
    )


def _triangle(turn: int) -> NDArray[np.float64]:
    """Give the pads of one triangle, its upper corner in the middle of the patch, then turned."""
    angle = turn * np.pi / 3
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray((_PADS_MM - [0, _APEX_MM]) @ rotation.T)
