"""Pairwise statistics beside numpy, scipy and scikit-learn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy
from scipy.stats import spearmanr
from sklearn.metrics import mutual_info_score

from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.correlation import co_activation, pearson, spearman
from anisomap.numerics.similarity.information import information_from_codes
from benchmarks.inputs import noisy_readings, stroked_skin, tiled_torso
from benchmarks.race import Race, Rival, Setting, timed_rival

Floats = NDArray[np.floating[Any]]
Codes = NDArray[np.uint16]

WHOLE = 4000  # sensors, or one-hot columns, up to which rivals do all of the work
PAIRS = 500
_SPEARMAN_FRAMES = 10_000


def pearson_races(setting: Setting) -> Iterator[Race]:
    """Correlate what sensors read."""
    inputs = {"simulated skin": stroked_skin(setting.n_sensors, setting.n_frames)[0]}
    if setting.torso:
        inputs["torso, tiled"] = tiled_torso(setting.torso, setting.n_sensors, setting.n_frames)
    inputs["pure noise"] = noisy_readings(setting.n_sensors, setting.n_frames)
    for given, readings in inputs.items():
        theirs = Theirs("numpy.corrcoef", correlation, 1e-5, goal=2)
        yield Race("Pearson r", given, partial(pearson, readings), (_of_leading(readings, theirs),))


def spearman_races(setting: Setting) -> Iterator[Race]:
    """Correlate ranks, of the first frames: ranking takes long, and is scipy's on both sides."""
    readings = stroked_skin(setting.n_sensors, setting.n_frames)[0][:_SPEARMAN_FRAMES]
    theirs = Theirs(
        "scipy.stats.spearmanr", lambda part: np.asarray(spearmanr(part).statistic), 1e-5
    )
    given = f"simulated skin, {len(readings):,} frames"
    yield Race("Spearman rho", given, partial(spearman, readings), (_of_leading(readings, theirs),))


def co_activation_races(setting: Setting) -> Iterator[Race]:
    """Correlate being touched at all."""
    readings = stroked_skin(setting.n_sensors, setting.n_frames)[0]
    theirs = Theirs("numpy, product of indicators", phi_by_product, 1e-5, goal=12)
    ours = partial(co_activation, readings)
    yield Race("co-activation", "simulated skin", ours, (_of_leading(readings, theirs),))


class Theirs(NamedTuple):
    """A rival, how far it may be from ours, the goal, and how many sensors it is given at most."""

    name: str
    compute: Callable[[NDArray[Any]], Floats]
    tolerance: float
    goal: float | None = None
    most: int | None = None


def _of_leading(series: NDArray[Any], theirs: Theirs) -> Rival:
    """Let a rival do all pairs of the first sensors: what is left goes with their square."""
    n_sensors = series.shape[1]
    few = min(n_sensors, theirs.most or WHOLE)

    def same(ours: Floats, expected: Floats) -> bool:
        return bool(np.abs(ours[:few, :few] - expected).max() <= theirs.tolerance)

    return timed_rival(
        theirs.name,
        lambda: theirs.compute(series[:, :few]),
        same,
        part=f"{few:,} sensors",
        factor=(n_sensors / few) ** 2,
        goal=theirs.goal,
    )


def correlation(readings: Floats) -> Floats:
    """Correlate as numpy does."""
    return np.asarray(np.corrcoef(readings.T))


def phi_by_product(readings: Floats) -> Floats:
    """Correlate what is above 0 as one would write it: one product, and the marginals."""
    on = (readings > 0).astype(np.float32)
    together = (on.T @ on).astype(np.float64)
    share = np.diag(together) / len(on)
    covariance = together / len(on) - np.outer(share, share)
    deviation = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviation, deviation))


def information_races(setting: Setting) -> Iterator[Race]:
    """Give the mutual information of codes, where all of them are frequent and where few are."""
    readings = stroked_skin(setting.n_sensors, setting.n_frames)[0]
    rng = np.random.default_rng(1)
    for bins in (2, 4, 8):
        dense = rng.integers(0, bins, readings.shape, dtype=np.uint16)
        yield _information(f"dense, {bins} bins", dense, 6, drawn=bins == 8)
        sparse = maximum_entropy_codes(readings, bins)
        yield _information(f"9 % active, {bins} bins", sparse, 12, drawn=bins == 8)


def _information(given: str, codes: Codes, goal: float, *, drawn: bool) -> Race:
    n_codes = int(codes.max()) + 1
    # Counts so large are rounded in float32 when their logarithms are taken.
    by_product = Theirs("numpy, one-hot product", one_hot_information, 1e-4, goal, WHOLE // n_codes)
    rivals = (_of_leading(codes, by_product), _by_pairs(codes, 3000))
    compute = partial(information_from_codes, codes)
    return Race("mutual information", given, compute, rivals, drawn)


def _by_pairs(codes: Codes, goal: float) -> Rival:
    n_sensors = codes.shape[1]
    pairs = np.random.default_rng(2).integers(0, n_sensors, (PAIRS, 2))

    def some_pairs() -> Floats:
        return np.array([mutual_info_score(codes[:, i], codes[:, j]) for i, j in pairs])

    def same(ours: Floats, theirs: Floats) -> bool:
        return bool(np.abs(ours[tuple(pairs.T)] - theirs).max() <= 1e-9)

    return timed_rival(
        "sklearn mutual_info_score",
        some_pairs,
        same,
        part=f"{PAIRS} pairs",
        factor=n_sensors * (n_sensors + 1) / 2 / PAIRS,
        goal=goal,
    )


def one_hot_information(codes: Codes) -> Floats:
    """Give mutual information as one would write it: all codes one-hot, one product, logarithms."""
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
