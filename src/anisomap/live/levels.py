"""What each sensor reads now, on a scale from rest to its strongest reading."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from anisomap.live.maps.quick_map import QuickMap


class Levels:
    """Levels of the sensors, renewed at each tick of a session.

    Attributes
    ----------
    values : ndarray of shape (N,)
        From 0 (at rest) to 1 (the strongest reading so far); empty before the first frame.
    """

    def __init__(self) -> None:
        self.values: NDArray[np.float64] = np.empty(0)
        self._first: NDArray[np.float64] | None = None

    def restart(self) -> None:
        """Forget the first frame, since other sensors follow."""
        self._first = None

    def renew(
        self, parts: Sequence[NDArray[np.float64]], width: int, quick: QuickMap | None
    ) -> None:
        """Compute the deepest reading of each sensor among frames.

        Parameters
        ----------
        parts : sequence of ndarray of shape (t, N)
            Frames since the last call; those of another width than `width` are left out.
        width : int
            Number of sensors.
        quick : QuickMap or None
            Holds the resting readings of the sensors. Before it is made, the first frame counts as
            rest.
        """
        parts = [part for part in parts if part.shape[1] == width]
        if not parts:
            return
        readings = np.concatenate(parts)
        if self._first is None or len(self._first) != width:
            self._first = readings[0]
        if quick is not None and len(quick.names) == width:
            depth, full = quick.rest.depth(readings), quick.highest_depth
        else:
            depth = np.abs(readings - self._first)
            full = np.nanmax(np.append(depth, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.fmax.reduce(depth, axis=0) / np.where(full > 0, full, 1.0)
        self.values = np.clip(np.nan_to_num(share), 0, 1)
