"""The quick map of a live session: r-ANISOMAP of a sample of all frames, warm-started."""

from __future__ import annotations

import time
import warnings
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.view import MAX_JOINED, neighbour_pairs
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import SensorHealth
from anisomap.health.touch_coverage import (
    ENOUGH_CONTACTS,
    Place,
    needed_evidence,
    neighbouring_sensors,
    next_places,
)
from anisomap.method.named import MethodOptions
from anisomap.method.pipeline import reconstruct_from
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.sampling import sample_of
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.numerics.signals import count_contacts, count_joint_contacts
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import Rest
from anisomap.recording import Recording
from anisomap.sensor_map import is_faulty

MAX_PLACES = 3
"""Number of marked places: as many as a person can follow while touching."""

_MOST_DEAD = 0.1  # share of the sensors; with more, a part of the skin was never touched


@dataclass(frozen=True)
class Advice:
    """Advice to the person who touches the skin: places that lack contacts, most urgent first.

    untouched, dead: Sensors without a contact, and those of them with enough contacts around.
    """

    places: tuple[Place, ...] = ()
    untouched: tuple[int, ...] = ()
    dead: tuple[int, ...] = ()

    @property
    def next_sensors(self) -> tuple[int, ...]:
        """Sensors to touch next, for a simulated hand; none if more contacts gain little."""
        return self.untouched or (self.places[0].sensors if self.places else ())


def confirmed_faults(
    health: Iterable[SensorHealth], dead: Collection[str] = ()
) -> tuple[SensorHealth, ...]:
    """Return dead or faulty sensors, except sensors that were hardly touched so far."""
    return tuple(
        one
        for one in health
        if one.name in dead
        or (is_faulty(one.status) and (one.status == "stuck" or one.contacts >= ENOUGH_CONTACTS))
    )


def advise(
    positions: NDArray[np.float64], touched: NDArray[np.bool_], drop: Collection[int] = ()
) -> Advice:
    """Advise on places to touch next. positions (N, k); touched (T, N)."""
    contacts = count_contacts(touched)
    wanted = np.ones(touched.shape[1], dtype=bool)
    wanted[list(drop)] = False
    placed = np.isfinite(positions).all(axis=1)
    untouched = tuple(np.flatnonzero(wanted & (contacts == 0)).tolist())
    if not placed.any():
        return Advice(untouched=untouched)
    pairs = neighbouring_sensors(positions)
    need = needed_evidence(contacts, pairs, count_joint_contacts(touched, pairs))
    places = next_places(positions, np.where(wanted & placed, need, 0), n_places=MAX_PLACES)
    # Untouched sensors have no place; they are dead if they are few, and all others had enough.
    few = len(untouched) <= max(1, _MOST_DEAD * wanted.sum())
    dead, untouched = ((), untouched) if places or not few else (untouched, ())
    return Advice(places, untouched, dead)


QUICK_METHOD = "r-anisomap"
"""The method of the quick map; it requires only Pearson's r."""

_QUICK = MethodOptions(smacof=SmacofOptions(solver="lbfgs"))

MAX_SENSORS = 4000
"""Maximum number of sensors for maps before the end of the session: with more, r-ANISOMAP takes
more than ten seconds."""


@dataclass(frozen=True, eq=False)
class QuickMap:
    """A map of the frames so far, and related quantities.

    positions (N, k): Centred, with an RMS radius of 1, aligned with the preceding map; NaN for
        sensors without a position.
    seconds: Computing time of the map.
    contacts, highest_depth (N,): Separate contacts, and largest excess over rest. Like the map,
        these are computed from a sample of frames, evenly spread over the session.
    pairs: Neighbours, joined by lines on the page.
    left_out: Dropped sensors, and channels that are not sensors.
    reason: Why there is no map; empty if there is a map.
    """

    positions: NDArray[np.float64]
    n_frames: int
    seconds: float
    contacts: NDArray[np.intp]
    pairs: NDArray[np.intp]
    advice: Advice
    rest: Rest
    highest_depth: NDArray[np.float64]
    names: tuple[str, ...]
    left_out: tuple[int, ...]
    reason: str = ""


