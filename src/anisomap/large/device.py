"""Exact maps of many sensors on a GPU, for arrays of any library of the array API standard.

Results of the stages are arrays of the same library and on the same device as the readings. The
standard (https://data-apis.org/array-api) has no (min, +) matrix product, so shortest paths have a
separate kernel for CuPy.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError, import_extra
from anisomap.method.configuration import Configuration, as_map, caveats, parameters_of
from anisomap.method.dimensions import AUTO, check_size
from anisomap.method.evidence import check_unlike
from anisomap.method.named import MethodOptions, find_method
from anisomap.names import check_names, default_names
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO
from anisomap.numerics.precision import Floats, float_type, slices_of
from anisomap.numerics.scaling import multidimensional_scaling as mds
from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.information import information_from_logarithms
from anisomap.sensor_map import SensorMap

logger = logging.getLogger(__name__)

Array: TypeAlias = Any  # of a library that the compatibility layer of the standard supports

MIN_DEVICE_POINTS = 500  # points scaled on the device; fewer points are scaled by `smacof`
MIDDLES = 32  # intermediate nodes of paths per step: rows in the shared memory of the kernel
_TILE = 64  # rows and columns of lengths that a block of 16 x 16 threads of the kernel updates
_BLOCK_ELEMENTS = 1 << 24  # of temporary arrays; 64 MiB in float32
_SENSORS_AT_ONCE = 512  # sensors centred in float64 at a time

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


def pearson(readings: Array) -> Array:
    """Compute Pearson's r of every pair of sensors. readings (T, N) -> (N, N)."""
    xp = array_namespace(readings)
    parts = (readings[:, columns] for columns in slices_of(readings.shape[1], _SENSORS_AT_ONCE))
    return _correlation(xp, [_standardised(xp, part, readings.shape[1]) for part in parts])


def spearman(readings: Array) -> Array:
    """Compute Spearman's rho of every pair of sensors. readings (T, N) -> (N, N)."""
    xp, n_sensors, parts = array_namespace(readings), readings.shape[1], []
    for columns in slices_of(n_sensors, _SENSORS_AT_ONCE):
        series = xp.stack([readings[:, i] for i in range(columns.start, columns.stop)], axis=0)
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
    deviations = deviations - xp.mean(deviations, axis=0, keepdims=True)
    norm = xp.sqrt(xp.sum(deviations * deviations, axis=0, keepdims=True))
    return xp.astype(
        deviations / xp.where(norm > 0, norm, 1.0), getattr(xp, float_type(n_sensors).__name__)
    )


def _correlation(xp: Any, parts: list[Array]) -> Array:
    """Multiply standardised series, given in parts (T, m) -> (N, N)."""
    series = xp.concat(parts, axis=1)
    correlation = xp.matmul(xp.matrix_transpose(series), series)
    for rows, block, diagonal in _row_blocks(xp, correlation):
        correlation[rows, :] = xp.where(diagonal, 1.0, xp.clip(block, -1.0, 1.0))
    return correlation


def mutual_information(readings: Array, bins: int) -> Array:
    """Compute the mutual information of every pair of sensors. readings (T, N) -> (N, N).

    The device counts the pairs of codes; numpy computes the bins of each sensor.
    """
    xp = array_namespace(readings)
    values = maximum_entropy_codes(to_numpy(readings), bins)
    codes = _moved(values.astype(np.int16), readings)  # at most 1,024 bins
    n_frames, n_sensors = values.shape
    dtype = getattr(xp, float_type(n_sensors).__name__)
    on = [xp.astype(codes == code, dtype) for code in range(int(values.max()) + 1)]
    joint = xp.zeros((n_sensors, n_sensors), dtype=dtype, device=_compatibility().device(codes))
    for rows in _block_rows(joint):
        for first in on:
            left = xp.matrix_transpose(first[:, rows])
            for second in on:
                counts = xp.matmul(left, second)  # exact up to 2^24 frames in float32
                joint[rows, :] += counts * xp.log(xp.where(counts > 0, counts, 1.0))
    return _moved(information_from_logarithms(to_numpy(joint), n_frames), readings)


def regularised_reciprocal(similarity: Array, mu: float) -> Array:
    """Convert a similarity (N, N) in place to 1 / (s + mu s_min), 0 on the diagonal."""
    xp = array_namespace(similarity)
    smallest = np.inf
    for rows, block, diagonal in _row_blocks(xp, similarity):
        counted = xp.where(diagonal | (block < NUMERICAL_ZERO), 0.0, block)
        smallest = min(smallest, float(xp.min(xp.where(counted > 0, counted, xp.inf))))
        similarity[rows, :] = counted
    added = mu * smallest if np.isfinite(smallest) else 0.0
    for rows, block, diagonal in _row_blocks(xp, similarity):
        whole = block + added
        reciprocal = xp.where(whole > 0, 1 / xp.where(whole > 0, whole, 1.0), xp.inf)
        similarity[rows, :] = xp.where(diagonal, 0.0, reciprocal)
    return similarity


