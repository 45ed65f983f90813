"""Accuracy of the maps of every method, stock methods included.

All methods map the scenarios of the paper in several lengths, others in one, on seeds that were not
used for tuning, and the recordings in folders. (The covariogram method was tuned on seeds 101 to
105, its gates also on 301 to 455.) All maps of a recording are scored on the same sensors. The
output is tables in Markdown and CSV, all scores of simulated skins as CSV, and a figure of their
errors against the length of the recording. Three seeds take six minutes of processor time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

import anisomap
from anisomap.base import DEFAULT_METHOD
from anisomap.method.named import METHODS
from benchmarks.accuracy.compare import COMPARED, Comparison, compare_methods, to_csv, to_markdown
from benchmarks.accuracy.rivals import RIVALS
from benchmarks.harness import (
    COLOURS,
    files_in,
    frame,
    markdown_table,
    measured,
    options,
    write_rows,
)
from benchmarks.skins.corrections import read_corrected

SCENARIOS = (
    ("sphere", "bombardment"),
    ("cylinder", "bombardment"),
    ("y-shape", "bombardment"),
    ("plane", "bombardment"),
    ("sphere", "locomotion"),
    ("cylinder", "locomotion"),
)
OTHERS = (("hand", "bombardment"), ("hexagon", "rubbing"), ("cylinder", "rubbing"))
FRAMES = (500, 2000, 8000)
TABLED = 2000
"""Frames of the maps in the table, and of other scenarios."""

REFERENCE = "r-anisomap"
TOLERANCE = 0.003  # a difference of Mantel r that is not visible on a map
METHOD_NAMES = (DEFAULT_METHOD, "r-anisomap", "spearman-anisomap", *RIVALS)


@dataclass(frozen=True)
class Result:
    """Score of one map."""

    recording: str
    n_frames: int
    seed: int
    method: str
    mantel_r: float
    rms_in_spacings: float
    share_placed: float
    share_scored: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Reconstruct all maps and write the results."""
    parser = options(__doc__, "quality", seeds=3, workers=True)
    parser.add_argument("--methods", nargs="+", default=METHOD_NAMES, choices=(*METHODS, *RIVALS))
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    files = files_in(chosen.recordings)
    real = measured(score_file, files, chosen.workers)
    methods = tuple(chosen.methods)
    skins = [
        (body, scenario, FRAMES if (body, scenario) in SCENARIOS else (TABLED,), seed, methods)
        for seed in range(1, chosen.seeds + 1)
        for body, scenario in SCENARIOS + OTHERS
    ]
    write(chosen.output, real, measured(score_simulation, skins, chosen.workers))


def write(folder: Path, comparisons: Sequence[Comparison], simulated: Sequence[Result]) -> None:
    """Write all tables and the figure, and print the tables."""
    texts = {}
    if comparisons:
        texts["recordings-table.md"] = to_markdown(comparisons)
        texts["recordings.csv"] = to_csv(comparisons)
    if simulated:
        texts["quality-table.md"] = tables(simulated)
        draw(simulated, folder / "quality.png")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        if name.endswith(".md"):
            print(text)
    write_rows(folder / "quality.csv", simulated, digits=4)


