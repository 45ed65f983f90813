"""A hand that is told where to rub: by a coach, or not at all."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.simulation.bodies.body import Body
from anisomap.simulation.kinematic.paths import draw_strokes, sample_skin
from anisomap.simulation.kinematic.rubbing import RubbingOptions, draw_angles, draw_palm
from anisomap.simulation.kinematic.settling import LIFT_HEIGHT, Cluster, settle
from anisomap.simulation.sensing import read_balls

TRAVEL_FRAMES = 6
"""Frames off the skin before each bout: 0.3 s, as for a lift between strokes."""


@dataclass
class GuidedHand:
    """A palm that rubs a body in bouts, each of them where it is told.

    Parameters
    ----------
    body : Body
    options : RubbingOptions
    rng : numpy.random.Generator
    """

    body: Body
    options: RubbingOptions
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self._skin = sample_skin(self.body, self.rng)
        self._pads, self._radii = draw_palm(self.options.hand_size, self.rng)

    def rub(
        self,
        n_frames: int,
        sensors: Collection[int] = (),
        contacts: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Rub for some frames.

        Parameters
        ----------
        n_frames : int
            More than 6: the first frames are those in which the hand moves off the skin.
        sensors : collection of int
            Sensors at which the hand is set down; by default anywhere.
        contacts : ndarray of int, shape (N,), optional
            Contacts of each sensor before: strokes lead to sensors that have few. By default they
            are not known. 1 for sensors that were touched and 0 for others lets strokes lead to
            those that were never touched.

        Returns
        -------
        ndarray of shape (n_frames, N)
            Readings, as of the scenario "rubbing".
        """
        n_sensors, options, rng = self.body.n_sensors, self.options, self.rng
        visits = np.zeros(n_sensors)
        if contacts is not None:
            visits += contacts
        if sensors:
            first = list(sensors)
            visits[first] = np.minimum(visits[first], 0)
            visits[first[0]] = -1  # the hand is set down at the least visited sensor
        n_rubbing = max(1, n_frames - TRAVEL_FRAMES)
        path = draw_strokes(self.body, self._skin, n_rubbing, options, rng, visits=visits)
        angles = draw_angles(n_rubbing, options.frame_interval, rng)
        offsets = np.einsum("tij,pj->tpi", path.orientations(angles), self._pads)
        cluster = Cluster(offsets, self._radii)
        heights = settle(self.body, self._skin, path, cluster, options.press_depth * path.presses)
        heights += path.lifts * LIFT_HEIGHT * options.detection_radius
        pads = cluster.placed(path, heights)
        touched = read_balls(self.body.positions, pads, self._radii, options.detection_radius)
        travel = np.zeros((n_frames - n_rubbing, n_sensors), dtype=np.float32)
        return np.concatenate([travel, touched])
