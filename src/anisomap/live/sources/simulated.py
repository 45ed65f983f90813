"""A simulated hand that rubs a simulated body: the demonstration that needs no robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from threading import Event
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.live.batches import WAIT_S, Batch, Item
from anisomap.sensor_map import SensorMap
from anisomap.simulation.bodies import Body
from anisomap.simulation.kinematic.guided import GuidedHand
from anisomap.simulation.kinematic.rubbing import RubbingOptions
from anisomap.simulation.options import options_for

BOUT_FRAMES = 40
"""Frames for which the hand rubs one place: 2 s, in which a person looks at the page again."""


Advised: TypeAlias = tuple[Sequence[int], NDArray[np.intp] | None]


def _nowhere() -> Advised:
    return (), None


class SimulatedHand:
    """A palm on a body. It asks before each bout where to rub.

    Parameters
    ----------
    body : Body
    seed : int
    speed : float
        Multiple of the speed of a human hand, about 20 frames per second; 0 for as fast as
        possible.
    max_frames : int
        Number of frames after which the source ends; 0 for none.

    Attributes
    ----------
    where : callable
        Returns the sensors to rub next, by index, and the contacts of each sensor if they are
        known; no sensors for anywhere.
    """

    can_wait = True

    def __init__(self, body: Body, seed: int = 1, speed: float = 1.0, max_frames: int = 0) -> None:
        self.names = body.names
        self.truth: SensorMap | None = SensorMap(body.positions, names=body.names, units=body.units)
        self.description = f"simulated hand on {body.name}, seed {seed}"
        self.where: Callable[[], Advised] = _nowhere
        self._options = options_for(RubbingOptions, body)
        self._hand = GuidedHand(body, self._options, np.random.default_rng(seed))
        self._speed, self._max_frames = speed, max_frames

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, one by one."""
        started, n_frames, interval = time.monotonic(), 0, self._options.frame_interval
        while not stop.is_set():
            for row in self._hand.rub(BOUT_FRAMES, *self.where()):
                due = started + (n_frames * interval / self._speed if self._speed else 0)
                while (left := due - time.monotonic()) > 0:
                    if stop.wait(min(left, WAIT_S)):
                        return
                times = np.array([n_frames * interval])
                yield Batch(row[None].astype(np.float64), times)
                n_frames += 1
                if n_frames == self._max_frames or stop.is_set():
                    return
