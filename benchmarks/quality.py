"""Accuracy of the maps of every method, stock methods included (``make quality``).

All methods map all scenarios of the paper, on seeds that were not used for tuning, and the
recordings in folders. (The covariogram method was tuned on seeds 101 to 105, its gates also on
301 to 455.) All maps of a recording are scored on the same sensors. The output is tables in
Markdown and CSV, all scores as CSV, and a figure of errors against the length of the recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import anisomap
from anisomap.cli.commands import comparison as comparison_tables
from anisomap.comparison import COMPARED, RIVALS, Comparison, compare_methods
from anisomap.defaults import DEFAULT_METHOD
from anisomap.methods import METHODS
from benchmarks.harness import COLOURS, files_in, heading, in_parallel, line, options, write_rows

SCENARIOS = (
    ("sphere", "bombardment"),
    ("cylinder", "bombardment"),
    ("y-shape", "bombardment"),
    ("plane", "bombardment"),
    ("sphere", "locomotion"),
    ("cylinder", "locomotion"),
)
FRAMES = (500, 2000, 8000)
REFERENCE = "r-anisomap"
TOLERANCE = 0.003  # a difference of Mantel r that is not visible on a map


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
    parser = options(__doc__, "quality", seeds=10, workers=True)
    parser.add_argument("--methods", nargs="+", default=METHOD_NAMES, choices=(*METHODS, *RIVALS))
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    files = files_in(chosen.recordings)
    real = [found for rows in in_parallel(score_file, files, chosen.workers) for found in rows]
    skins = [
        (body, scenario, frames, seed, tuple(chosen.methods))
        for seed in range(1, chosen.seeds + 1)
        for (body, scenario), frames in (
            *((which, FRAMES) for which in SCENARIOS),
            *((which, (DEFAULT_FRAMES,)) for which in MORE_SCENARIOS if seed <= 3),
        )
    ]
    simulated = [q for rows in in_parallel(score_simulation, skins, chosen.workers) for q in rows]
    write(
        chosen.output,
        [compared for compared, _ in real],
        [row for _, rows in real for row in rows],
        simulated,
    )


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
        texts["quality-table.md"] = tables(simulated)
        draw(simulated, folder / "quality.png")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        if name.endswith(".md"):
            print(text)
    write_rows(folder / "quality.csv", [*real, *simulated])


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
        results += all_scores(compared, seed)
    return results


def score_file(path: Path) -> list[tuple[Comparison, list[Result]]]:
    """Score maps of a recording with known positions, in as many dimensions as these span."""
    try:
        compared = compare_methods(anisomap.read(path), COMPARED, name=path.stem)
    except anisomap.AnisomapError as error:
        print(f"skipped {path.name}: {error}")
        return []
    scores = tuple(replace(s, sensor_map=None) for s in compared.scores)
    return [(replace(compared, scores=scores), all_scores(compared, 0))]


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


def tables(results: Sequence[Result]) -> str:
    """Return tables of mean and worst scores of simulated skins, one per length, and the losses."""
    methods = list(dict.fromkeys(result.method for result in results))
    lines, losses = [], []
    for n_frames in sorted({result.n_frames for result in results}):
        group = [result for result in results if result.n_frames == n_frames]
        header = ["skin", "seeds", *methods, "error ratio", "scored"]
        lines += [f"### {n_frames:,} frames", "", *heading(header)]
        for name in dict.fromkeys(result.recording for result in group):
            found = [result for result in group if result.recording == name]
            lines.append(line(cells(name, found, methods)))
            lost = loss(found, methods)
            losses += [f"{name}, {n_frames:,} frames ({lost})"] if lost else []
        lines.append("")
    if DEFAULT_METHOD in methods and any(method in RIVALS for method in methods):
        n_rows = len({(result.recording, result.n_frames) for result in results})
        named = f": {'; '.join(losses)}" if losses else ""
        lines.append(
            f"On average over the seeds, a stock method is better than {DEFAULT_METHOD} on "
            f"{len(losses)} of {n_rows} rows{named}."
        )
    if DEFAULT_METHOD in methods and REFERENCE in methods:
        lines += ["", worse_maps(results)]
    return "\n".join(lines) + "\n"


def worse_maps(results: Sequence[Result]) -> str:
    """Count the maps that are worse by the default method than by the reference."""
    r = {
        m: {
            (q.recording, q.n_frames, q.seed): float(np.nan_to_num(q.mantel_r))
            for q in results
            if q.method == m
        }
        for m in (DEFAULT_METHOD, REFERENCE)
    }
    losses = [r[REFERENCE][which] - own for which, own in r[DEFAULT_METHOD].items()]
    worse = [lost for lost in losses if lost > TOLERANCE]
    most = f", by at most {max(worse):.3f}" if worse else ""
    return (
        f"Maps by {DEFAULT_METHOD} that are worse than those by {REFERENCE} by more than "
        f"{TOLERANCE}: {len(worse)} of {len(losses)}{most}."
    )


def scores(group: Sequence[Result], methods: Sequence[str]) -> dict[str, dict[int, float]]:
    """Return Mantel r by method and seed; a recording without a score counts as 0."""
    return {
        m: {q.seed: 0.0 if math.isnan(q.mantel_r) else q.mantel_r for q in group if q.method == m}
        for m in methods
    }


def best(found: Mapping[str, Mapping[int, float]], *, stock: bool) -> str:
    """Return the stock method, or the method of anisomap, with the largest mean; empty if none."""
    means = {m: np.mean(list(r.values())) for m, r in found.items() if (m in RIVALS) is stock}
    return max(means, key=lambda m: means[m], default="")


def mean_and_worst(values: Iterable[float]) -> str:
    """Format the mean, and the smallest value in brackets."""
    known = np.array(list(values))
    return f"{known.mean():.3f} ({known.min():.3f})"


def cells(name: str, group: Sequence[Result], methods: Sequence[str]) -> list[str]:
    """Return the cells of one row; the best method of anisomap and the best stock one are bold."""
    found = scores(group, methods)
    bold = {best(found, stock=True), best(found, stock=False)}
    texts = {m: mean_and_worst(r.values()) for m, r in found.items()}
    ratio = "-"
    if REFERENCE in found and DEFAULT_METHOD in found:
        reference, own = found[REFERENCE], found[DEFAULT_METHOD]
        ratio = f"{np.mean([(1 - r) / (1 - reference[seed]) for seed, r in own.items()]):.2f}"
    return [
        name,
        str(len(found[methods[0]])),
        *(f"**{text}**" if m in bold else text for m, text in texts.items()),
        ratio,
        f"{min(q.share_scored for q in group):.0%}",
    ]


def loss(group: Sequence[Result], methods: Sequence[str]) -> str:
    """Compare the default method with the best stock method; empty if it is not worse."""
    found = scores(group, methods)
    stock = best(found, stock=True)
    if not stock or DEFAULT_METHOD not in found:
        return ""
    own, other = (np.mean(list(found[m].values())) for m in (DEFAULT_METHOD, stock))
    return f"{own:.3f} against {other:.3f} of {stock}" if round(own - other, 3) < 0 else ""


def draw(results: Sequence[Result], path: Path) -> None:
    """Draw the error of every method against the length of the recording.

    Lines are medians over the seeds, dashed for stock methods; bands reach from the best to the
    worst seed of the other methods.
    """
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True)
    scored = [r for r in results if not math.isnan(r.mantel_r)]
    looks = dict(zip(dict.fromkeys(r.method for r in scored), cycle(COLOURS), strict=False))
    for (body, scenario), axes in zip(SCENARIOS, panels.flat, strict=True):
        name = f"{body}, {scenario}"
        for method, colour in looks.items():
            chosen = [r for r in scored if (r.recording, r.method) == (name, method)]
            draw_method(axes, chosen, method, colour)
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


def draw_method(axes: Axes, results: Sequence[Result], method: str, colour: str) -> None:
    """Draw the errors of one method in one scenario."""
    lengths = sorted({r.n_frames for r in results})
    if not lengths:
        return
    errors = np.array(
        [
            np.quantile([1 - r.mantel_r for r in results if r.n_frames == n], (0, 0.5, 1))
            for n in lengths
        ]
    )
    style = "s--" if method in RIVALS else "o-"
    axes.loglog(lengths, errors[:, 1], style, color=colour, label=method, linewidth=1.5, ms=4)
    if method not in RIVALS:
        axes.fill_between(lengths, errors[:, 0], errors[:, 2], color=colour, alpha=0.15)


if __name__ == "__main__":
    main()
