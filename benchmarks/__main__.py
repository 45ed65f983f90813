"""Time every stage against numpy, scipy or scikit-learn, side by side in one run.

Results are compared before they are timed: a fast wrong answer is no answer.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr
from sklearn.metrics import mutual_info_score

from anisomap.numerics.binning import maximum_entropy_codes
from anisomap.numerics.similarity import information_of_codes, pearson, spearman
from benchmarks import core, simulation, statistics

Matrix = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Race:
    """A stage, and what it is measured against; `agree` tells whether two results are the same."""

    stage: str
    against: str
    ours: Callable[[], Matrix]
    theirs: Callable[[], Matrix]
    agree: Callable[[Matrix, Matrix], bool]


def skin(n_sensors: int, n_frames: int, rng: np.random.Generator) -> Matrix:
    """Sparse readings of a flat skin over which a contact wanders."""
    positions = rng.uniform(size=(n_sensors, 2)) * n_sensors**0.5
    touch = np.cumsum(rng.normal(0, 0.5, (n_frames, 2)), axis=0) % n_sensors**0.5
    squares = ((touch[:, None] - positions) ** 2).sum(axis=2)
    depths = np.maximum(0, 2.5 - np.sqrt(squares))
    return np.asarray(depths * rng.uniform(0.5, 1.5, (n_frames, 1)))


def races(n_sensors: int, n_frames: int) -> Iterator[Race]:
    """Give every race on one skin."""
    readings = skin(n_sensors, n_frames, np.random.default_rng(0))
    readings = readings[:, np.ptp(readings, axis=0) > 0]
    yield Race(
        "Pearson r",
        "numpy.corrcoef",
        lambda: pearson(readings),
        lambda: np.asarray(np.corrcoef(readings.T)),
        lambda a, b: np.allclose(a, b, atol=1e-5),
    )
    yield Race(
        "Spearman rho",
        "scipy.stats.spearmanr",
        lambda: spearman(readings),
        lambda: np.asarray(spearmanr(readings).statistic),
        lambda a, b: np.allclose(a, b, atol=1e-10),
    )
    codes = maximum_entropy_codes(readings)
    few = codes[:, : min(60, codes.shape[1])]
    yield Race(
        f"mutual information ({few.shape[1]} sensors)",
        "sklearn mutual_info_score over pairs",
        lambda: information_of_codes(few),
        lambda: np.array([[mutual_info_score(a, b) for a in few.T] for b in few.T]),
        lambda a, b: np.allclose(a, b, atol=1e-10),
    )


def main() -> None:
    """Run the races and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensors", type=int, nargs="+", default=[256, 1000, 4000])
    parser.add_argument("--frames", type=int, default=4000)
    arguments = parser.parse_args()
    print("| sensors | stage | ours (s) | against | theirs (s) | ratio | same result |")
    print("|---|---|---|---|---|---|---|")
    for n_sensors in arguments.sensors:
        for race in races(n_sensors, arguments.frames):
            ours, mine = _timed(race.ours)
            theirs, yours = _timed(race.theirs)
            same = "yes" if race.agree(mine, yours) else "NO"
            print(
                f"| {n_sensors} | {race.stage} | {ours:.4f} | {race.against} | {theirs:.4f} "
                f"| {theirs / ours:.1f} | {same} |",
                flush=True,
            )
    print()
    statistics.main(arguments.sensors)
    core.main(arguments.sensors)
    print()
    simulation.main()


def _timed(run: Callable[[], Matrix], least_seconds: float = 0.2) -> tuple[float, Matrix]:
    """Give the fastest of several runs, since what disturbs a run only ever slows it."""
    seconds: list[float] = []
    while sum(seconds) < least_seconds or len(seconds) < 2:
        begin = time.perf_counter()
        result = run()
        seconds.append(time.perf_counter() - begin)
    return min(seconds), result


if __name__ == "__main__":
    main()
