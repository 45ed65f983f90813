"""A roller that lies across the skin and is rolled along it: it touches whole lines of sensors."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import check_positive
from anisomap.simulation.geometry import solids
from anisomap.simulation.kinematic.paths import StrokeOptions, find_skin, wander
from anisomap.simulation.kinematic.settling import CLEAR, Cluster, settle
from anisomap.simulation.options import REACH, parameter
from anisomap.simulation.sensing import read_capsules
from anisomap.simulation.world import Progress, Run, still_life


@dataclass(frozen=True)
class RollerOptions(StrokeOptions):
    """Parameters of rolling, beside those of `StrokeOptions`.

    Parameters
    ----------
    roller_radius : float
        Metres. 0.2: thin, so that it touches a line and not an area.
    roller_length : float
        Metres from one end to the other, without the round caps. 1.2: longer than it is thick, and
        a few sensors of the sphere wide.
    detection_radius : float
        Metres. 0.3: as in `RubbingOptions`.

    Raises
    ------
    InputError
        As `StrokeOptions`; or if the roller is too thin to press that deep.
    """

    roller_radius: float = parameter(0.2, "m", REACH)
    roller_length: float = parameter(1.2, "m", REACH)
    detection_radius: float = parameter(0.3, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("roller_radius", "roller_length", "detection_radius"):
            check_positive(name, getattr(self, name), "m")
        if self.press_depth >= self.roller_radius:
            raise InputError(
                f"press_depth is {self.press_depth:g} m; it must be less than the roller's radius, "
                f"which is {self.roller_radius:g} m"
            )


def roller(
    body: Body,
    n_frames: int,
    options: RollerOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body's sensors read while a roller is rolled along it.

    Parameters
    ----------
    body : Body
    n_frames : int
    options : RollerOptions
    rng : numpy.random.Generator
        Draws the way.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run
        The roller, a cylinder with round ends, lies across the direction in which it moves; where
        a new stroke starts, it is turned into that from one frame to the next.
    """
    path = wander(body, skin := find_skin(body, rng), n_frames, options, rng)
    across = np.cross(path.normals, path.headings)
    axes = options.roller_length / 2 * across[:, None]
    cluster = Cluster(np.zeros_like(axes), np.array([options.roller_radius]), axes)
    heights = settle(body, skin, path, cluster, options.press_depth * path.presses)
    centres = cluster.placed(path, heights + path.lifts * CLEAR * options.detection_radius)
    readings = read_capsules(
        body.positions,
        centres - axes,
        centres + axes,
        options.roller_radius,
        options.detection_radius,
    )
    if progress is not None:
        progress(1.0)
    half = options.roller_length / 2
    shape = solids.capsule(options.roller_radius, [0, 0, -half], [0, 0, half])
    turns = np.stack([path.normals, path.headings, np.cross(path.normals, path.headings)], axis=-1)
    return Run(
        readings,
        rate_hz=1 / options.frame_interval,
        facts=asdict(options) | {"n_strokes": path.n_strokes},
        props=(*still_life(body), Prop("stimulus", shape.outline, centres, turns[:, None])),
        sensors=body.positions[None],
    )
