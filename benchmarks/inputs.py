"""What stages are run on: simulated skins, a real one tiled, and matrices that are hard."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.precision import float_type
from anisomap.numerics.similarity.correlation import pearson

Matrix = NDArray[np.floating[Any]]
Readings = NDArray[np.float32]

_REACH = 2.5
_TOUCHES_A_SENSOR = 8
_OVERLAP = 0.25
_FRAMES_AT_A_TIME = 256


@lru_cache(maxsize=1)
def stroked_skin(n_sensors: int, n_frames: int, active: float = 0.09) -> tuple[Readings, Matrix]:
    """Give readings of a flat skin, and its sensors' positions: of those that are ever touched.

    Over it a contact wanders that covers some share of it, pressing now more, now less.
    """
    rng = np.random.default_rng(0)
    side = n_sensors**0.5
    positions = rng.uniform(0, side, (n_sensors, 2))
    touch = np.cumsum(rng.normal(0, side / 30, (n_frames, 2)), axis=0) % side
    reach = side * (active / np.pi) ** 0.5
    readings = np.empty((n_frames, n_sensors), np.float32)
    for frame in range(0, n_frames, _FRAMES_AT_A_TIME):
        part = slice(frame, frame + _FRAMES_AT_A_TIME)
        apart = np.linalg.norm(touch[part, None] - positions, axis=2)
        readings[part] = np.maximum(0, reach - apart)
    readings *= rng.uniform(0.5, 1.5, (n_frames, 1)).astype(np.float32)
    varying = np.ptp(readings, axis=0) > 0
    if not varying.all():
        readings, positions = readings[:, varying], positions[varying]
    readings.setflags(write=False)
    return readings, positions


def noisy_readings(n_sensors: int, n_frames: int) -> Readings:
    """Give independent readings, never the same twice, far from 0: nothing is at rest."""
    rng = np.random.default_rng(0)
    readings = rng.standard_normal((n_frames, n_sensors), np.float32)
    readings += rng.uniform(10, 100, n_sensors).astype(np.float32)
    return readings


def flat_skin(n_sensors: int) -> Matrix:
    """Give dissimilarities of a flat skin that is touched everywhere alike."""
    rng = np.random.default_rng(0)
    width = n_sensors**0.5
    sensors = rng.uniform(0, width, (n_sensors, 2))
    touches = rng.uniform(0, width, (_TOUCHES_A_SENSOR * n_sensors, 2))
    return _touched(sensors, touches, rng)


def round_skin(n_sensors: int) -> Matrix:
    """Give dissimilarities of a skin around a ball: in space it fits nearly, and easily."""
    rng = np.random.default_rng(0)
    radius = (n_sensors / (4 * np.pi)) ** 0.5
    directions = rng.normal(size=((1 + _TOUCHES_A_SENSOR) * n_sensors, 3))
    points = radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return _touched(points[:n_sensors], points[n_sensors:], rng)


def _touched(sensors: Matrix, touches: Matrix, rng: np.random.Generator) -> Matrix:
    """Give reciprocals of the correlations of what sensors read while touched at random places."""
    apart = KDTree(touches).sparse_distance_matrix(
        KDTree(sensors), _REACH, output_type="coo_matrix"
    )
    pressure = rng.uniform(0.5, 1.5, len(touches))
    readings = csr_array((pressure[apart.row] * (_REACH - apart.data), (apart.row, apart.col)))
    mean: Matrix = np.asarray(readings.mean(axis=0))
    correlation = _held((readings.T @ readings).toarray())
    correlation /= len(touches)
    correlation -= np.outer(mean, mean)
    deviation = np.sqrt(np.diag(correlation))
    correlation /= deviation
    correlation /= deviation[:, None]
    return _held(regularised_reciprocal(correlation))


def noisy_metric(n_sensors: int) -> Matrix:
    """Give distances in space, each a little wrong: very many are shortest paths themselves."""
    rng = np.random.default_rng(0)
    distances = pdist(rng.normal(size=(n_sensors, 3)))
    return _held(squareform(distances * rng.uniform(0.95, 1.05, len(distances))))


def pure_noise(n_sensors: int) -> Matrix:
    """Give independent lengths, as from sensors that have nothing in common."""
    rng = np.random.default_rng(0)
    return _held(squareform(rng.uniform(0.01, 1, n_sensors * (n_sensors - 1) // 2)))


def _held(matrix: Matrix) -> Matrix:
    """Give a matrix in the type in which so many sensors are worked on."""
    return matrix.astype(float_type(len(matrix)), copy=False)


def tiled_torso(path: Path, n_sensors: int, n_frames: int) -> Readings:
    """Lay copies of a real skin side by side, each stroked at another time.

    Copies overlap by a quarter of their width. Where they do, a sensor reads what its own finger
    presses or that of the other copy, whichever is more: so the joints hold together as the rest
    of the skin does. Sensors are taken from one end on.
    """
    readings, places, shift = _tile(path, n_frames)
    here, there = _met(places, shift)
    rng = np.random.default_rng(0)
    copies = -(-n_sensors // len(places))
    rolled = [np.roll(readings, rng.integers(len(readings)), axis=0) for _ in range(copies)]
    tiles = [tile.copy() for tile in rolled]
    for number in range(copies - 1):
        left, right = tiles[number], tiles[number + 1]
        right[:, here] = np.maximum(right[:, here], rolled[number][:, there])
        left[:, there] = np.maximum(left[:, there], rolled[number + 1][:, here])
    return np.ascontiguousarray(np.hstack(tiles)[:, :n_sensors], dtype=np.float32)


def tiled_places(path: Path, n_sensors: int, n_frames: int) -> Matrix:
    """Tell where the sensors of `tiled_torso` are, shape (N, 2)."""
    _, places, shift = _tile(path, n_frames)
    copies = -(-n_sensors // len(places))
    return np.concatenate([places + number * shift for number in range(copies)])[:n_sensors]


def _tile(path: Path, n_frames: int) -> tuple[Readings, Matrix, Matrix]:
    """Give a real skin's readings and places, from one end on, and how far its copies are apart."""
    with np.load(path, allow_pickle=False) as stored:
        readings, places = (
            stored["readings"][:n_frames],
            stored["positions"][:, :2].astype(np.float64),
        )
    order = np.argsort(places[:, 0], kind="stable")
    order = order[np.ptp(readings, axis=0)[order] > 0]
    shift = np.array([(1 - _OVERLAP) * np.ptp(places[order][:, 0]), 0.0])
    return readings[:, order], places[order], shift


def _met(places: Matrix, shift: Matrix) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Tell which sensors of a shifted copy lie on sensors of the skin, and on which."""
    tree = KDTree(places)
    pitch = np.median(np.asarray(tree.query(places, k=2)[0])[:, 1])
    apart, nearest = map(np.asarray, tree.query(places + shift))
    here = np.flatnonzero(apart <= pitch)
    return here, nearest[here]


def torso_dissimilarity(path: Path, n_sensors: int, n_frames: int) -> Matrix:
    """Give the dissimilarities of a real skin, tiled."""
    readings = tiled_torso(path, n_sensors, n_frames)
    return _held(regularised_reciprocal(pearson(readings)))