@dataclass
class QuickMapper:
    """Makes successive maps; each starts from the preceding one.

    dimensions: Number of coordinates; may change between maps.
    drop: Sensors to leave out.
    sample: An even sample of the frames so far.
    """

    names: Sequence[str]
    dimensions: int
    drop: set[int] = field(default_factory=set)
    _before: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        self.sample = sample_of(len(self.names))

    def add(self, readings: NDArray[np.float64]) -> None:
        """Add frames. readings (t, N)."""
        if len(readings):
            self.sample.add(readings.astype(np.float32))

    def make(self) -> QuickMap:
        """Make a map of all frames so far; requires at least one frame."""
        begun, reason = time.monotonic(), ""
        readings = self.sample.readings
        readings[:, ~np.isfinite(readings).any(axis=0)] = 0  # sensors without any reading
        recording = Recording(readings).complete("interpolate")
        positions = np.full((recording.n_sensors, self.dimensions), np.nan)
        if recording.n_sensors > MAX_SENSORS:
            reason = f"a map of more than {MAX_SENSORS} sensors is made at the end of the session"
        else:
            try:
                positions = self._positions(recording)
            except InputError as error:
                reason = str(error)
        signals = recording.signals
        rest = signals.rest
        side_of_contact = np.where(rest.side > 0, *recording.extremes[::-1])
        return QuickMap(
            positions=positions,
            n_frames=self.sample.n_frames,
            seconds=time.monotonic() - begun,
            contacts=signals.contacts,
            pairs=neighbour_lines(positions),
            advice=advise(positions, signals.touched, self.drop),
            rest=rest,
            highest_depth=rest.depth(side_of_contact[None])[0],
            names=tuple(self.names),
            left_out=tuple(sorted(self.drop)),
            reason=reason,
        )

    def _positions(self, recording: Recording) -> NDArray[np.float64]:
        correlation, before = pearson(recording.readings), self._before
        if before is not None and before.shape[1] != self.dimensions:
            before = None  # the number of dimensions has changed
        with warnings.catch_warnings(action="ignore", category=AnisomapWarning):
            made = reconstruct_from(
                similarity=correlation,
                method=QUICK_METHOD,
                dimensions=self.dimensions,
                names=self.names,
                drop=sorted(self.drop | set(np.flatnonzero(~recording.varying()).tolist())),
                options=_QUICK,
                start=None if before is None else warm_start(before, correlation),
                statistic="pearson",
            )
        self._before = turned_onto(made.positions, before)
        return self._before


def neighbour_lines(positions: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return pairs of neighbours to join by lines; none above `MAX_JOINED` sensors."""
    placed = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if not 2 < placed.size <= MAX_JOINED:
        return np.empty((0, 2), dtype=np.intp)
    return np.asarray(placed[neighbour_pairs(positions[placed])])


def warm_start(
    before: NDArray[np.float64], similarity: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return known positions, and estimates of the others. before (N, k), similarity (N, N)."""
    start = before.copy()
    placed = np.isfinite(before).all(axis=1)
    fresh = np.flatnonzero(~placed)
    if fresh.size:
        best = np.flatnonzero(placed)[np.argmax(similarity[np.ix_(fresh, placed)], axis=1)]
        # Coincident points would stay coincident; the offsets are below a spacing.
        offsets = np.random.default_rng(0).normal(0, 1e-2, (fresh.size, before.shape[1]))
        start[fresh] = before[best] + offsets
    return start


def turned_onto(
    positions: NDArray[np.float64], before: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Align positions (N, k) with preceding ones, (N, k), including handedness."""
    placed = np.isfinite(positions).all(axis=1)
    centred = positions - positions[placed].mean(axis=0)
    radius = np.sqrt(np.mean(np.sum(centred[placed] ** 2, axis=1)))
    centred /= radius if radius > 0 else 1.0
    if before is None:
        axes = np.linalg.svd(centred[placed], full_matrices=False)[2]
        return np.asarray(centred @ axes.T)
    shared = placed & np.isfinite(before).all(axis=1)
    if np.count_nonzero(shared) <= positions.shape[1]:
        return np.asarray(centred)
    fit = fit_similarity(centred[shared], before[shared], scaling=False)
    return np.asarray(centred @ fit.rotation.T)


def read_levels(
    readings: NDArray[np.float64], first: NDArray[np.float64], quick: QuickMap | None
) -> NDArray[np.float64]:
    """Return the deepest reading (N,) of each sensor, from 0 (rest) to 1 (its deepest so far).

    Without a quick map, depths are relative to the first frame and the deepest of all readings.
    """
    if quick is not None and len(quick.names) == len(first):
        depth, full = quick.rest.depth(readings), quick.highest_depth
    else:
        depth = np.abs(readings - first)
        full = np.nanmax(np.append(depth, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.fmax.reduce(depth, axis=0) / np.where(full > 0, full, 1.0)
    return np.asarray(np.clip(np.nan_to_num(share), 0, 1))
