"""Time the pairwise statistics of thousands of sensors against what a user would write instead.

Every row is checked before it is timed. One thread and two are told apart: linear algebra and our
own threads obey the same limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy
from sklearn.metrics import mutual_info_score
from threadpoolctl import threadpool_limits

from anisomap.numerics.activity import estimate_rest
from anisomap.numerics.binning import maximum_entropy_codes
from anisomap.numerics.similarity import co_activation, information_of_codes, pearson

Matrix = NDArray[np.floating[Any]]

_PAIRS = 200


@dataclass(frozen=True)
class Rival:
    """What a statistic is measured against.

    Parameters
    ----------
    stage, name : str
        What is computed, and by what else.
    ours, theirs : callable
        Compute it, N x N each, or `theirs` some pairs of it.
    tolerance : float
        How far the results may be apart.
    pairs : ndarray of shape (k, 2), optional
        The pairs that `theirs` computes; its time is taken for all by their number.
    """

    stage: str
    name: str
    ours: Callable[[], Matrix]
    theirs: Callable[[], Matrix]
    tolerance: float
    pairs: NDArray[np.intp] | None = None


def skin(n_sensors: int, n_frames: int, active: float = 0.09) -> NDArray[np.float32]:
    """Give readings of a flat skin of which a wandering contact touches some share."""
    rng = np.random.default_rng(0)
    side = n_sensors**0.5
    positions = rng.uniform(size=(n_sensors, 2)) * side
    touch = np.cumsum(rng.normal(0, 0.5, (n_frames, 2)), axis=0) % side
    reach = side * (active / np.pi) ** 0.5
    readings = np.empty((n_frames, n_sensors), np.float32)
    for frame in range(0, n_frames, 256):
        part = slice(frame, frame + 256)
        squares = ((touch[part, None] - positions) ** 2).sum(axis=2)
        readings[part] = np.maximum(0, reach - np.sqrt(squares))
    return np.asarray(readings * rng.uniform(0.5, 1.5, (n_frames, 1)).astype(np.float32))


def rivals(n_sensors: int, n_frames: int) -> Iterator[Rival]:
    """Give all that is compared at one size."""
    readings = skin(n_sensors, n_frames)
    readings = readings[:, np.ptp(readings, axis=0) > 0]
    yield Rival(
        "Pearson r",
        "numpy.corrcoef",
        lambda: pearson(readings),
        lambda: np.asarray(np.corrcoef(readings.T)),
        1e-5,
    )
    active = estimate_rest(readings).active(readings)
    yield Rival(
        "co-activation (with finding rest)",
        "numpy.corrcoef of what is active",
        lambda: co_activation(readings),
        lambda: np.asarray(np.corrcoef(active.T)),
        1e-9,
    )
    rng = np.random.default_rng(1)
    pairs = rng.integers(0, readings.shape[1], (_PAIRS, 2))
    for bins in (4, 8):
        yield from _of_codes(
            f"9 % active, {bins} bins", maximum_entropy_codes(readings, bins), pairs
        )
    dense = rng.integers(0, 4, readings.shape, dtype=np.uint16)
    yield from _of_codes("dense, 4 bins", dense, pairs)


def _of_codes(what: str, codes: NDArray[np.uint16], pairs: NDArray[np.intp]) -> Iterator[Rival]:
    stage = f"mutual information ({what})"
    yield Rival(
        stage,
        "one-hot matrix product",
        lambda: information_of_codes(codes),
        lambda: one_hot_information(codes),
        1e-5,  # counts that large are rounded in float32 when their logarithms are taken
    )
    yield Rival(
        stage,
        f"sklearn mutual_info_score, from {len(pairs)} pairs",
        lambda: information_of_codes(codes),
        lambda: np.array([mutual_info_score(codes[:, i], codes[:, j]) for i, j in pairs]),
        1e-9,
        pairs,
    )


def one_hot_information(codes: NDArray[np.uint16]) -> Matrix:
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


def main(sizes: Sequence[int], n_frames: int = 30_000) -> None:
    """Print the rows of a table in Markdown."""
    print("| sensors | stage | threads | ours (s) | against | theirs (s) | ratio | same result |")
    print("|---|---|---|---|---|---|---|---|")
    for n_sensors in sizes:
        for rival in rivals(n_sensors, n_frames):
            for threads in (1, 2):
                with threadpool_limits(threads):
                    print(_row(n_sensors, rival, threads), flush=True)


def _row(n_sensors: int, rival: Rival, threads: int) -> str:
    # What others do on the machine does not show in the time that one thread was at work.
    clock = time.process_time if threads == 1 else time.perf_counter
    ours, mine = _timed(rival.ours, clock)
    theirs, yours = _timed(rival.theirs, clock)
    if rival.pairs is not None:
        mine = mine[tuple(rival.pairs.T)]
        theirs *= n_sensors * (n_sensors + 1) / 2 / len(rival.pairs)
    same = "yes" if np.abs(mine - yours).max() <= rival.tolerance else "NO"
    return (
        f"| {n_sensors} | {rival.stage} | {threads} | {ours:.3f} | {rival.name} | {theirs:.3f} "
        f"| {theirs / ours:.1f} | {same} |"
    )


def _timed(run: Callable[[], Matrix], clock: Callable[[], float]) -> tuple[float, Matrix]:
    """Give the faster of two runs; the first may have to compile."""
    seconds = []
    for _ in range(2):
        begin = clock()
        result = run()
        seconds.append(clock() - begin)
    return min(seconds), result


if __name__ == "__main__":
    main([256, 1000])
