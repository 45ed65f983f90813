"""Tables of the accuracy of methods on simulated skins."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from anisomap.comparison import RIVALS
from anisomap.methods import DEFAULT_METHOD

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


def tables(results: Sequence[Result]) -> str:
    """Return tables of mean and worst scores of simulated skins, one per length, and the losses."""
    methods = list(dict.fromkeys(result.method for result in results))
    lines, losses = [], []
    for n_frames in sorted({result.n_frames for result in results}):
        group = [result for result in results if result.n_frames == n_frames]
        header = ["skin", "seeds", *methods, "error ratio", "scored"]
        lines += [f"### {n_frames:,} frames", "", row(header), row(["---"] * len(header))]
        for name in dict.fromkeys(result.recording for result in group):
            found = [result for result in group if result.recording == name]
            lines.append(row(cells(name, found, methods)))
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


def columns(methods: Sequence[str]) -> list[str]:
    """Return the columns of `summary`."""
    return ["skin", "seeds", *methods, "best stock", "best stock r", "margin"]


def summary(results: Sequence[Result], n_frames: int) -> str:
    """Return mean and worst scores of one length as CSV, for documents."""
    methods = list(dict.fromkeys(result.method for result in results))
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns(methods))
    chosen = [result for result in results if result.n_frames == n_frames]
    for name in dict.fromkeys(result.recording for result in chosen):
        found = scores([q for q in chosen if q.recording == name], methods)
        stock, margin = best(found, stock=True), "-"
        if stock and DEFAULT_METHOD in found:
            own, other = (np.mean(list(found[m].values())) for m in (DEFAULT_METHOD, stock))
            margin = f"{own - other:+.3f}"
        table.writerow(
            [
                name,
                len(found[methods[0]]),
                *(mean_and_worst(r.values()) for r in found.values()),
                stock or "-",
                mean_and_worst(found[stock].values()) if stock else "-",
                margin,
            ]
        )
    return text.getvalue()


def row(texts: Iterable[str]) -> str:
    """Format a row of a Markdown table."""
    return f"| {' | '.join(texts)} |"