def score_simulation(
    skin: tuple[str, str, Sequence[int], int, tuple[str, ...]],
) -> list[Result]:
    """Score maps of one simulated recording, truncated to several lengths, in 3D."""
    body, scenario, lengths, seed, methods = skin
    whole = anisomap.simulate(body, scenario, n_frames=max(lengths), seed=seed)
    results = []
    for length in lengths:
        beginning = anisomap.Recording(whole.readings[:length], positions=whole.positions)
        compared = compare_methods(beginning, methods, 3, name=f"{body}, {scenario}", seed=seed)
        results += [
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
    return results


def score_file(path: Path) -> list[Comparison]:
    """Score maps of a recording with known positions, in as many dimensions as these span."""
    try:
        compared = compare_methods(read_corrected(path), COMPARED, name=path.stem)
    except anisomap.AnisomapError as error:
        print(f"skipped {path.name}: {error}")
        return []
    scores = tuple(replace(s, sensor_map=None) for s in compared.scores)
    return [replace(compared, scores=scores)]


def tables(results: Sequence[Result]) -> str:
    """Return a table of mean and worst scores of skins of `TABLED` frames, and all losses."""
    every = frame(results).fillna({"mantel_r": 0.0})  # a map without a score counts as 0
    methods = list(every.method.unique())
    rows, losses, n_rows = [], [], 0
    for (name, n_frames), group in every.groupby(["recording", "n_frames"], sort=False):
        r = group.pivot(index="seed", columns="method", values="mantel_r")[methods]
        if n_frames == TABLED:
            rows.append((name, *cells(r), f"{group.share_scored.min():.0%}"))
        lost = loss(r)
        losses += [f"{name}, {n_frames:,} frames ({lost})"] if lost else []
        n_rows += 1
    lines = [*markdown_table(["skin", *methods, "error ratio", "scored"], rows), ""]
    if DEFAULT_METHOD in methods and any(method in RIVALS for method in methods):
        named = f": {'; '.join(losses)}" if losses else ""
        lines.append(
            f"On average over the seeds, a stock method is better than {DEFAULT_METHOD} on "
            f"{len(losses)} of {n_rows} skins and lengths{named}."
        )
    if DEFAULT_METHOD in methods and REFERENCE in methods:
        runs = ["recording", "n_frames", "seed"]
        r = every.pivot(index=runs, columns="method", values="mantel_r")
        lost = r[REFERENCE] - r[DEFAULT_METHOD]
        worse = lost[lost > TOLERANCE]
        most = f", by at most {worse.max():.3f}" if len(worse) else ""
        lines += [
            "",
            (
                f"Maps by {DEFAULT_METHOD} that are worse than those by {REFERENCE} by more than "
                f"{TOLERANCE}: {len(worse)} of {lost.count()}{most}."
            ),
        ]
    return "\n".join(lines) + "\n"


def best(r: Any, *, stock: bool) -> str:
    """Return the stock method, or the method of anisomap, with the largest mean; empty if none."""
    means = r[[m for m in r if (m in RIVALS) is stock]].mean()
    return str(means.idxmax()) if len(means) else ""


def cells(r: Any) -> list[str]:
    """Return the cells of one row; the best method of anisomap and the best stock one are bold.

    r: Mantel r by seed and method.
    """
    bold = {best(r, stock=True), best(r, stock=False)}
    texts = [f"{r[m].mean():.3f} ({r[m].min():.3f})" for m in r]
    ratio = "-"
    if REFERENCE in r and DEFAULT_METHOD in r:
        ratio = f"{((1 - r[DEFAULT_METHOD]) / (1 - r[REFERENCE])).mean():.2f}"
    marked = (f"**{text}**" if m in bold else text for m, text in zip(r, texts, strict=True))
    return [*marked, ratio]


def loss(r: Any) -> str:
    """Compare the default method with the best stock method; empty if it is not worse."""
    stock = best(r, stock=True)
    if not stock or DEFAULT_METHOD not in r:
        return ""
    own, other = r[DEFAULT_METHOD].mean(), r[stock].mean()
    return f"{own:.3f} against {other:.3f} of {stock}" if round(own - other, 3) < 0 else ""


def draw(results: Sequence[Result], path: Path) -> None:
    """Draw the error of every method against the length of the recording.

    Lines are medians over the seeds, dashed for stock methods; bands reach from the best to the
    worst seed of the other methods.
    """
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    scored = frame(results).dropna(subset="mantel_r")
    looks = dict(zip(scored.method.unique(), cycle(COLOURS), strict=False))
    for (body, scenario), axes in zip(SCENARIOS, panels.flat, strict=True):
        name = f"{body}, {scenario}"
        for method, group in scored[scored.recording == name].groupby("method", sort=False):
            errors = (1 - group.mantel_r).groupby(group.n_frames).quantile([0, 0.5, 1]).unstack()
            style, look = "s--" if method in RIVALS else "o-", {"color": looks[method]}
            axes.loglog(errors.index, errors[0.5], style, label=method, lw=1.5, ms=4, **look)
            if method not in RIVALS:
                axes.fill_between(errors.index, errors[0.0], errors[1.0], alpha=0.15, **look)
        axes.set_title(name, fontsize=10)
        axes.set_xticks(FRAMES, [f"{n:,}" for n in FRAMES])
        axes.minorticks_off()
        axes.grid(visible=True, alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("frames")
    for axes in panels[:, 0]:
        axes.set_ylabel("1 - Mantel r")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