def metricise(dissimilarity: Array) -> Array:
    """Replace dissimilarities (N, N) by lengths of shortest paths.

    Blocked Floyd-Warshall algorithm: for each block of `MIDDLES` nodes, paths from the block to all
    other nodes are computed first; then all paths through the block are shortened.
    """
    xp = array_namespace(dissimilarity)
    # Products of matrices may round (i, j) and (j, i) differently.
    lengths = xp.minimum(dissimilarity, xp.matrix_transpose(dissimilarity))
    for middles in slices_of(lengths.shape[0], MIDDLES):
        ways = lengths[middles, :]
        among = ways[:, middles]
        for _ in range(MIDDLES.bit_length() - 1):
            among = xp.min(among[:, :, None] + among[None, :, :], axis=1)
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
    tiles, sizes = (-(-n_nodes // _TILE),) * 2, (np.int32(n_nodes), np.int32(n_ways))
    _kernel(lengths.dtype.name)(tiles, (16, 16), (lengths, xp.ascontiguousarray(ways), *sizes))
    return lengths


@cache
def _kernel(dtype: str) -> Any:
    real = {"float32": "float", "float64": "double"}[dtype]
    sizes = f"#define real {real}\n#define MIDDLES {MIDDLES}\n#define TILE {_TILE}\n"
    sizes += "#define FAR __int_as_float(0x7f800000)\n"  # infinity
    return import_extra("cupy", "a GPU", "gpu").RawKernel(sizes + _KERNEL, "lower")


def scale(metric: Array, dimensions: int, options: mds.SmacofOptions) -> mds.Scaling:
    """Scale a metric (N, N) by L-BFGS as in `smacof`; the stress is computed on the device."""
    xp = array_namespace(metric)
    n_points = metric.shape[0]
    if not np.isfinite(float(xp.max(metric))):
        raise InputError("some sensors are unrelated; use a regularisation above 0")
    if n_points < MIN_DEVICE_POINTS:
        return mds.smacof(to_numpy(metric), dimensions=dimensions, options=options)

    def multiply(vector: Floats, squares: Array = metric * metric) -> NDArray[Any]:
        return to_numpy(xp.matmul(squares, _moved(vector, squares, alike=True)))

    total = float(multiply(np.ones(n_points)).sum(dtype=np.float64))
    start = mds.classical_scaling(multiply, n_points, dimensions)
    del multiply  # also frees the squares
    least = mds.LARGE_TOLERANCE if n_points >= mds.MIN_LARGE else 0.0
    positions, trace, converged = mds.minimise_lbfgs(
        _raw_stress(xp, metric),
        start - start.mean(axis=0),
        np.full((n_points, 1), 2.0 * n_points),
        squares=total / 2,
        tolerance=max(options.tolerance, least),
        max_iterations=options.max_iterations,
    )
    positions = positions - positions.mean(axis=0)
    spread = n_points * float(np.vdot(positions, positions))  # Huygens' theorem
    return mds.Scaling(positions, trace[-1], spread, np.array(trace), bool(converged))


def _raw_stress(xp: Any, targets: Array) -> Callable[[Floats], tuple[float, Floats]]:
    """Return the raw stress of positions (N, k) and its gradient; see `objective` of smacof."""

    def raw_stress(positions: Floats) -> tuple[float, Floats]:
        points = _moved(positions, targets, alike=True)
        raw, slopes = 0.0, []
        for rows in _block_rows(targets):
            wanted = targets[rows, :]
            squares = xp.zeros_like(wanted)
            for axis in range(positions.shape[1]):
                step = xp.reshape(points[rows, axis], (-1, 1)) - points[None, :, axis]
                squares += step * step
            distances = xp.sqrt(squares)
            excess = distances - wanted
            raw += float(xp.sum(excess * excess, dtype=xp.float64))
            apart = distances > mds.COINCIDENT
            factors = xp.where(apart, excess / xp.where(apart, distances, 1.0), 0.0)
            pulls = points[rows, :] * xp.sum(factors, axis=1, keepdims=True)
            slopes.append(pulls - xp.matmul(factors, points))
        gradient = 2 * to_numpy(xp.concat(slopes, axis=0)).astype(np.float64)
        return raw / 2, gradient

    return raw_stress


def _block_rows(matrix: Array) -> Iterator[slice]:
    n_rows = matrix.shape[0]
    return slices_of(n_rows, max(1, _BLOCK_ELEMENTS // n_rows))


def _row_blocks(xp: Any, matrix: Array) -> Iterator[tuple[slice, Array, Array]]:
    """Yield blocks of rows of a square matrix: rows, values, and a mask of the diagonal."""
    n_rows, where = matrix.shape[0], {"dtype": xp.bool, "device": _compatibility().device(matrix)}
    for rows in _block_rows(matrix):
        yield rows, matrix[rows, :], xp.eye(rows.stop - rows.start, n_rows, k=rows.start, **where)


def _moved(values: NDArray[Any], array: Array, *, alike: bool = False) -> Array:
    """Copy values to the library and the device of an array; convert to its type if `alike`."""
    known = _compatibility()
    values = values.astype(str(array.dtype).rpartition(".")[2]) if alike else values
    return known.to_device(array_namespace(array).asarray(values), known.device(array))


def _compatibility() -> Any:
    return import_extra("array_api_compat", "arrays on a GPU", "gpu")


_COMPARED: Mapping[str, Callable[[Array, int], Array]] = MappingProxyType(
    {
        "r-anisomap": lambda x, _: pearson(x),
        "spearman-anisomap": lambda x, _: spearman(x),
        "i-anisomap": mutual_information,
    }
)


def reconstruct_on_device(
    readings: Array,
    method: str = "r-anisomap",
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    names: Sequence[str] = (),
) -> SensorMap:
    """Reconstruct the positions of sensors on the device of the readings.

    Parameters
    ----------
    readings : array of shape (T, N)
        Finite readings, as an array of CuPy (``cupy.asarray(readings)``), PyTorch or another
        library of the array API standard. About four matrices of shape (N, N) must fit in the
        memory of the device, in float32 from 2,000 sensors on.
    method : {"r-anisomap", "spearman-anisomap", "i-anisomap"}
        See `anisomap.METHODS`.
    dimensions : int
        Number of coordinates: 2 for flat skins, 3 for bodies.
    options : MethodOptions, optional
        Only `regularisation`, above 0, `entropy_bins`, `smacof` and `min_sensors` are used.
    names : sequence of str, optional
        Names of the sensors; by default ``s0, s1, ...``.

    Returns
    -------
    SensorMap
        The map of `anisomap.reconstruct`, up to rounding; NaN for constant sensors.

    Raises
    ------
    InputError
        As `anisomap.reconstruct`, or if the method or options are not available on a device.
    MissingExtraError
        If the compatibility layer of the array API standard (extra ``gpu``) is not installed.

    Examples
    --------
    With a numpy array, numpy computes the map:

    >>> import numpy as np
    >>> from anisomap.large import reconstruct_on_device
    >>> places, touches = np.arange(12), np.random.default_rng(0).uniform(0, 11, (2000, 1))
    >>> readings = np.maximum(0, 2 - abs(touches - places))
    >>> sensor_map = reconstruct_on_device(readings, dimensions=1)
    >>> bool(abs(np.corrcoef(sensor_map.positions[:, 0], places)[0, 1]) > 0.99)
    True
    """
    chosen = options or MethodOptions()
    if str(dimensions) == AUTO:
        raise InputError("dimensions are not chosen on a device: take 2 for flat skins, or 3")
    if method not in _COMPARED:
        raise InputError(f"{method} does not run on a device; choose from {', '.join(_COMPARED)}")
    if chosen.regularisation == 0:
        raise InputError("on a device, regularisation must be above 0, which joins all sensors")
    if readings.ndim != 2:
        raise InputError(f"readings must be of shape (T, N), got {tuple(readings.shape)}")
    xp, recipe = array_namespace(readings), find_method(method)
    n_frames, n_sensors = readings.shape
    names = tuple(names) or default_names(n_sensors)
    check_names(names, n_sensors)
    least = chosen.min_sensors
    check_size(dimensions, n_sensors, n_frames, least=least, total=n_sensors)
    if xp.isdtype(readings.dtype, "bool"):
        readings = xp.astype(readings, xp.uint8)  # the standard does not compare booleans
    varying = _varying(readings)
    n_varying = int(np.count_nonzero(varying))
    check_size(dimensions, n_varying, n_frames, least=least, total=n_sensors)
    if not varying.all():
        readings = xp.take(readings, _moved(np.flatnonzero(varying), readings), axis=1)
    check_unlike(readings, rows_of=lambda some: centred_rows(to_numpy(some)))
    compared = _COMPARED[method](readings, chosen.entropy_bins)
    metric = metricise(regularised_reciprocal(compared, chosen.regularisation))
    del compared
    logger.info("scaling %d sensors into %d dimensions", metric.shape[0], dimensions)
    scaling = scale(metric, int(dimensions), recipe.scaling_of(metric.shape[0], chosen.smacof))
    placed, n_iterations = np.zeros(len(scaling.positions), np.intp), len(scaling.trace) - 1
    configuration = Configuration(
        scaling.positions, placed, scaling.stress, scaling.converged, n_iterations
    )
    library = xp.__name__.rpartition(".")[2]
    facts = {"frames": int(n_frames), "similarity": recipe.similarity, "array_library": library}
    provenance = parameters_of(method, chosen, metric.shape[0]) | facts
    return as_map(
        configuration,
        names,
        varying,
        method=method,
        similarity=recipe.similarity,
        notes=tuple(caveats(configuration, None, names)),
        provenance=provenance,
    )


def _varying(readings: Array) -> NDArray[np.bool_]:
    """Check that readings (T, N) are finite, and return whether each sensor varies, (N,)."""
    xp = array_namespace(readings)
    lowest, highest = (to_numpy(bound(readings, axis=0)) for bound in (xp.min, xp.max))
    faulty = np.flatnonzero(~(np.isfinite(lowest) & np.isfinite(highest)))
    if faulty.size:
        raise InputError(f"sensor {faulty[0]} lacks a finite reading; replace missing readings")
    return np.asarray(highest > lowest)
