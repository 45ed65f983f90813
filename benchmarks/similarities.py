"""Pairwise statistics, compared with numpy, scipy and scikit-learn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy
from scipy.stats import spearmanr
from sklearn.metrics import mutual_info_score

from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.correlation import co_activation, pearson, spearman
from anisomap.numerics.similarity.information import information_from_codes
from benchmarks.comparison import (
    Comparison,
    Reference,
    Setting,
    describe_share,
    timed_reference,
)
from benchmarks.inputs import noisy_readings, rubbed_skin, tiled_torso
from benchmarks.measuring import Cost, measure_on_one_thread

Floats = NDArray[np.floating[Any]]
Codes = NDArray[np.uint16]

MAX_REFERENCE_SENSORS = 4000
"""References compute a share of larger problems."""

MAX_ONE_HOT = 2000
"""Columns of the product of one-hot codes, which also computes a share of larger problems."""

N_PAIRS = 60
CHECKED_SENSORS = 1000
"""Sensors whose correlations are compared with numpy's, whose time is measured on noise."""

_SPEARMAN_FRAMES = 3000
_FEW_BINS, _MANY_BINS = 2, 8


def compare_pearson(setting: Setting) -> Iterator[Comparison]:
    """Pearson's r of readings."""
    inputs = {"simulated skin": rubbed_skin(setting.n_sensors, setting.n_frames)[0]}
    if setting.torso:
        inputs["torso, tiled"] = tiled_torso(setting.torso, setting.n_sensors, setting.n_frames)
    inputs["pure noise"] = noisy_readings(setting.n_sensors, setting.n_frames)
    for dataset, readings in inputs.items():
        compute = partial(pearson, readings)
        reference = _of_corrcoef(readings, setting.n_frames, goal=2)
        yield Comparison("Pearson r", dataset, compute, (reference,))


def _of_corrcoef(readings: Floats, n_frames: int, goal: float) -> Reference:
    cost, factor = cost_of_corrcoef(n_frames, readings.shape[1])
    share = len(readings) / n_frames
    cost, factor = cost.times(share), factor * share
    return Reference(
        "numpy.corrcoef",
        cost,
        lambda result: are_correlations(result, readings),
        goal,
        describe_share("noise", factor) or "timed on noise",
        estimated=factor != 1,
    )


@cache
def cost_of_corrcoef(n_frames: int, n_sensors: int) -> tuple[Cost, float]:
    """Return numpy's cost, which does not depend on the readings, and its extrapolation."""
    few = min(n_sensors, MAX_REFERENCE_SENSORS)
    readings = noisy_readings(few, n_frames)
    cost, _ = measure_on_one_thread(lambda: correlation(readings))
    factor = (n_sensors / few) ** 2
    return cost.times(factor), factor


def are_correlations(result: Floats, readings: Floats) -> bool:
    """Return whether correlations of a regular sample of the sensors are those of numpy."""
    sample = np.arange(0, readings.shape[1], -(-readings.shape[1] // CHECKED_SENSORS))
    expected = correlation(readings[:, sample])
    return bool(np.abs(result[np.ix_(sample, sample)] - expected).max() <= 1e-5)


def compare_spearman(setting: Setting) -> Iterator[Comparison]:
    """Spearman's rho of the first frames: ranking is slow, and both sides use scipy for it."""
    readings = rubbed_skin(setting.n_sensors, setting.n_frames)[0][:_SPEARMAN_FRAMES]
    reference = ReferenceSpec(
        "scipy.stats.spearmanr", lambda part: np.asarray(spearmanr(part).statistic), 1e-5
    )
    dataset = f"simulated skin, {len(readings):,} frames"
    yield Comparison(
        "Spearman rho",
        dataset,
        partial(spearman, readings),
        (_of_first_sensors(readings, reference),),
    )


def compare_co_activation(setting: Setting) -> Iterator[Comparison]:
    """Phi coefficient of contact."""
    readings = rubbed_skin(setting.n_sensors, setting.n_frames)[0]
    reference = ReferenceSpec("numpy, product of indicators", phi_by_product, 1e-5, goal=12)
    compute = partial(co_activation, readings)
    yield Comparison(
        "co-activation", "simulated skin", compute, (_of_first_sensors(readings, reference),)
    )


class ReferenceSpec(NamedTuple):
    """A reference: its tolerance, its goal and its maximum number of sensors."""

    name: str
    compute: Callable[[NDArray[Any]], Floats]
    tolerance: float
    goal: float | None = None
    max_sensors: int | None = None


def _of_first_sensors(series: NDArray[Any], spec: ReferenceSpec) -> Reference:
    """Time a reference on the first sensors and extrapolate with the square of their number."""
    n_sensors = series.shape[1]
    few = min(n_sensors, spec.max_sensors or MAX_REFERENCE_SENSORS)

    def same(result: Floats, expected: Floats) -> bool:
        return bool(np.abs(result[:few, :few] - expected).max() <= spec.tolerance)

    return timed_reference(
        spec.name,
        lambda: spec.compute(series[:, :few]),
        same,
        share=f"{few:,} sensors",
        factor=(n_sensors / few) ** 2,
        goal=spec.goal,
    )


def correlation(readings: Floats) -> Floats:
    """Pearson's r by numpy."""
    return np.asarray(np.corrcoef(readings.T))


def phi_by_product(readings: Floats) -> Floats:
    """Phi coefficient of positive readings from one matrix product and the marginals."""
    on = (readings > 0).astype(np.float32)
    together = (on.T @ on).astype(np.float64)
    share = np.diag(together) / len(on)
    covariance = together / len(on) - np.outer(share, share)
    deviation = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviation, deviation))


