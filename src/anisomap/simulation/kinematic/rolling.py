"""Rolling: a roller moves along the skin and touches whole lines of sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.geometry import solids
from anisomap.simulation.kinematic.paths import StrokeOptions, draw_strokes, sample_skin
from anisomap.simulation.kinematic.settling import LIFT_HEIGHT, Cluster, settle
from anisomap.simulation.options import REACH, positive
from anisomap.simulation.result import ScenarioResult, static_props
from anisomap.simulation.sensing import read_capsules


@dataclass(frozen=True)
class RollerOptions(StrokeOptions):
    """Options of rolling, in addition to those of `StrokeOptions`.

    Parameters
    ----------
    roller_radius : float
        In m. 0.2: thin, so that the roller touches a line of sensors instead of an area.
    roller_length : float
        Length without the round caps, in m. 1.2: a few sensor spacings of the sphere.
    detection_radius : float
        Detection radius of the sensors, in m. 0.3: as in `RubbingOptions`.

    Raises
    ------
    InputError
        As `StrokeOptions`, or if `press_depth` is not below `roller_radius`.
    """

    roller_radius: float = positive(0.2, "m", REACH)
    roller_length: float = positive(1.2, "m", REACH)
    detection_radius: float = positive(0.3, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.press_depth >= self.roller_radius:
            raise InputError(
                f"press_depth must be below roller_radius ({self.roller_radius:g} m), "
                f"got {self.press_depth:g} m"
            )


def roller(
    body: Body, n_frames: int, options: RollerOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate a roller that moves along the skin of a body.

    Notes
    -----
    The roller is a capsule across its direction of motion. At the start of a stroke it turns to the
    new direction from one frame to the next.
    """
    skin = sample_skin(body, rng)
    path = draw_strokes(body, skin, n_frames, options, rng)
    across = np.cross(path.normals, path.headings)
    axes = options.roller_length / 2 * across[:, None]
    cluster = Cluster(np.zeros_like(axes), np.array([options.roller_radius]), axes)
    heights = settle(body, skin, path, cluster, options.press_depth * path.presses)
    centres = cluster.placed(path, heights + path.lifts * LIFT_HEIGHT * options.detection_radius)
    readings = read_capsules(
        body.positions,
        centres - axes,
        centres + axes,
        options.roller_radius,
        options.detection_radius,
    )
    half = options.roller_length / 2
    shape = solids.capsule(options.roller_radius, [0, 0, -half], [0, 0, half])
    rotations = np.stack([path.normals, path.headings, across], axis=-1)
    stimulus = Prop("stimulus", shape.outline, centres, rotations[:, None])
    return ScenarioResult(
        readings, (*static_props(body), stimulus), facts={"n_strokes": path.n_strokes}
    )
