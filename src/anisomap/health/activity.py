"""Readings of one sensor at rest and in contact, from the counts of its distinct values.

Numbers of separate contacts of sensors, and of pairs of sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import count_values
from anisomap.numerics.similarity.rest import Rest, rest_from_counts


@dataclass(frozen=True, eq=False)
class Activity:
    """Distinct readings of one sensor, and which of them are beyond rest.

    rest: Of this sensor: arrays of shape (1,).
    values (m,): Distinct readings in increasing order.
    counts: Number of frames at each.
    active: Which of them exceed the threshold; they follow one another.
    """

    rest: Rest
    values: NDArray[np.float64]
    counts: NDArray[np.int64]
    active: NDArray[np.bool_]

    @classmethod
    def of(cls, column: NDArray[Any]) -> Activity:
        """Count the readings of one sensor, shape (T,); finite."""
        found, counts = count_values(column)
        values = found.astype(np.float64)
        rest = rest_from_counts([(values, counts)])
        return cls(rest, values, counts, rest.side * (values - rest.value) > rest.threshold)

    @property
    def n_active(self) -> int:
        """Number of frames in contact."""
        return int(self.counts[self.active].sum())

    def frames(self, column: NDArray[Any]) -> NDArray[np.bool_]:
        """Return in which frames the sensor is in contact, shape (T,), as `Rest.active` does."""
        beyond = self.values[self.active].astype(column.dtype)
        if not beyond.size:
            return np.zeros(column.size, dtype=bool)
        return np.asarray((column >= beyond[0]) & (column <= beyond[-1]))


def frames_in_contact(column: NDArray[Any]) -> NDArray[np.bool_]:
    """Return in which frames one sensor is in contact, shape (T,), as `Rest.active` does."""
    active = column > column.min()
    # At the lowest reading in most frames: contact raises, and no reading is on the other side.
    if 2 * np.count_nonzero(active) < column.size:
        return np.asarray(active)
    return Activity.of(column).frames(column)


def join_rests(rests: Sequence[Rest]) -> Rest:
    """Join the rests of several groups of sensors, in order."""
    return Rest(
        **{
            one.name: np.concatenate([getattr(rest, one.name) for rest in rests])
            for one in fields(Rest)
        }
    )


def count_contacts(active: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of each sensor: runs of frames in which it is active."""
    on = np.asarray(active, dtype=bool)
    return np.asarray(on[:1].sum(axis=0) + np.count_nonzero(on[1:] > on[:-1], axis=0))


def count_joint_contacts(active: ArrayLike, pairs: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of pairs of sensors: runs of frames in which both are active."""
    on = np.ascontiguousarray(np.asarray(active, dtype=bool).T)
    chosen = np.asarray(pairs, dtype=np.intp)
    return np.array([count_runs(on[i] & on[j]) for i, j in chosen], dtype=np.intp)


def count_runs(on: NDArray[np.bool_]) -> int:
    """Count runs of True of a series of shape (T,)."""
    return int(np.count_nonzero(on[1:] > on[:-1])) + int(on[:1].sum())