def compare_information(setting: Setting) -> Iterator[Comparison]:
    """Mutual information of codes, for dense and sparse readings."""
    readings = rubbed_skin(setting.n_sensors, setting.n_frames)[0]
    rng = np.random.default_rng(1)
    for bins in (_FEW_BINS, 4, _MANY_BINS):
        if setting.more or bins == _FEW_BINS:
            dense = rng.integers(0, bins, readings.shape, dtype=np.uint16)
            yield _information(f"dense, {bins} bins", dense, 6, drawn=bins == _FEW_BINS)
        if setting.more or bins == _MANY_BINS:
            sparse = maximum_entropy_codes(readings, bins)
            yield _information(f"9 % active, {bins} bins", sparse, 12, drawn=bins == _MANY_BINS)


def _information(dataset: str, codes: Codes, goal: float, *, drawn: bool) -> Comparison:
    n_codes = int(codes.max()) + 1
    # The reference takes logarithms of large counts in float32; hence the tolerance.
    by_product = ReferenceSpec(
        "numpy, one-hot product", one_hot_information, 1e-4, goal, MAX_ONE_HOT // n_codes
    )
    references = (_of_first_sensors(codes, by_product), _by_pairs(codes, 3000))
    compute = partial(information_from_codes, codes)
    return Comparison("mutual information", dataset, compute, references, drawn)


def _by_pairs(codes: Codes, goal: float) -> Reference:
    n_sensors = codes.shape[1]
    pairs = np.random.default_rng(2).integers(0, n_sensors, (N_PAIRS, 2))

    def some_pairs() -> Floats:
        return np.array([mutual_info_score(codes[:, i], codes[:, j]) for i, j in pairs])

    def same(result: Floats, expected: Floats) -> bool:
        rounding = 1e-9 if result.dtype == np.float64 else 1e-6
        return bool(np.abs(result[tuple(pairs.T)] - expected).max() <= rounding)

    return timed_reference(
        "sklearn mutual_info_score",
        some_pairs,
        same,
        share=f"{N_PAIRS} pairs",
        factor=n_sensors * (n_sensors + 1) / 2 / N_PAIRS,
        goal=goal,
    )


def one_hot_information(codes: Codes) -> Floats:
    """Mutual information from one matrix product of one-hot codes."""
    (n_frames, n_sensors), n_codes = codes.shape, int(codes.max()) + 1
    on = np.empty((n_frames, n_codes, n_sensors), np.float32)
    for code in range(n_codes):
        on[:, code] = codes == code
    flat = on.reshape(n_frames, -1)
    counts = flat.T @ flat
    marginals = np.diag(counts).astype(np.float64)
    joint = xlogy(counts, counts).reshape(n_codes, n_sensors, n_codes, n_sensors).sum(axis=(0, 2))
    own = xlogy(marginals, marginals).reshape(n_codes, n_sensors).sum(axis=0)
    return np.asarray(np.log(n_frames) + (joint - np.add.outer(own, own)) / n_frames)
