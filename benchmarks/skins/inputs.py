"""Inputs: simulated skins, and copies of a real skin side by side."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.precision import float_type

Matrix = NDArray[np.floating[Any]]
Readings = NDArray[np.float32]
Places = NDArray[np.float64]

_REACH = 2.5
_TOUCHES_PER_SENSOR = 8
_OVERLAP = 0.25
_BLOCK_FRAMES = 256


def directions(n_directions: int, rng: np.random.Generator) -> Places:
    """Draw unit vectors in space, shape (n, 3)."""
    drawn = rng.normal(size=(n_directions, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def sphere_radius(n_sensors: int) -> float:
    """Return the radius of a sphere with one unit of area per sensor."""
    return float(np.sqrt(n_sensors / (4 * np.pi)))


def sphere(n: int, _: np.random.Generator) -> Places:
    """Place sensors on a golden spiral on a unit sphere."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    turn, radius = np.pi * (1 + 5**0.5) * i, np.sqrt(1 - z**2)
    return np.column_stack([np.cos(turn) * radius, np.sin(turn) * radius, z])


@lru_cache(maxsize=1)
def rubbed_skin(n_sensors: int, n_frames: int, active: float = 0.09) -> tuple[Readings, Matrix]:
    """Simulate a flat skin rubbed by one contact; return readings and positions.

    The contact follows a random walk, covers the share `active` of the skin and varies in pressure.
    Sensors that are never touched are left out.
    """
    rng = np.random.default_rng(0)
    side = n_sensors**0.5
    positions = rng.uniform(0, side, (n_sensors, 2))
    touch = np.cumsum(rng.normal(0, side / 30, (n_frames, 2)), axis=0) % side
    reach = side * (active / np.pi) ** 0.5
    readings = np.empty((n_frames, n_sensors), np.float32)
    for frame in range(0, n_frames, _BLOCK_FRAMES):
        part = slice(frame, frame + _BLOCK_FRAMES)
        apart = np.linalg.norm(touch[part, None] - positions, axis=2)
        readings[part] = np.maximum(0, reach - apart)
    readings *= rng.uniform(0.5, 1.5, (n_frames, 1)).astype(np.float32)
    varying = np.ptp(readings, axis=0) > 0
    if not varying.all():
        readings, positions = readings[:, varying], positions[varying]
    readings.setflags(write=False)
    return readings, positions


@lru_cache(maxsize=1)
def flat_skin(n_sensors: int) -> Matrix:
    """Return dissimilarities of a flat skin that is touched uniformly."""
    rng = np.random.default_rng(0)
    width = n_sensors**0.5
    sensors = rng.uniform(0, width, (n_sensors, 2))
    touches = rng.uniform(0, width, (_TOUCHES_PER_SENSOR * n_sensors, 2))
    lengths = _touched(sensors, touches, rng)
    lengths.setflags(write=False)
    return lengths


def _touched(sensors: Matrix, touches: Matrix, rng: np.random.Generator) -> Matrix:
    """Return reciprocals of the correlations of readings under contacts at random places."""
    apart = KDTree(touches).sparse_distance_matrix(
        KDTree(sensors), _REACH, output_type="coo_matrix"
    )
    pressure = rng.uniform(0.5, 1.5, len(touches))
    readings = csr_array((pressure[apart.row] * (_REACH - apart.data), (apart.row, apart.col)))
    mean: Matrix = np.asarray(readings.mean(axis=0))
    correlation = _as_working_type((readings.T @ readings).toarray())
    correlation /= len(touches)
    correlation -= np.outer(mean, mean)
    deviation = np.sqrt(np.diag(correlation))
    correlation /= deviation
    correlation /= deviation[:, None]
    return _as_working_type(regularised_reciprocal(correlation))


def _as_working_type(matrix: Matrix) -> Matrix:
    """Convert a matrix to the precision that anisomap uses for its size."""
    return matrix.astype(float_type(len(matrix)), copy=False)


@lru_cache(maxsize=1)
def tiled_torso(path: Path, n_sensors: int, n_frames: int) -> Readings:
    """Place copies of a real skin side by side, each with the recording shifted in time.

    Copies overlap by a quarter of their width. In the overlap a sensor reads the maximum of both
    copies, which connects them. Sensors are taken from one end.
    """
    readings, places, shift = _tile(path, n_frames)
    here, there = _overlap(places, shift)
    rng = np.random.default_rng(0)
    copies = -(-n_sensors // len(places))
    rolled = [np.roll(readings, rng.integers(len(readings)), axis=0) for _ in range(copies)]
    tiles = [tile.copy() for tile in rolled]
    for number in range(copies - 1):
        left, right = tiles[number], tiles[number + 1]
        right[:, here] = np.maximum(right[:, here], rolled[number][:, there])
        left[:, there] = np.maximum(left[:, there], rolled[number + 1][:, here])
    tiled = np.ascontiguousarray(np.hstack(tiles)[:, :n_sensors], dtype=np.float32)
    tiled.setflags(write=False)
    return tiled


def tiled_places(path: Path, n_sensors: int, n_frames: int) -> Matrix:
    """Return the positions of the sensors of `tiled_torso`, shape (N, 2)."""
    _, places, shift = _tile(path, n_frames)
    copies = -(-n_sensors // len(places))
    return np.concatenate([places + number * shift for number in range(copies)])[:n_sensors]


def _tile(path: Path, n_frames: int) -> tuple[Readings, Matrix, Matrix]:
    """Return readings and positions of a real skin from one end, and the shift of its copies."""
    with np.load(path, allow_pickle=False) as stored:
        readings, places = (
            stored["readings"][:n_frames],
            stored["positions"][:, :2].astype(np.float64),
        )
    order = np.argsort(places[:, 0], kind="stable")
    order = order[np.ptp(readings, axis=0)[order] > 0]
    shift = np.array([(1 - _OVERLAP) * np.ptp(places[order][:, 0]), 0.0])
    return readings[:, order], places[order], shift


def _overlap(places: Matrix, shift: Matrix) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the sensors of a shifted copy that lie on sensors of the skin, and the latter."""
    tree = KDTree(places)
    pitch = np.median(np.asarray(tree.query(places, k=2)[0])[:, 1])
    apart, nearest = map(np.asarray, tree.query(places + shift))
    here = np.flatnonzero(apart <= pitch)
    return here, nearest[here]
