"""Placing a patch on its link by touching it with another patch of the same robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from anisomap.errors import InputError
from anisomap.numerics.neighbours import nearest_others
from anisomap.numerics.procrustes import (
    SINGULAR,
    fit_similarity,
    fit_similarity_robustly,
    leverage,
    noise_scale,
    similarity_freedom,
)
from anisomap.numerics.surfaces import Points
from anisomap.placement.anchors import COVERAGE, fit_anchors
from anisomap.placement.frames import (
    METRES,
    check_placeable,
    in_frame_of_robot,
    median_spacing,
    pad_to_3d,
)
from anisomap.placement.handedness import Known, Tied
from anisomap.placement.kinematics import KinematicTree
from anisomap.placement.placing import Placement
from anisomap.recording import Recording, match_names
from anisomap.sensor_map import MAX_COORDINATE, SensorMap

MIN_PLACES = 6
"""Fewest places: twice the three that determine a pose, so that a wrong one is outvoted."""

_FAR = 4.0  # noise scales of a wrong place: 1 in 900 of normal errors in space
# Chosen by hand.
_MIN_DEPTH = 0.1  # of the range of readings; light contacts have a noisy centre
_RANGE_QUANTILE = 0.998  # of the depths of a patch; excludes glitches
_MIN_SENSORS = 3  # active on each patch; the centre of fewer is known to a spacing only
_APART = 1.0  # spacings between contacts of one run of frames
_NEIGHBOURS = 6  # contacts that a contact is compared with
# Tuned on the simulations of `benchmarks.placing.self_touch`, seeds 1 to 20.
_SYSTEMATIC = 0.02  # share of the variance of contacts that is alike for all, as by curvature
_INCONSISTENT = 3.0  # medians of the misfits of contacts
# A permutation test at the lowest level that this number of shuffles can show.
_SHUFFLES, _CHANCE = 99, 0.01


@dataclass(frozen=True, eq=False)
class SelfTouch:
    """A recording during which two patches of a robot touch each other.

    Attributes
    ----------
    recording : Recording
        Of T frames, of the sensors of both patches.
    robot : KinematicTree
    angles : mapping of str to ndarray of shape (T,)
        Angles in radians, or displacements in metres, of the joints between the links.
    link : str
        Link of the patch that is placed.
    other_link : str
        Link of the other patch.
    """

    recording: Recording
    robot: KinematicTree
    angles: Mapping[str, NDArray[np.float64]]
    link: str
    other_link: str


@dataclass(frozen=True, eq=False)
class TouchPlacement:
    """A patch in the frame of its link.

    Attributes
    ----------
    map : SensorMap
        In metres, with `SensorMap.errors`.
    frames : ndarray of int, shape (C,)
        Frames of the contacts.
    used : ndarray of bool, shape (C,)
        False for contacts that contradict the others.
    residuals : ndarray of shape (C,)
        Distances between the places of each contact according to the two patches, in metres.
    method : str
        How the map was placed.
    """

    map: SensorMap
    frames: NDArray[np.intp]
    used: NDArray[np.bool_]
    residuals: NDArray[np.float64]
    method: str

    @property
    def placement(self) -> Placement:
        """The same as a placement without anchors, to be drawn."""
        return Placement(self.map, methods=(self.method,))


def place_by_self_touch(
    sensor_map: SensorMap,
    touches: SelfTouch,
    other: SensorMap,
    *,
    exact: bool = False,
    handedness: str = "",
) -> TouchPlacement:
    """Place a patch in the frame of its link from contacts with a patch of known position.

    The centre of each contact on either patch is one point of the robot. Joint angles bring the
    centre on the other patch to the frame of the link, so contacts serve as anchors.

    Parameters
    ----------
    sensor_map : SensorMap
        The patch: a map in arbitrary units, or a layout in a frame of its own.
    touches : SelfTouch
        With the sensors of both patches, by name.
    other : SensorMap
        The other patch in the frame of its link, with a unit.
    exact : bool
        Whether `sensor_map` holds the positions of the sensors, in a unit of length and
        right-handed axes; then only the pose is fitted. Otherwise scale, handedness and smooth
        corrections of the map are fitted as well.
    handedness : {"", "same", "mirrored"}
        Whether a map has the handedness of the skin, if the user knows.

    Returns
    -------
    TouchPlacement

    Raises
    ------
    InputError
        If there are too few contacts, they do not determine the pose or the handedness, or they
        agree no better with the joint angles than with shuffled ones.
    """
    _check(sensor_map, other, exact=exact, handedness=handedness)
    places, targets, frames = _contacts(sensor_map, touches, other)
    _check_agreement(places, targets, scaling=not exact)
    if exact:
        factor = METRES[sensor_map.units]
        pose = fit_pose(factor * places, targets, factor * pad_to_3d(sensor_map.positions))
        positions, used, residuals = pose.positions, pose.used, pose.residuals
        spread = pose.spread + 3 * _SYSTEMATIC * pose.variance
        freedom = similarity_freedom(int(used.sum()), 3, scaling=False)
        errors = np.sqrt(spread * fdtri(3, freedom, COVERAGE))
        how, handed, reflected = "rigid pose", True, False
    else:
        stated = handedness == "mirrored" if handedness else (False if sensor_map.handed else None)
        known = Known.of(sensor_map, stated)
        used = _consistent(places, targets)
        members = np.flatnonzero(sensor_map.placed)
        n_members = len(members)
        points = np.vstack([pad_to_3d(sensor_map.positions[members]), places])
        tied = Tied(points, n_members + np.flatnonzero(used), targets[used])
        fit = fit_anchors(tied, known)
        residuals = np.linalg.norm(fit.positions[n_members:] - targets, axis=1)
        positions, errors = (np.full((sensor_map.n_sensors, *n), np.nan) for n in ((3,), ()))
        positions[members], errors[members] = fit.positions[:n_members], fit.errors[:n_members]
        how, handed, reflected = fit.how, fit.handed, fit.reflected
    method = f"{how}, {int(used.sum())} of {len(used)} contacts"
    placed = in_frame_of_robot(
        sensor_map,
        positions,
        errors,
        handed=handed,
        mirrored=sensor_map.mirrored != reflected,
        placed_by={"contacts": int(used.sum()), "placed_by": method},
        frame=touches.link,
    )
    return TouchPlacement(placed, frames, used, residuals, method)


def _check(sensor_map: SensorMap, other: SensorMap, *, exact: bool, handedness: str) -> None:
    check_placeable(sensor_map, handedness)
    other.check_coordinates("on the other patch")
    for patch, what in ((sensor_map, "the map"), (other, "the layout of the other patch")):
        if patch.dimensions not in (2, 3) or len(patch.component_sizes) != 1:
            raise InputError(
                f"{what} must have 2 or 3 dimensions and one component, got {patch.dimensions} "
                f"dimensions and {len(patch.component_sizes)} components"
            )
    if exact and sensor_map.units not in METRES:
        raise InputError(
            "the exact positions of a patch must have a unit of length, such as x [mm]"
        )
    if other.units not in METRES:
        raise InputError("the layout of the other patch must have a unit of length, such as x [mm]")


def _contacts(
    sensor_map: SensorMap, touches: SelfTouch, other: SensorMap
) -> tuple[Points, Points, NDArray[np.intp]]:
    """Return the centres of contacts on the map and in the frame of its link, and their frames."""
    n_frames = touches.recording.n_frames
    pose = touches.robot.relative_pose(touches.link, touches.other_link, touches.angles)
    if len(pose) == 1 != n_frames:
        raise InputError(
            f"no moving joint is between the links {touches.link!r} and {touches.other_link!r}, so "
            "contacts do not tell their positions"
        )
    if len(pose) != n_frames:
        raise InputError(
            f"joint angles must have a row for each of {n_frames} frames of the recording, got "
            f"{len(pose)}"
        )
    own, depth = _centres(sensor_map, touches.recording, "the map")
    across, _ = _centres(other, touches.recording, "the other patch")
    parts = np.hstack([own, across, pose.reshape(n_frames, -1)])
    both = np.flatnonzero(np.isfinite(parts).all(axis=1))
    frames = _distinct(own, depth, both, _APART * median_spacing(sensor_map))
    if len(frames) < MIN_PLACES:
        raise InputError(
            f"a pose needs at least {MIN_PLACES} contacts between the patches, each of "
            f"{_MIN_SENSORS} sensors or more on both, got {len(frames)}"
        )
    known = METRES[other.units] * across[frames]
    turned = np.einsum("nij,nj->ni", pose[frames, :3, :3], known)
    places, targets = own[frames], turned + pose[frames, :3, 3]
    if max(np.abs(places).max(), np.abs(targets).max()) > MAX_COORDINATE:
        raise InputError(
            f"coordinates of contacts must be at most {MAX_COORDINATE:g}; check the units of the "
            "layouts and of the robot"
        )
    return places, targets, frames


def _centres(
    patch: SensorMap, recording: Recording, what: str
) -> tuple[Points, NDArray[np.float64]]:
    """Return the centre of contact in each frame, NaN without one, and the total depth."""
    columns = match_names(patch.names, recording.names)
    rows = np.flatnonzero(patch.placed & (columns >= 0))
    if len(rows) < _MIN_SENSORS:
        raise InputError(
            f"the recording must have {_MIN_SENSORS} sensors of {what} or more, got {len(rows)}"
        )
    chosen = columns[rows]
    depth = recording.signals.rest.select(chosen).depth(recording.readings[:, chosen])
    deepest = float(np.quantile(depth.max(axis=1), _RANGE_QUANTILE))
    depth[depth <= _MIN_DEPTH * deepest] = 0.0
    total = depth.sum(axis=1)
    depth /= max(deepest, float(np.finfo(float).tiny))
    touched = np.count_nonzero(depth, axis=1) >= _MIN_SENSORS
    # Depths are squared: at the edge of a patch, the part of a contact beyond the edge has no
    # sensors, which draws the centre inwards; squares reduce this.
    squares = np.where(touched[:, None], depth, np.nan) ** 2
    weights = squares / squares.sum(axis=1, keepdims=True)
    return weights @ pad_to_3d(patch.positions[rows]), total


def _distinct(
    centres: Points, depth: NDArray[np.float64], active: NDArray[np.intp], apart: float
) -> NDArray[np.intp]:
    """Choose frames of different contacts: of each run the deepest ones that are apart."""
    found: list[int] = []
    for run in np.split(active, np.flatnonzero(np.diff(active) > 1) + 1):
        kept: list[int] = []
        for frame in run[np.argsort(-depth[run], kind="stable")]:
            gaps = np.linalg.norm(centres[kept] - centres[frame], axis=1)
            if (gaps >= apart).all():
                kept.append(int(frame))
        found += kept
    return np.sort(np.array(found, dtype=np.intp))


class PatchPose(NamedTuple):
    """A patch in the frame of its link.

    positions (N, 3), spread (N,): Of its sensors, and the variances summed over coordinates.
    used (C,): False for places that contradict the others.
    residuals (C,): Distances between the two places of each contact.
    variance: Of a coordinate of the places that were used.
    """

    positions: Points
    spread: NDArray[np.float64]
    used: NDArray[np.bool_]
    residuals: NDArray[np.float64]
    variance: float


def fit_pose(places: Points, targets: Points, points: Points) -> PatchPose:
    """Fit the pose of a rigid patch to where it was touched, (C, 3), without outliers."""
    robust = fit_similarity_robustly(places, targets, scaling=False, reflection=False)
    off = np.linalg.norm(robust.apply(places) - targets, axis=1)
    # Rounding errors of exact places must not exclude any.
    used = off <= _FAR * max(noise_scale(off, 3), SINGULAR * float(np.ptp(targets)))
    x, y = places[used], targets[used]
    widths = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    if len(x) < MIN_PLACES or widths[1] <= SINGULAR * widths[0]:
        raise InputError(
            f"the pose is not determined: the {len(x)} contacts that agree are fewer than "
            f"{MIN_PLACES} or lie on a line of the patch; touch more of it, in other postures"
        )
    fit = fit_similarity(x, y, scaling=False, reflection=False)
    residuals = np.linalg.norm(fit.apply(places) - targets, axis=1)
    variance = float(np.sum(residuals[used] ** 2)) / similarity_freedom(*x.shape, scaling=False)
    positions = fit.apply(points)
    spread = variance * leverage(fit.apply(x), positions, scaling=False)
    return PatchPose(positions, spread, used, residuals, variance)


def _check_agreement(places: Points, targets: Points, *, scaling: bool) -> None:
    """Refuse contacts that agree no better than pairs of the places of different contacts.

    A permutation test of the sum of squared residuals, without targets that would dominate it.
    """
    off = np.linalg.norm(targets - np.median(targets, axis=0), axis=1)
    near = off <= _FAR * noise_scale(off, 3)
    x, y = places[near], targets[near]
    rng = np.random.default_rng(0)

    def misfit(order: NDArray[np.intp]) -> float:
        fit = fit_similarity(x, y[order], scaling=scaling)
        return float(np.sum((fit.apply(x) - y[order]) ** 2))

    own = misfit(np.arange(len(x)))
    chance = sum(misfit(rng.permutation(len(x))) <= own for _ in range(_SHUFFLES))
    if (chance + 1) / (_SHUFFLES + 1) > _CHANCE:
        raise InputError(
            f"the {len(places)} contacts agree with the joint angles no better than chance allows; "
            "record more of them, or check the links, the units of the angles (radians) and that "
            "their rows match the frames"
        )


def _consistent(places: Points, targets: Points) -> NDArray[np.bool_]:
    """Return which contacts are as far from their neighbours in space as on the map.

    No similarity takes a map to a bent skin, but among neighbours one nearly does.
    """
    _, near = nearest_others(places, _NEIGHBOURS)
    on_map, apart = (
        np.linalg.norm(points[near] - points[:, None], axis=2) for points in (places, targets)
    )
    scale = np.median(apart) / np.median(on_map)
    misfit = np.median(np.abs(apart - scale * on_map), axis=1)
    used = misfit <= _INCONSISTENT * np.median(misfit)
    if used.sum() < MIN_PLACES:
        raise InputError(
            f"a pose needs at least {MIN_PLACES} contacts that agree with their neighbours on the "
            f"map, got {int(used.sum())} of {len(used)}"
        )
    return np.asarray(used)
