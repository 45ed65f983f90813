"""Stages of ANISOMAP for arrays of any array API library, such as CuPy on a GPU.

Results are arrays of the same library, on the device of the input. Only positions (N, k) and
vectors (N,) travel between the device and scipy.

The standard: https://data-apis.org/array-api. It has no matrix product of minima and sums, so
shortest paths have a kernel of their own for CuPy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError, import_extra
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO
from anisomap.numerics.precision import Floats, float_type, slices_of
from anisomap.numerics.scaling.multidimensional_scaling import (
    COINCIDENT,
    LARGE_TOLERANCE,
    MIN_LARGE,
    Scaling,
    SmacofOptions,
    classical_scaling,
    minimise_lbfgs,
    smacof,
)
from anisomap.numerics.similarity.binning import maximum_entropy_codes

Array: TypeAlias = Any
"""Array of a library that the array API compatibility layer knows."""

MIN_DEVICE_POINTS = 500
"""Minimum number of points that are scaled on the device; fewer are scaled by `smacof`."""

MIDDLES = 32
"""Intermediate nodes of paths in one step: rows that the kernel keeps in shared memory."""

TILE = 64
"""Rows and columns of path lengths that a block of 16 x 16 threads of the kernel updates."""

_BLOCK_ELEMENTS = 1 << 24  # of temporary arrays; 64 MiB in float32
_SENSORS_AT_ONCE = 512  # that are centred in float64

_KERNEL = """
extern "C" __global__ void lower(real* lengths, const real* ways, int n, int n_ways) {
    __shared__ real to[MIDDLES][TILE], from[MIDDLES][TILE];
    const int x = threadIdx.x, y = threadIdx.y;
    const int row = blockIdx.y * TILE, column = blockIdx.x * TILE;
    for (int at = y * 16 + x; at < MIDDLES * TILE; at += 256) {
        const int k = at / TILE, j = at % TILE;
        const real* way = ways + (size_t)k * n;
        to[k][j] = k < n_ways && row + j < n ? way[row + j] : FAR;
        from[k][j] = k < n_ways && column + j < n ? way[column + j] : FAR;
    }
    __syncthreads();
    real least[4][4];
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 4; b++) least[a][b] = FAR;
    for (int k = 0; k < MIDDLES; k++)
        for (int a = 0; a < 4; a++)
            for (int b = 0; b < 4; b++)
                least[a][b] = min(least[a][b], to[k][y + 16 * a] + from[k][x + 16 * b]);
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 4; b++) {
            const int i = row + y + 16 * a, j = column + x + 16 * b;
            if (i < n && j < n) {
                const size_t at = (size_t)i * n + j;
                lengths[at] = min(lengths[at], least[a][b]);
            }
        }
}
"""


def array_namespace(array: Array) -> Any:
    """Return the functions of the standard for the library of an array."""
    return _compatibility().array_namespace(array)


def to_numpy(array: Array) -> NDArray[Any]:
    """Copy an array to the main memory."""
    known = _compatibility()
    on_device = known.is_cupy_array(array) or known.is_torch_array(array)
    return np.asarray(known.to_device(array, "cpu") if on_device else array)


def as_numbers(readings: Array) -> Array:
    """Return readings that are true or false as 1 or 0, which the standard puts in order."""
    xp = array_namespace(readings)
    return xp.astype(readings, xp.uint8) if xp.isdtype(readings.dtype, "bool") else readings


def select_columns(readings: Array, chosen: NDArray[np.bool_]) -> Array:
    """Return the readings (T, n) of the sensors of a mask (N,)."""
    numbers = _moved(np.flatnonzero(chosen), readings)
    return array_namespace(readings).take(readings, numbers, axis=1)


def pearson(readings: Array) -> Array:
    """Compute Pearson's r of every pair of sensors, as `correlation.pearson`.

    readings (T, N) -> (N, N).
    """
    xp = array_namespace(readings)
    parts = (readings[:, columns] for columns in slices_of(readings.shape[1], _SENSORS_AT_ONCE))
    return _correlation(xp, [_standardised(xp, part, readings.shape[1]) for part in parts])


def spearman(readings: Array) -> Array:
    """Compute Spearman's rho of every pair of sensors; ties share their mean rank.

    readings (T, N) -> (N, N).
    """
    xp = array_namespace(readings)
    n_sensors = readings.shape[1]
    parts = []
    for columns in slices_of(n_sensors, _SENSORS_AT_ONCE):
        numbers = range(columns.start, columns.stop)
        series = xp.stack([readings[:, i] for i in numbers], axis=0)
        ordered = xp.sort(series, axis=1)
        ranks = [
            xp.searchsorted(ordered[i, :], series[i, :], side="left")
            + xp.searchsorted(ordered[i, :], series[i, :], side="right")
            for i in range(series.shape[0])
        ]
        parts.append(_standardised(xp, xp.stack(ranks, axis=1), n_sensors))
    return _correlation(xp, parts)


def _standardised(xp: Any, values: Array, n_sensors: int) -> Array:
    """Centre series (T, m), and divide them by their norms; 0 if constant."""
    deviations = xp.astype(values, xp.float64)
    deviations = deviations - deviations[:1, :]  # exactly 0 for constant sensors
    greatest = xp.max(xp.abs(deviations), axis=0, keepdims=True)
    deviations = deviations / xp.where(greatest > 0, greatest, 1.0)  # squares must not overflow
    deviations = deviations - xp.mean(deviations, axis=0, keepdims=True)
    norm = xp.sqrt(xp.sum(deviations * deviations, axis=0, keepdims=True))
    return xp.astype(deviations / xp.where(norm > 0, norm, 1.0), _dtype(xp, n_sensors))


def _correlation(xp: Any, parts: list[Array]) -> Array:
    """Multiply standardised series, given in parts (T, m) -> (N, N)."""
    series = xp.concat(parts, axis=1)
    correlation = xp.matmul(xp.matrix_transpose(series), series)
    for rows, block, diagonal in _row_blocks(xp, correlation):
        correlation[rows, :] = xp.where(diagonal, 1.0, xp.clip(block, -1.0, 1.0))
    return correlation


def mutual_information(readings: Array, bins: int) -> Array:
    """Compute the mutual information of every pair of sensors, as `information.mutual_information`.

    readings (T, N) -> (N, N). The bins of each sensor are found by numpy.
    """
    xp = array_namespace(readings)
    values = maximum_entropy_codes(to_numpy(readings), bins)
    codes = _moved(values.astype(np.int16), readings)  # at most 1,024 bins
    n_frames, n_sensors = values.shape
    dtype = _dtype(xp, n_sensors)
    on = [xp.astype(codes == code, dtype) for code in range(int(values.max()) + 1)]
    joint = xp.zeros((n_sensors, n_sensors), dtype=dtype, device=_compatibility().device(codes))
    for rows in slices_of(n_sensors, max(1, _BLOCK_ELEMENTS // n_sensors)):
        for first in on:
            left = xp.matrix_transpose(first[:, rows])
            for second in on:
                counts = xp.matmul(left, second)  # exact up to 2^24 frames in float32
                joint[rows, :] += counts * xp.log(xp.where(counts > 0, counts, 1.0))
    return _information(xp, joint, n_frames)


def _information(xp: Any, joint: Array, n_frames: int) -> Array:
    """Convert sums of n log n over joint counts, (N, N), as `information_from_logarithms`."""
    n_sensors = joint.shape[0]
    marginal = xp.concat(
        [
            xp.sum(xp.where(diagonal, block, 0.0), axis=1)
            for _, block, diagonal in _row_blocks(xp, joint)
        ]
    )
    entropy = xp.maximum(float(np.log(n_frames)) - marginal / n_frames, 0.0)
    for rows, block, diagonal in _row_blocks(xp, joint):
        own = xp.reshape(entropy[rows], (-1, 1))
        other = xp.reshape(entropy, (1, n_sensors))
        # I = H(A) + H(B) - H(A, B), with H(A, B) = log T - sum n_ab log n_ab / T.
        shared = own + other - (float(np.log(n_frames)) - block / n_frames)
        shared = xp.maximum(xp.minimum(shared, xp.minimum(own, other)), 0.0)
        joint[rows, :] = xp.where(diagonal, own, shared)
    return joint


def regularised_reciprocal(similarity: Array, mu: float) -> Array:
    """Convert a similarity (N, N) in place, as `dissimilarity.regularised_reciprocal`."""
    xp = array_namespace(similarity)
    smallest = np.inf
    for rows, block, diagonal in _row_blocks(xp, similarity):
        counted = xp.where(diagonal | (block < NUMERICAL_ZERO), 0.0, block)
        smallest = min(smallest, float(xp.min(xp.where(counted > 0, counted, xp.inf))))
        similarity[rows, :] = counted
    added = mu * smallest if np.isfinite(smallest) else 0.0
    for rows, block, diagonal in _row_blocks(xp, similarity):
        whole = block + added
        reciprocal = 1 / xp.where(whole > 0, whole, 1.0)
        reciprocal = xp.where(whole > 0, reciprocal, xp.inf)
        similarity[rows, :] = xp.where(diagonal, 0.0, reciprocal)
    return similarity


def metricise(dissimilarity: Array) -> Array:
    """Replace dissimilarities (N, N) by lengths of shortest paths, as `metric.metricise`.

    Blocked Floyd-Warshall algorithm: for each block of `MIDDLES` nodes, paths from these nodes to
    all others, through the block, are found first; then all paths through the block are shortened.
    """
    xp = array_namespace(dissimilarity)
    # Products of matrices may round (i, j) and (j, i) differently.
    lengths = xp.minimum(dissimilarity, xp.matrix_transpose(dissimilarity))
    for middles in slices_of(lengths.shape[0], MIDDLES):
        ways = lengths[middles, :]
        among = ways[:, middles]
        n_steps = 1
        while n_steps < MIDDLES:
            among = xp.min(among[:, :, None] + among[None, :, :], axis=1)
            n_steps *= 2
        closed = xp.min(among[:, :, None] + ways[None, :, :], axis=1)
        lengths = _lower(xp, lengths, closed)
    return lengths


def _lower(xp: Any, lengths: Array, ways: Array) -> Array:
    """Shorten paths, (N, N), that pass through m nodes; ways (m, N): lengths from these nodes."""
    n_ways, n_nodes = ways.shape
    if not _compatibility().is_cupy_array(lengths):
        for k in range(n_ways):
            lengths = xp.minimum(lengths, ways[k, :, None] + ways[k, None, :])
        return lengths
    n_tiles = -(-n_nodes // TILE)
    kernel = _kernel(lengths.dtype.name)
    sizes = np.int32(n_nodes), np.int32(n_ways)
    kernel((n_tiles, n_tiles), (16, 16), (lengths, xp.ascontiguousarray(ways), *sizes))
    return lengths


@cache
def _kernel(dtype: str) -> Any:
    """Compile the kernel of `_lower` for float32 or float64."""
    real = {"float32": "float", "float64": "double"}[dtype]
    sizes = f"#define real {real}\n#define MIDDLES {MIDDLES}\n#define TILE {TILE}\n"
    sizes += "#define FAR __int_as_float(0x7f800000)\n"  # infinity
    return import_extra("cupy", "a GPU", "gpu").RawKernel(sizes + _KERNEL, "lower")


def scale(metric: Array, dimensions: int, options: SmacofOptions) -> Scaling:
    """Scale a metric (N, N) by L-BFGS, as `smacof`; the stress is computed on the device."""
    xp = array_namespace(metric)
    n_points = metric.shape[0]
    greatest = float(xp.max(metric))
    if not np.isfinite(greatest):
        raise InputError(
            "some sensors are unrelated; with a regularisation above 0, they are placed far apart"
        )
    if n_points < MIN_DEVICE_POINTS:
        return smacof(to_numpy(metric), dimensions=dimensions, options=options)
    start, total = _classical_scaling(xp, metric * metric, dimensions)
    least = LARGE_TOLERANCE if n_points >= MIN_LARGE else 0.0
    positions, trace, converged = minimise_lbfgs(
        _raw_stress(xp, metric),
        start - start.mean(axis=0),
        np.full((n_points, 1), 2.0 * n_points),
        squares=total / 2,
        tolerance=max(options.tolerance, least),
        max_iterations=options.max_iterations,
    )
    positions = positions - positions.mean(axis=0)
    spread = n_points * float(np.vdot(positions, positions))  # Huygens' theorem
    history = np.array(trace)
    positions.setflags(write=False)
    history.setflags(write=False)
    return Scaling(positions, trace[-1], spread, history, bool(converged))


def _classical_scaling(xp: Any, squares: Array, dimensions: int) -> tuple[Floats, float]:
    """Scale squared distances (N, N) by their leading eigenvectors -> (N, k), and sum them."""

    def multiply(vector: Floats) -> NDArray[np.floating[Any]]:
        return to_numpy(xp.matmul(squares, _like(vector, squares)))

    total = float(multiply(np.ones(squares.shape[0])).sum(dtype=np.float64))
    return classical_scaling(multiply, squares.shape[0], dimensions), total


def _raw_stress(xp: Any, targets: Array) -> Callable[[Floats], tuple[float, Floats]]:
    """Return the raw stress of positions (N, k) and its gradient, as `objective` of smacof."""

    def raw_stress(positions: Floats) -> tuple[float, Floats]:
        n_axes = positions.shape[1]
        points = _like(positions, targets)
        raw, slopes = 0.0, []
        for rows, wanted, _ in _row_blocks(xp, targets, diagonals=False):
            squares = xp.zeros_like(wanted)
            for axis in range(n_axes):
                step = xp.reshape(points[rows, axis], (-1, 1)) - points[None, :, axis]
                squares += step * step
            distances = xp.sqrt(squares)
            excess = distances - wanted
            raw += float(xp.sum(excess * excess, dtype=xp.float64))
            apart = distances > COINCIDENT
            factors = xp.where(apart, excess / xp.where(apart, distances, 1.0), 0.0)
            pulls = points[rows, :] * xp.sum(factors, axis=1, keepdims=True)
            slopes.append(pulls - xp.matmul(factors, points))
        gradient = 2 * to_numpy(xp.concat(slopes, axis=0)).astype(np.float64)
        return raw / 2, gradient

    return raw_stress


def _row_blocks(
    xp: Any, matrix: Array, *, diagonals: bool = True
) -> Iterator[tuple[slice, Array, Array | None]]:
    """Yield blocks of rows of a square matrix: rows, values, and which are on the diagonal."""
    n_rows = matrix.shape[0]
    device = _compatibility().device(matrix)
    for rows in slices_of(n_rows, max(1, _BLOCK_ELEMENTS // n_rows)):
        length = rows.stop - rows.start
        yield (
            rows,
            matrix[rows, :],
            xp.eye(length, n_rows, k=rows.start, dtype=xp.bool, device=device)
            if diagonals
            else None,
        )


def _moved(values: NDArray[Any], array: Array) -> Array:
    """Copy values to the library and the device of an array."""
    known = _compatibility()
    return known.to_device(array_namespace(array).asarray(values), known.device(array))


def _like(values: Floats, array: Array) -> Array:
    """Copy values to the library, the device and the type of an array."""
    return _moved(values.astype(str(array.dtype).rpartition(".")[2]), array)


def _dtype(xp: Any, n_sensors: int) -> Any:
    return xp.float32 if float_type(n_sensors) is np.float32 else xp.float64


def _compatibility() -> Any:
    """Import the compatibility layer for the array API standard."""
    return import_extra("array_api_compat", "arrays on a GPU", "gpu")
