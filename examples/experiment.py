"""Compare methods on simulated recordings: one body, one scenario, several seeds.

Change the constants, and run ``python examples/experiment.py``; it prints medians over the seeds
and writes all scores to ``experiment.csv``. Requires anisomap[simulation].
"""

import csv
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import anisomap

BODY, SCENARIO = "sphere", "locomotion"  # anisomap list bodies, anisomap list scenarios
METHODS = ("r-anisomap", "covariogram")  # anisomap list methods
SEEDS = (1, 2, 3)
SETTINGS = {"n_frames": 2000, "detection_radius": 0.3}  # anisomap list scenarios locomotion
DIMENSIONS = 3


def scored(seed: int) -> list[tuple[int, str, float, float, float]]:
    """Simulate and map one recording; return seed, method and scores of each map."""
    recording = anisomap.simulate(BODY, SCENARIO, seed=seed, **SETTINGS)
    rows = []
    for method in METHODS:
        made = anisomap.reconstruct(recording, method, DIMENSIONS)
        found = anisomap.score(made, recording.positions[:, :DIMENSIONS], permutations=0)
        rows.append((seed, method, found.mantel.r, found.rms_in_spacings, found.neighbours_kept))
    return rows


def main(output: str = "experiment.csv", seeds: Sequence[int] = SEEDS) -> None:
    """Write the scores of all maps, and print their medians."""
    rows = [row for seed in seeds for row in scored(seed)]
    with Path(output).open("w", newline="") as file:
        header = ("seed", "method", "mantel_r", "error_in_spacings", "neighbours_kept")
        csv.writer(file).writerows([header, *rows])
    for method in METHODS:
        r, error, kept = (median(row[i] for row in rows if row[1] == method) for i in (2, 3, 4))
        print(f"{method:<20} Mantel r {r:.3f}, error {error:.2f} spacings, neighbours {kept:.0%}")


if __name__ == "__main__":
    main()
