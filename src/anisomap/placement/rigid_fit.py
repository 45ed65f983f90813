"""A map re-fitted with its rigid modules as a constraint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.rigid_bodies import Poses, fit_poses
from anisomap.placement.modules import NO_MODULE, Modules
from anisomap.placement.orientation import mirrored
from anisomap.sensor_map import UNPLACED, SensorMap

# Tuned on the iCub hexagon and on maps of simulated planes of triangles, seeds 1 to 20.
_REACH = 4.0  # pitches between sensors whose distance on the map is used
_MIN_LENGTH = 0.5  # pitches; sensors that coincide on the map must not dominate relative errors
_MAX_STRETCH = 2.0  # of a module on the map, relative to the median of all

_MIN_PADS = 3  # placed pads that determine the pose of a module


@dataclass(frozen=True, eq=False)
class ModuleFit:
    """A map of rigid modules.

    Attributes
    ----------
    map : SensorMap
        In the unit of the template, known up to rotation and translation. Sensors that the map did
        not place are placed with their module.
    rms : float
        Root mean square distance between the map and the modules, after the best scale of each
        module; a measure of the noise of the map, in the unit of the template.
    evidence : float
        Log likelihood ratio of the handedness of the map against its mirror image; negative if the
        map was reflected, 0 if modules do not tell.
    left_out : tuple of str
        Labels of modules with fewer than 3 placed pads, of which sensors are placed one by one.
    """

    map: SensorMap
    rms: float
    evidence: float
    left_out: tuple[str, ...]


def fit_modules(sensor_map: SensorMap, modules: Modules) -> ModuleFit:
    """Fit the poses of rigid modules to a map of one component.

    Every module first takes the pose that fits its sensors on the map best. Then poses are moved
    until the distances between sensors on different modules, up to `_REACH` pitches, are those on
    the map times the local scale, which the modules themselves give. Distances farther apart are
    not used: maps bend over long distances. Sensors on no module move alone.

    Parameters
    ----------
    sensor_map : SensorMap
        In two or three dimensions, of one connected component.
    modules : Modules
        Of the same sensors, with a template.

    Returns
    -------
    ModuleFit

    Raises
    ------
    InputError
        If there is no template, it has more dimensions than the map, or fewer than 3 pads of every
        module are placed.
    """
    template = modules.template
    if not len(template):
        raise InputError("the positions of the pads on a module are needed to fit modules to a map")
    k = sensor_map.dimensions
    if k not in (2, 3) or len(sensor_map.component_sizes) != 1:
        raise InputError("modules are fitted to one component of a map of 2 or 3 dimensions")
    if template.shape[1] > k and np.ptp(template[:, 2][np.isfinite(template[:, 2])]) > 0:
        raise InputError("modules that are not flat need a map of three dimensions")
    offsets = np.pad(modules.offsets[:, :k], ((0, 0), (0, max(0, k - template.shape[1]))))
    placed = sensor_map.placed
    fitted = [
        m
        for m in range(modules.n_modules)
        if np.count_nonzero(placed & (modules.index == m)) >= _MIN_PADS
    ]
    if not fitted:
        raise InputError(f"no module has {_MIN_PADS} sensors with a position on the map")
    number = np.full(modules.n_modules + 1, NO_MODULE)  # the last is for sensors on no module
    number[fitted] = np.arange(len(fitted))
    body = number[modules.index]
    evidence = _handedness(sensor_map.positions, offsets, body, placed)
    chosen = mirrored(sensor_map) if evidence < 0 else sensor_map
    pitch = _pitch(template)
    positions, rms = _refined(chosen.positions, offsets, body, placed, pitch)
    known = np.isfinite(positions).all(axis=1)
    left_out = {int(m) for m in np.unique(modules.index[placed])} - {NO_MODULE, *fitted}
    return ModuleFit(
        map=replace(
            chosen,
            positions=positions,
            component=np.where(known, 0, UNPLACED),
            units=modules.units,
        ),
        rms=rms,
        evidence=evidence,
        left_out=tuple(modules.labels[m] for m in sorted(left_out)),
    )


def _pitch(template: NDArray[np.float64]) -> float:
    pads = template[np.isfinite(template).all(axis=1)]
    return float(np.median(np.asarray(KDTree(pads).query(pads, k=2)[0])[:, 1]))


def _handedness(
    positions: NDArray[np.float64],
    offsets: NDArray[np.float64],
    body: NDArray[np.intp],
    placed: NDArray[np.bool_],
) -> float:
    """Compare the errors of modules on the map and on its mirror image, as a log likelihood ratio.

    Modules are scaled to the map one by one, so its distortion does not count as an error. The
    noise is estimated from the better hand.
    """
    squares = np.zeros(2)
    freedom = 0
    for b in range(int(body.max()) + 1):
        members = np.flatnonzero(placed & (body == b))
        source, target = offsets[members], positions[members]
        size = float(np.mean((target - target.mean(axis=0)) ** 2))
        if not size > 0:
            continue
        for i, reflection in enumerate((False, True)):
            fit = fit_similarity(source, target, reflection=reflection)
            squares[i] += float(np.sum((fit.apply(source) - target) ** 2)) / size
        k = target.shape[1]
        freedom += max(0, target.size - k - k * (k - 1) // 2 - 1)
    if not freedom or not squares.any():
        return 0.0
    variance = max(squares.min() / freedom, np.finfo(float).eps)
    return float((squares[1] - squares[0]) / (2 * variance))


def _refined(
    positions: NDArray[np.float64],
    offsets: NDArray[np.float64],
    body: NDArray[np.intp],
    placed: NDArray[np.bool_],
    pitch: float,
) -> tuple[NDArray[np.float64], float]:
    """Return positions in units of the template, and the misfit of modules on the map."""
    n_modules = int(body.max()) + 1
    fits = []
    for b in range(n_modules):
        members = np.flatnonzero(placed & (body == b))
        fits.append(fit_similarity(positions[members], offsets[members], reflection=False))
    scales = np.array([fit.scale for fit in fits])
    typical = float(np.median(scales[scales > 0])) if (scales > 0).any() else 1.0
    scales = np.clip(scales, typical / _MAX_STRETCH, typical * _MAX_STRETCH)
    scaled = typical * positions
    free = np.flatnonzero(placed & (body == NO_MODULE))
    bodies = body.copy()
    bodies[free] = n_modules + np.arange(len(free))
    arms = np.where((body == NO_MODULE)[:, None], 0.0, offsets)
    k = positions.shape[1]
    start = Poses(np.tile(np.eye(k), (n_modules + len(free), 1, 1)), np.vstack(
        [np.zeros((n_modules, k)), scaled[free]]
    ))  # fmt: skip
    squares, count = 0.0, 0
    for b in range(n_modules):
        members = np.flatnonzero(placed & (body == b))
        rigid = fit_similarity(offsets[members], scaled[members], scaling=False, reflection=False)
        start.rotation[b], start.translation[b] = rigid.rotation, rigid.translation
        residual = fits[b].apply(positions[members]) - offsets[members]
        squares, count = squares + float(np.sum(residual**2)), count + len(members)
    centres = start.translation[:n_modules]
    near = (
        np.asarray(KDTree(centres).query(scaled[free], k=1)[1]) if len(free) else np.empty(0, int)
    )
    scale_of = np.concatenate([scales, scales[near]])
    here = np.flatnonzero(placed)
    pairs = KDTree(scaled[here]).query_pairs(_REACH * pitch, output_type="ndarray")
    pairs = here[pairs]
    pairs = pairs[bodies[pairs[:, 0]] != bodies[pairs[:, 1]]]
    apart = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    factor = np.sqrt(scale_of[bodies[pairs[:, 0]]] * scale_of[bodies[pairs[:, 1]]])
    lengths = np.maximum(apart * factor, _MIN_LENGTH * pitch)
    known = bodies >= 0
    poses = fit_poses(start, arms, np.maximum(bodies, 0), pairs, lengths)
    found = np.full_like(positions, np.nan)
    found[known] = poses.points(arms[known], bodies[known])
    return found, float(np.sqrt(squares / count))
