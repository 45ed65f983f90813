"""Accuracy of the maps of every method (``make quality``).

All methods map all scenarios of the paper, on seeds that were not used for tuning, and the
recordings in a folder. (The covariogram method was tuned on seeds 101 to 105, its gates also on
301 to 455.) The output is a table in Markdown, all scores as CSV, and a figure of errors against
the length of the recording.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import os
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

import anisomap
from anisomap.methods import METHODS

SCENARIOS = (
    ("sphere", "bombardment"),
    ("cylinder", "bombardment"),
    ("y-shape", "bombardment"),
    ("plane", "bombardment"),
    ("sphere", "locomotion"),
    ("cylinder", "locomotion"),
)
MORE_SCENARIOS = (
    ("torus", "bombardment"),
    ("hand", "bombardment"),
    ("tube", "bombardment"),
    ("hexagon", "rubbing"),
    ("cylinder", "rubbing"),
    ("sphere", "roller"),
    ("plane", "pulses"),
)
FRAMES = (500, 2000, 8000)
DEFAULT_FRAMES = 2000
METHOD_NAMES = ("r-anisomap", "i-anisomap", "spearman-anisomap", "covariogram")
REFERENCE = "r-anisomap"


@dataclass(frozen=True)
class Result:
    """Score of one map."""

    recording: str
    n_frames: int
    seed: int
    method: str
    mantel_r: float
    confidence: float
    share_placed: float


def main() -> None:
    """Reconstruct all maps and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--methods", nargs="+", default=METHOD_NAMES, choices=tuple(METHODS))
    parser.add_argument("--recordings", type=Path, help="folder of NPZ files with positions")
    parser.add_argument("-o", "--output", type=Path, default=Path("quality"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    chosen.output.mkdir(parents=True, exist_ok=True)
    files = sorted(chosen.recordings.glob("*.npz")) if chosen.recordings else []
    results: list[Result] = []
    with ProcessPoolExecutor(chosen.workers) as pool:
        jobs = [
            *(pool.submit(score_file, path, chosen.methods) for path in files),
            *(
                pool.submit(score_simulation, body, scenario, frames, seed, chosen.methods)
                for seed in range(1, chosen.seeds + 1)
                for (body, scenario), frames in (
                    *((which, FRAMES) for which in SCENARIOS),
                    *((which, (DEFAULT_FRAMES,)) for which in MORE_SCENARIOS if seed <= 3),
                )
            ),
        ]
        for number, job in enumerate(jobs, start=1):
            results += job.result()
            print(f"\r{number} of {len(jobs)} recordings", end="", flush=True)
    print()
    write_csv(results, chosen.output / "quality.csv")
    text = "\n".join([*tables(results), *calibration(results)])
    (chosen.output / "quality.md").write_text(text + "\n", encoding="utf-8")
    draw(results, chosen.output / "quality.png")
    print(text)


def score_simulation(
    body: str, scenario: str, lengths: Sequence[int], seed: int, methods: Iterable[str]
) -> list[Result]:
    """Score maps of one simulated recording, truncated to several lengths."""
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        whole = anisomap.simulate(body, scenario, n_frames=max(lengths), seed=seed)
        return [
            score(whole, f"{body}, {scenario}", method, n_frames=length, seed=seed, dimensions=3)
            for length, method in itertools.product(lengths, methods)
        ]


def score_file(path: Path, methods: Iterable[str]) -> list[Result]:
    """Score maps of a recording with known positions, in as many dimensions as these span."""
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        try:
            recording = anisomap.read(path)
        except anisomap.AnisomapError as error:
            print(f"skipped: {error}")
            return []
        if recording.positions is None or not np.isfinite(recording.positions).all():
            return []
        flat = np.linalg.svd(recording.positions - recording.positions.mean(axis=0))[1]
        dimensions = int(np.count_nonzero(flat > 0.02 * flat[0]))
        return [
            score(
                recording,
                f"{path.stem} ({dimensions}D)",
                m,
                n_frames=recording.n_frames,
                seed=0,
                dimensions=dimensions,
            )
            for m in methods
        ]


def score(
    recording: anisomap.Recording,
    name: str,
    method: str,
    *,
    n_frames: int,
    seed: int,
    dimensions: int,
) -> Result:
    """Score the map of the first frames of a recording; NaN where it cannot be reconstructed."""
    beginning = anisomap.Recording(recording.readings[:n_frames], positions=recording.positions)
    try:
        made = anisomap.reconstruct(beginning, method, dimensions)
        expected = anisomap.confidence(made, beginning)
        truth = np.asarray(recording.positions)
        r = anisomap.score(made, truth, permutations=0).mantel.r
    except anisomap.InputError:
        return Result(name, n_frames, seed, method, math.nan, math.nan, 0.0)
    share = float(np.mean(made.component == 0))
    return Result(name, n_frames, seed, method, r, expected, share)


def tables(results: Sequence[Result]) -> list[str]:
    """Return tables of mean and worst scores and mean paired error ratios, one per length."""
    methods = list(dict.fromkeys(result.method for result in results))
    lines = []
    simulated = [result for result in results if result.seed]
    groups = [
        *((f"{n:,} frames", [r for r in simulated if r.n_frames == n]) for n in FRAMES),
        ("Recordings", [r for r in results if not r.seed]),
    ]
    for title, group in groups:
        if not group:
            continue
        header = ["recording", "seeds", *methods]
        header += [f"{m}: error ratio" for m in methods if m != REFERENCE]
        header.append("share placed")
        lines += [f"### {title}", "", row(header), row(["---"] * len(header))]
        for name in dict.fromkeys(result.recording for result in group):
            lines.append(row(cells(name, [r for r in group if r.recording == name], methods)))
        lines.append("")
    return lines


def cells(name: str, group: Sequence[Result], methods: Sequence[str]) -> list[str]:
    """Return the cells of one row; a recording without a map counts as 0."""
    scores = {
        m: {(q.n_frames, q.seed): np.nan_to_num(q.mantel_r) for q in group if q.method == m}
        for m in methods
    }
    found = [name, str(len(scores[methods[0]]))]
    for paired in scores.values():
        values = np.array(list(paired.values()))
        found.append(f"{values.mean():.3f} ({values.min():.3f})")
    reference = scores.get(REFERENCE, {})
    for method, paired in scores.items():
        if method != REFERENCE and reference:
            ratios = [(1 - r) / (1 - reference[which]) for which, r in paired.items()]
            found.append(f"{np.mean(ratios):.2f}")
    return [*found, f"{min(q.share_placed for q in group):.0%}"]


def calibration(results: Sequence[Result]) -> list[str]:
    """Return a table of Mantel r by confidence."""
    judged = [r for r in results if math.isfinite(r.confidence) and math.isfinite(r.mantel_r)]
    edges = (0.0, 0.8, 0.9, 0.95, 0.97, 0.98, 0.99, 1.01)
    header = ["confidence", "maps", "Mantel r: median", "10 %", "90 %", "below 0.9"]
    lines = ["### Confidence", "", row(header), row(["---"] * len(header))]
    for low, high in itertools.pairwise(edges):
        r = np.array([q.mantel_r for q in judged if low <= q.confidence < high])
        if r.size:
            tenth, median, ninetieth = np.quantile(r, (0.1, 0.5, 0.9))
            figures = (
                f"{median:.3f}",
                f"{tenth:.3f}",
                f"{ninetieth:.3f}",
                f"{np.mean(r < 0.9):.0%}",
            )
            lines.append(row([f"{low:.2f} to {min(high, 1):.2f}", str(r.size), *figures]))
    return lines


def row(texts: Iterable[str]) -> str:
    """Format a row of a Markdown table."""
    return f"| {' | '.join(texts)} |"


def write_csv(results: Sequence[Result], path: Path) -> None:
    """Write all scores."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow([field.name for field in fields(Result)])
        table.writerows(astuple(result) for result in results)


def draw(results: Sequence[Result], path: Path) -> None:
    """Draw the error of every method against the length of the recording."""
    colours = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
    figure = Figure(figsize=(11, 6), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True)
    for (body, scenario), axes in zip(SCENARIOS, panels.flat, strict=True):
        name = f"{body}, {scenario}"
        for method, colour in zip(dict.fromkeys(r.method for r in results), colours, strict=False):
            errors = np.array(
                [
                    np.nanquantile(
                        [
                            1 - r.mantel_r
                            for r in results
                            if (r.recording, r.n_frames, r.method) == (name, n, method)
                        ],
                        (0, 0.5, 1),
                    )
                    for n in FRAMES
                ]
            )
            axes.loglog(FRAMES, errors[:, 1], "o-", color=colour, label=method, linewidth=1.5)
            axes.fill_between(FRAMES, errors[:, 0], errors[:, 2], color=colour, alpha=0.15)
        axes.set_title(name, fontsize=10)
        axes.set_xticks(FRAMES, [f"{n:,}" for n in FRAMES])
        axes.minorticks_off()
        axes.grid(visible=True, alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("frames")
    for axes in panels[:, 0]:
        axes.set_ylabel("1 - Mantel r")
    panels[0, 0].legend(fontsize=8)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
