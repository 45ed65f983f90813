"""A map re-fitted with its rigid modules as a constraint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.rigid_bodies import Evidence, Poses, fit_poses
from anisomap.placement.modules import NO_MODULE, Modules
from anisomap.placement.orientation import mirrored
from anisomap.sensor_map import UNPLACED, SensorMap

# Tuned on the iCub hexagon, its halves, and rubbed simulated hexagons, seeds 201 to 203.
_REACH = 4.0  # pitches between sensors whose distance on the map is used
_MIN_NOISE = 1e-3  # pitches; keeps weights finite on exact maps
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

    Poses explain two things: the positions on the map, and the distances on the map between nearby
    sensors of different modules, times the local scale, which the modules themselves give. Maps
    bend over long distances; the more the local scale varies beyond noise, the less positions
    count against distances. Sensors on no module move alone.

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
    variance of the noise is unknown, which makes the likelihoods those of Student's t.
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
    same, mirror = np.maximum(squares, np.finfo(float).eps)
    return float(freedom / 2 * np.log(mirror / same))


@dataclass(frozen=True, eq=False)
class _Alone:
    """Each module fitted to the map by itself.

    Attributes
    ----------
    log_scales : ndarray of shape (B,)
        Units of the template per unit of the map, where each module is.
    uncertainty : ndarray of shape (B,)
        Standard deviation of `log_scales` from the noise of the map.
    noise : float
        Standard deviation of a coordinate on the map, in units of the template.
    rms : float
        Root mean square distance between modules and map, in units of the template.
    """

    log_scales: NDArray[np.float64]
    uncertainty: NDArray[np.float64]
    noise: float
    rms: float

    @property
    def typical(self) -> float:
        """Median logarithm of the scale."""
        return float(np.median(self.log_scales))

    @property
    def distortion(self) -> float:
        """Standard deviation of the logarithm of the scale that noise does not explain."""
        observed = float(np.mean((self.log_scales - self.typical) ** 2))
        return float(np.sqrt(max(0.0, observed - float(np.mean(self.uncertainty**2)))))

    @property
    def shrunk(self) -> NDArray[np.float64]:
        """Logarithms of scales, moved towards their median as far as noise explains them."""
        between = self.distortion**2
        weights = between / np.maximum(between + self.uncertainty**2, np.finfo(float).tiny)
        limit = np.log(_MAX_STRETCH)
        deviations = np.clip(self.log_scales - self.typical, -limit, limit)
        return np.asarray(self.typical + weights * deviations)


def _fit_alone(
    positions: NDArray[np.float64],
    offsets: NDArray[np.float64],
    groups: list[NDArray[np.intp]],
    pitch: float,
) -> _Alone:
    scales, spreads = [], []
    squares, count, freedom = 0.0, 0, 0
    k = positions.shape[1]
    for members in groups:
        # Noise of the map lowers this scale; the scale of the inverse fit, which it does not lower,
        # was 1 to 6 % too large on maps of the tuning, as they shrink short distances.
        fit = fit_similarity(positions[members], offsets[members], reflection=False)
        scales.append(max(fit.scale, float(np.finfo(float).tiny)))
        residual = fit.apply(positions[members]) - offsets[members]
        centred = offsets[members] - offsets[members].mean(axis=0)
        spreads.append(float(np.sum(centred**2)))
        squares, count = squares + float(np.sum(residual**2)), count + len(members)
        freedom += max(0, members.size * k - k - k * (k - 1) // 2 - 1)
    noise = max(float(np.sqrt(squares / max(freedom, 1))), _MIN_NOISE * pitch)
    return _Alone(
        np.log(np.array(scales)),
        noise / np.sqrt(np.maximum(spreads, np.finfo(float).tiny)),
        noise,
        float(np.sqrt(squares / count)),
    )


def _refined(
    positions: NDArray[np.float64],
    offsets: NDArray[np.float64],
    body: NDArray[np.intp],
    placed: NDArray[np.bool_],
    pitch: float,
) -> tuple[NDArray[np.float64], float]:
    """Return positions in units of the template, and the misfit of modules on the map."""
    n_modules, k = int(body.max()) + 1, positions.shape[1]
    groups = [np.flatnonzero(placed & (body == b)) for b in range(n_modules)]
    alone = _fit_alone(positions, offsets, groups, pitch)
    scaled = np.exp(alone.typical) * positions
    free = np.flatnonzero(placed & (body == NO_MODULE))
    bodies = body.copy()
    bodies[free] = n_modules + np.arange(len(free))
    arms = np.where((body == NO_MODULE)[:, None], 0.0, offsets)
    rotation = np.tile(np.eye(k), (n_modules + len(free), 1, 1))
    translation = np.vstack([np.zeros((n_modules, k)), scaled[free]])
    for b, members in enumerate(groups):
        rigid = fit_similarity(offsets[members], scaled[members], scaling=False, reflection=False)
        rotation[b], translation[b] = rigid.rotation, rigid.translation
    nearest = np.array(KDTree(translation[:n_modules]).query(translation)[1], dtype=np.intp)
    stretch = alone.shrunk[nearest]
    here = np.flatnonzero(placed)
    pairs = here[KDTree(scaled[here]).query_pairs(_REACH * pitch, output_type="ndarray")]
    pairs = pairs[bodies[pairs[:, 0]] != bodies[pairs[:, 1]]]
    apart = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    lengths = apart * np.exp(stretch[bodies[pairs]].mean(axis=1))
    # Distortions of the scale add up from module to module like the steps of a random walk.
    pads = max(len(members) for members in groups)
    size = float(np.sqrt(np.sum(np.var(scaled[here], axis=0))))
    step = float(np.sqrt(np.median([np.sum(np.var(scaled[m], axis=0)) for m in groups])))
    # All modules share such a drift, so their positions are as good as those of one module.
    drift = n_modules * alone.distortion**2 * size * step
    poses = fit_poses(
        Poses(rotation, translation),
        arms,
        np.maximum(bodies, 0),
        Evidence(
            pairs=pairs,
            lengths=lengths,
            # Distances from one pad to all pads of a module share its error.
            pair_sigma=alone.noise * float(np.sqrt(2 * pads)),
            targets=np.where(placed[:, None], scaled, np.nan),
            target_sigma=float(np.sqrt(alone.noise**2 + pads * drift)),
        ),
    )
    found = np.full_like(positions, np.nan)
    known = bodies >= 0
    found[known] = poses.points(arms[known], bodies[known])
    return found, alone.rms
