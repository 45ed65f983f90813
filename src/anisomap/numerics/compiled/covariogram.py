"""Compiled loops over the pairs of the covariogram fit, in float32.

They do as `anisomap.numerics.covariogram.objective` does. Logarithms and exponentials are series in
plain arithmetic, which compilers vectorise, unlike calls of functions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from anisomap.numerics.compiled.parallel import loop
from anisomap.numerics.compiled.stress import REORDERED, WIDTH, Reals, Singles

# Not in any order, since the reduction of exponents is exact only in the order written.
_IN_ORDER = REORDERED - {"reassoc"}
_ONE, _TWO, _HALF = np.float32(1), np.float32(2), np.float32(0.5)
_LOG2 = float(np.log(2))
_PER_LOG2 = np.float32(1 / _LOG2)
# log 2 in two parts, the first with few enough bits that its products with exponents are exact.
_LOG2_HIGH = np.float32(round(_LOG2 * 512) / 512)
_LOG2_LOW = np.float32(_LOG2 - round(_LOG2 * 512) / 512)
_MANTISSA_BITS, _BIAS = np.int32(23), np.int32(127)  # of IEEE 754 single precision
_ROOT_HALF = np.sqrt(np.float32(0.5)).view(np.int32)
_E2, _E3, _E4, _E5, _E6, _E7 = (np.float32(1 / n) for n in (2, 6, 24, 120, 720, 5040))
_L3, _L5, _L7, _L9 = (np.float32(1 / n) for n in (3, 5, 7, 9))


@loop(fastmath=_IN_ORDER, error_model="numpy")
def exponential(x: Any) -> Any:
    """Return exp x within 1e-7 of its value, for x from -87 to 88.

    ``exp x = 2^w exp y`` for a whole number w and ``|y| <= log(2) / 2``, where the Taylor series up
    to y^7 is exact in float32.
    """
    w = np.floor(x * _PER_LOG2 + _HALF)
    y = (x - w * _LOG2_HIGH) - w * _LOG2_LOW
    tail = _E4 + y * (_E5 + y * (_E6 + y * _E7))
    series = _ONE + y * (_ONE + y * (_E2 + y * (_E3 + y * tail)))
    return series * np.int32((np.int32(w) + _BIAS) << _MANTISSA_BITS).view(np.float32)


@loop(fastmath=_IN_ORDER, error_model="numpy")
def logarithm(x: Any) -> Any:
    """Return log x for normal numbers, with an absolute and a relative error of up to 1e-7.

    ``log x = e log 2 + log m`` for a whole number e and m from sqrt(1/2) to sqrt(2); log m is the
    series of ``2 artanh u`` up to u^9, with ``u = (m - 1) / (m + 1)``.
    """
    bits = np.float32(x).view(np.int32)
    e = np.int32((bits - _ROOT_HALF) >> _MANTISSA_BITS)
    m = np.int32(bits - (e << _MANTISSA_BITS)).view(np.float32)
    u = (m - _ONE) / (m + _ONE)
    q = u * u
    series = _TWO * u * (_ONE + q * (_L3 + q * (_L5 + q * (_L7 + q * _L9))))
    return np.float32(e) * _LOG2_HIGH + (np.float32(e) * _LOG2_LOW + series)


@loop(fastmath=REORDERED, error_model="numpy")
def decay(
    points: Reals,
    known: Singles,
    exponent: float,
    bounds: tuple[float, float, float],
    found: tuple[Singles, Singles, Singles, Singles],
) -> None:
    """Evaluate the shape of the covariogram at the distances of points, shape (k, n).

    `bounds` are the least and greatest squared distance, and the greatest logarithm of a power.
    """
    shape, steepness, squares, logarithms = found
    n_axes, n_points = points.shape
    row = np.empty(n_points)
    first = 0
    for i in range(n_points - 1):
        size = n_points - 1 - i
        summed = row[:size]
        summed[:] = 0.0
        for axis in range(n_axes):
            mine, theirs = points[axis, i], points[axis, i + 1 :]
            for j in range(size):
                summed[j] += (mine - theirs[j]) * (mine - theirs[j])
        target = squares[first : first + size]
        for j in range(size):
            target[j] = np.float32(min(max(summed[j], bounds[0]), bounds[1]))
        first += size
    factor, highest = np.float32(exponent / 2), np.float32(bounds[2])
    for p in range(len(squares)):
        logarithm_of_square = logarithm(squares[p])
        logarithms[p] = _HALF * logarithm_of_square
        power = exponential(min(factor * logarithm_of_square, highest))
        shape[p] = known[p] * exponential(-power)
        steepness[p] = power * shape[p]


@loop(fastmath=REORDERED, error_model="numpy")
def slope(
    decayed: tuple[Singles, Singles, Singles, Singles],
    whitened_shape: Singles,
    data: tuple[Singles, Singles, Singles, Singles, Singles],
    weights: tuple[float, float, float, float, float, float, float],
    force: Singles,
) -> tuple[float, float]:
    """Return the value and the derivative by the log exponent, and write the force."""
    n_pairs = len(force)
    value = by_exponent = deviations = log_distances = ratios = squared = size = 0.0
    for start in range(0, n_pairs, WIDTH):
        stop = min(start + WIDTH, n_pairs)
        squares, inverse_metric = decayed[2][start:stop], data[4][start:stop]
        part = part_squared = part_size = np.float32(0)
        for p in range(len(squares)):
            ratio = np.sqrt(squares[p]) * inverse_metric[p]
            part += ratio
            part_squared += ratio * ratio
            part_size += squares[p]
        ratios += float(part)
        squared += float(part_squared)
        size += float(part_size)
    mean, free = ratios / weights[6], 1 - weights[5]
    variance = np.float32(free * (squared / weights[6] / mean**2 - 1))
    prior_weight = weights[3] * mean ** (2 * weights[5])
    size /= n_pairs
    inverse_size, prior = np.float32(free / size), np.float32(prior_weight / mean)
    inverse_mean = np.float32(1 / mean)
    amplitude, offset = np.float32(weights[0]), np.float32(weights[2])
    steeper, half_repulsion = np.float32(-weights[0] * weights[1]), np.float32(weights[4] / 2)
    for start in range(0, n_pairs, WIDTH):
        stop = min(start + WIDTH, n_pairs)
        shape, steepness = decayed[0][start:stop], decayed[1][start:stop]
        squares, logarithms = decayed[2][start:stop], decayed[3][start:stop]
        known, similarity = data[0][start:stop], data[1][start:stop]
        whitened_known, whitened_similarity = data[2][start:stop], data[3][start:stop]
        inverse_metric = data[4][start:stop]
        whitened, forces = whitened_shape[start:stop], force[start:stop]
        part = part_by_exponent = part_deviation = part_logarithm = np.float32(0)
        for p in range(len(forces)):
            residual = amplitude * shape[p] + offset * known[p] - similarity[p]
            slope = amplitude * whitened[p] + offset * whitened_known[p] - whitened_similarity[p]
            part += residual * slope
            slope *= steeper * steepness[p]
            part_by_exponent += slope * logarithms[p]
            part_logarithm += logarithms[p]
            distance, inverse_square = np.sqrt(squares[p]), _ONE / squares[p]
            deviation = distance * inverse_metric[p] * inverse_mean - _ONE
            part_deviation += deviation * deviation
            slope += prior * (deviation - variance) * inverse_metric[p] * distance
            forces[p] = slope * inverse_square - half_repulsion * (inverse_square - inverse_size)
        value += float(part)
        by_exponent += float(part_by_exponent)
        deviations += float(part_deviation)
        log_distances += float(part_logarithm)
    log_distances -= free * n_pairs / 2 * np.log(size)
    deviations -= n_pairs - weights[6]  # from infinite distances, -1 each
    value += prior_weight * deviations - weights[4] * log_distances
    return value, 2 * by_exponent


@loop(fastmath=REORDERED, error_model="numpy")
def pull(force: Singles, points: Reals, pulled: Reals) -> None:
    """Add the gradient by the coordinates to `pulled`; it and `points` have shape (k, n)."""
    n_axes, n_points = points.shape
    first = 0
    for i in range(n_points - 1):
        forces = force[first : first + n_points - 1 - i]
        for axis in range(n_axes):
            mine, theirs, target = points[axis, i], points[axis, i + 1 :], pulled[axis, i + 1 :]
            summed = 0.0
            for j in range(len(forces)):
                share = 2 * forces[j] * (mine - theirs[j])
                summed += share
                target[j] -= share
            pulled[axis, i] += summed
        first += len(forces)


@loop(fastmath=REORDERED, error_model="numpy")
def centre(values: Singles, n_points: int, factor: float, centred: Singles) -> None:
    """Write a symmetric matrix, minus means of rows and columns, times a factor, by pairs."""
    means, first, scale = np.zeros(n_points, np.float32), 0, np.float32(factor)
    for i in range(n_points - 1):
        row, others, own = values[first : first + n_points - 1 - i], means[i + 1 :], np.float32(0)
        for j in range(len(row)):
            own += row[j]
            others[j] += row[j]
        means[i] += own
        first += len(row)
    means /= np.float32(n_points)
    means -= means.mean() / np.float32(2)
    first = 0
    for i in range(n_points - 1):
        row, others, found = values[first:], means[i + 1 :], centred[first:]
        for j in range(len(others)):
            found[j] = scale * (row[j] - means[i] - others[j])
        first += len(others)
