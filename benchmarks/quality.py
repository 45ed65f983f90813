"""Accuracy of the maps of every method, stock methods included (``make quality``).

All methods map all scenarios of the paper, on seeds that were not used for tuning, and the
recordings in folders. (The covariogram method was tuned on seeds 101 to 105, its gates also on
301 to 455.) All maps of a recording are scored on the same sensors. The output is tables in
Markdown and CSV, all scores as CSV, and a figure of errors against the length of the recording.
"""

from __future__ import annotations

import argparse
import csv
import os
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

import anisomap
from anisomap.cli.commands import comparison as comparison_tables
from anisomap.comparison import COMPARED, RIVALS, Comparison, compare_methods
from anisomap.methods import DEFAULT_METHOD, METHODS
from benchmarks import quality_figure, quality_tables
from benchmarks.quality_tables import FRAMES, SCENARIOS, Result

MORE_SCENARIOS = (
    ("torus", "bombardment"),
    ("hand", "bombardment"),
    ("tube", "bombardment"),
    ("hexagon", "rubbing"),
    ("cylinder", "rubbing"),
    ("sphere", "roller"),
    ("plane", "pulses"),
)
DEFAULT_FRAMES = 2000
METHOD_NAMES = (DEFAULT_METHOD, "r-anisomap", "spearman-anisomap", *RIVALS)


def main(arguments: Sequence[str] | None = None) -> None:
    """Reconstruct all maps and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--methods", nargs="+", default=METHOD_NAMES, choices=(*METHODS, *RIVALS))
    parser.add_argument(
        "--recordings", type=Path, nargs="+", default=(), help="folders of NPZ files with positions"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("quality"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    files = [path for folder in chosen.recordings for path in sorted(folder.glob("*.npz"))]
    with ProcessPoolExecutor(chosen.workers) as pool:
        real = [pool.submit(score_file, path) for path in files]
        simulated = [
            pool.submit(score_simulation, body, scenario, frames, seed, chosen.methods)
            for seed in range(1, chosen.seeds + 1)
            for (body, scenario), frames in (
                *((which, FRAMES) for which in SCENARIOS),
                *((which, (DEFAULT_FRAMES,)) for which in MORE_SCENARIOS if seed <= 3),
            )
        ]
        await_all([*real, *simulated])
    judged = [result for job in real for result in job.result()[1]]
    comparisons = [job.result()[0] for job in real]
    write(
        chosen.output,
        [c for c in comparisons if c],
        judged,
        [q for j in simulated for q in j.result()],
    )


def await_all(jobs: Sequence[Future[Any]]) -> None:
    """Wait for all jobs, and print how many are done."""
    for number, job in enumerate(jobs, start=1):
        job.result()
        print(f"\r{number} of {len(jobs)} recordings", end="", flush=True)
    print()


def write(
    folder: Path,
    comparisons: Sequence[Comparison],
    real: Sequence[Result],
    simulated: Sequence[Result],
) -> None:
    """Write all tables and the figure, and print the tables."""
    texts = {}
    if comparisons:
        texts["recordings-table.md"] = comparison_tables.to_markdown(comparisons)
        texts["recordings.csv"] = comparison_tables.to_csv(comparisons)
    if simulated:
        texts["quality-table.md"] = quality_tables.tables(simulated)
        texts["simulated.csv"] = quality_tables.summary(simulated, DEFAULT_FRAMES)
        quality_figure.draw(simulated, folder / "quality.png")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        if name.endswith(".md"):
            print(text)
    with (folder / "quality.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow([field.name for field in fields(Result)])
        table.writerows(astuple(result) for result in [*real, *simulated])


def score_simulation(
    body: str, scenario: str, lengths: Sequence[int], seed: int, methods: Iterable[str]
) -> list[Result]:
    """Score maps of one simulated recording, truncated to several lengths, in 3D."""
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        whole = anisomap.simulate(body, scenario, n_frames=max(lengths), seed=seed)
        results = []
        for length in lengths:
            beginning = anisomap.Recording(whole.readings[:length], positions=whole.positions)
            compared = compare_methods(
                beginning, tuple(methods), 3, name=f"{body}, {scenario}", seed=seed
            )
            results += all_scores(compared, seed)
        return results


def score_file(path: Path) -> tuple[Comparison | None, list[Result]]:
    """Score maps of a recording with known positions, in as many dimensions as these span."""
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        try:
            recording = anisomap.read(path)
            compared = compare_methods(recording, COMPARED, name=path.stem)
        except anisomap.AnisomapError as error:
            print(f"skipped {path.name}: {error}")
            return None, []
        results = all_scores(compared, 0)
    scores = tuple(replace(s, sensor_map=None) for s in compared.scores)
    return replace(compared, scores=scores), results


def all_scores(compared: Comparison, seed: int) -> list[Result]:
    """Return the scores of all methods."""
    return [
        Result(
            compared.name,
            compared.n_frames,
            seed,
            s.method,
            s.mantel_r,
            s.rms_in_spacings,
            s.n_placed / compared.n_sensors,
            len(compared.sensors) / compared.n_sensors,
        )
        for s in compared.scores
    ]


if __name__ == "__main__":
    main()
