"""Verdicts on maps of recordings that nobody tuned on (``make trust``).

Maps at least 500 recordings with known positions by the default method: all bodies, stimuli and
faults, from 100 to 8,000 frames, and real skins. The verdict on each map, which is made without the
positions, is compared with the error of the map. Verdicts were tuned on seeds 1 to 300 and 2001
to 2038; seeds from 3001 on are used here. The output is a table in Markdown, a scatter picture, and
all results with all evidence as CSV. A run that was interrupted continues where it stopped.
"""

from __future__ import annotations

import csv
import logging
import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import KDTree
from scipy.stats import chi2

import anisomap
from anisomap.diagnosis import judge
from anisomap.diagnosis.diagnostics import examine
from anisomap.evaluation import align, median_spacing
from anisomap.reconstruction import reconstruct_with_stages
from anisomap.usability import ACCURACY
from benchmarks.harness import (
    columns,
    heading,
    in_parallel,
    line,
    markdown_table,
    options,
    quietly,
    write_csv,
)
from benchmarks.other_skins import cases_of_other
from benchmarks.trust_recordings import Case, cases_of_file, cases_of_seed

FIRST_SEED = 3001
SEEDS = 130
"""Number of seeds; each gives four recordings."""

FACTS = (
    "sensors", "frames", "dimensions", "cpu map", "cpu verdict",
    "repeatability", "difference", "region", "inside", "placed",
    *(name for name in ACCURACY if name != "repeatability"),
)  # fmt: skip
"""Columns of the evidence, and of what follows from it."""

REGION, MIN_REGION = 5.0, 6
"""Radius of a region in spacings, and sensors of the smallest one."""

REFUSED = "refused"
"""Level of a recording of which no map is made."""


MIN_R, MAX_ERROR = 0.9, 1.0
"""A map with a smaller Mantel r, or a larger error in spacings, must not be called usable."""

GOOD_R, GOOD_ERROR = 0.97, 0.5
"""A map with at least this r, and a smaller error in spacings, should not be called not usable."""

LEVELS = ("usable", "usable for neighbours", "not usable", "cannot tell", "refused")


_LOOKS = (("#0072B2", "o"), ("#E69F00", "s"), ("#D55E00", "x"))


@dataclass(frozen=True)
class Outcome:
    """A verdict, and the truth about the map.

    source: Seed or file; group, kind: See `Case`; expected: Error in spacings.
    r, error, kept: Mantel r, RMS error in spacings, and share of neighbours kept.
    evidence: What the verdict follows from, and properties of the recording.
    """

    NUMBERS: ClassVar = ("expected", "r", "error", "kept")

    source: str
    name: str
    group: str
    kind: str
    fault: str
    level: str
    expected: float
    r: float
    error: float
    kept: float
    reasons: str
    evidence: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_bad(self) -> bool:
        """Whether the map is too wrong to be called usable."""
        return self.r < MIN_R or self.error > MAX_ERROR

    @property
    def is_good(self) -> bool:
        """Whether the map is too good to be called not usable."""
        return self.r >= GOOD_R and self.error < GOOD_ERROR

    @property
    def is_false_reassurance(self) -> bool:
        """Whether a bad map is called usable."""
        return self.is_bad and self.level == "usable"

    @property
    def is_false_alarm(self) -> bool:
        """Whether a good map is called not usable."""
        return self.is_good and self.level == "not usable"


FIXED = columns(Outcome)[:-1]
"""Columns before those of the evidence."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings and write the results."""
    parser = options(__doc__, "trust", seeds=SEEDS, first_seed=FIRST_SEED, workers=True)
    parser.add_argument(
        "--shard", default="1/1", help="such as 2/3: the second third of the seeds and files"
    )
    parser.add_argument("--cases", help="only recordings whose name contains this text")
    chosen = parser.parse_args(arguments)
    part, parts = (int(text) for text in chosen.shard.split("/"))
    # Real skins first: the largest take minutes, and would keep one process busy at the end.
    files = [path for folder in chosen.recordings for path in folder.glob("*.npz")]
    every: list[int | Path | str] = [*sorted(files, key=lambda path: -path.stat().st_size)]
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    last = chosen.first_seed + 3 * chosen.seeds
    every += [*seeds, *(f"other-{seed}" for seed in range(chosen.first_seed, last))]
    path = chosen.output / "trust.csv"
    outcomes = read_outcomes(path) if path.exists() else []
    done = {outcome.source for outcome in outcomes}
    todo = [source for source in every[part - 1 :: parts] if str(source_name(source)) not in done]
    judge_all = partial(outcomes_of, folder=chosen.output / "recordings", chosen=chosen.cases)
    for found in in_parallel(judge_all, todo, chosen.workers, ordered=False):
        outcomes += found
        write_outcomes(outcomes, path)
    text = table(outcomes)
    (chosen.output / "trust-table.md").write_text(text, encoding="utf-8")
    draw(outcomes, chosen.output / "trust.png")
    print(text)


def source_name(source: int | Path | str) -> str:
    """Return the seed or the name of a file."""
    return source.stem if isinstance(source, Path) else str(source)


def outcomes_of(source: int | Path | str, folder: Path, chosen: str | None = None) -> list[Outcome]:
    """Map all recordings of a seed or of a file."""
    logging.getLogger("anisomap").setLevel(logging.ERROR)
    cases: Iterable[Case]
    if isinstance(source, Path):
        cases = cases_of_file(source)
    elif isinstance(source, str):
        cases = cases_of_other(int(source.removeprefix("other-")))
    else:
        cases = cases_of_seed(source, folder)
    return [
        judged(case, source_name(source)) for case in cases if not chosen or chosen in case.name
    ]


def judged(case: Case, source: str = "") -> Outcome:
    """Map a recording, and compare the verdict on the map with its error."""
    recording = case.recording
    of_case = (source, case.name, case.group, case.kind, case.fault)
    facts = {
        "sensors": float(recording.n_sensors),
        "frames": float(recording.n_frames),
        "dimensions": float(case.dimensions),
    }
    with quietly():
        try:
            begun = time.process_time()
            made, stages = reconstruct_with_stages(recording, dimensions=case.dimensions)
            mapped = time.process_time()
            faults = anisomap.find_faults(recording)
            evidence, covariances = examine(made, [recording], faults=faults, stages=stages)
            verdict = judge(evidence)
            facts["cpu map"] = mapped - begun
            facts["cpu verdict"] = time.process_time() - mapped
            truth = np.asarray(recording.positions)
            scored = anisomap.score(made, truth, permutations=0)
        except anisomap.InputError as error:
            nan = math.nan
            return Outcome(*of_case, REFUSED, nan, nan, nan, nan, str(error), facts)
    facts |= {
        "repeatability": evidence.repeatability,
        "difference": evidence.difference,
        "region": region_error(made, truth),
        "inside": share_inside(made, covariances, truth),
        "placed": float(np.mean(made.component == 0)),
    }
    facts |= {name: getattr(verdict, name) for name in ACCURACY}
    scores = (scored.mantel.r, scored.rms_in_spacings, scored.neighbours_kept)
    reasons = "; ".join(verdict.reasons)
    return Outcome(*of_case, verdict.level, verdict.expected_error, *scores, reasons, facts)


def region_error(made: anisomap.SensorMap, truth: np.ndarray) -> float:
    """Return the RMS error of regions of 5 spacings, each aligned by itself, in spacings."""
    largest = made.component == 0
    points, true = made.positions[largest], truth[largest]
    spacing = median_spacing(true)
    near = KDTree(true).query_ball_point(true, REGION * spacing)
    regions = [one for one in near if len(one) >= MIN_REGION]
    if not regions:
        return math.nan
    errors = [align(points[one], true[one]).rms for one in regions]
    return float(np.sqrt(np.mean(np.square(errors)))) / spacing


def share_inside(
    made: anisomap.SensorMap, covariances: np.ndarray | None, truth: np.ndarray
) -> float:
    """Return the share of true positions inside the ellipses of 95 % of a map."""
    known = made.component == 0
    if covariances is None or not np.isfinite(covariances[known]).all():
        return math.nan
    k = made.dimensions
    aligned = align(truth[known], made.positions[known]).aligned
    apart = aligned[:, :k] - made.positions[known]
    distances = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(covariances[known]), apart)
    distances += np.square(aligned[:, k:]).sum(axis=1) / np.median(covariances[known][:, 0, 0])
    return float(np.mean(distances < chi2.ppf(0.95, k)))


def write_outcomes(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write all outcomes; columns of evidence follow the others."""
    evidence = list(dict.fromkeys([*FACTS, *(name for one in outcomes for name in one.evidence)]))
    rows = ([*astuple(one)[:-1], *(one.evidence.get(n, "") for n in evidence)] for one in outcomes)
    write_csv(path, [*FIXED, *evidence], rows)


def read_outcomes(path: Path) -> list[Outcome]:
    """Read the outcomes of an earlier run."""
    outcomes = []
    with path.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            fixed: dict[str, Any] = {name: row.pop(name) for name in FIXED}
            fixed |= {name: float(fixed[name]) for name in Outcome.NUMBERS}
            evidence = {name: float(text) for name, text in row.items() if text}
            outcomes.append(Outcome(**fixed, evidence=evidence))
    return outcomes


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the results in Markdown: figures, levels by quality, and all failures by name."""
    mapped = [one for one in outcomes if not math.isnan(one.r)]
    bad = [one for one in mapped if one.is_bad]
    good = [one for one in mapped if one.is_good]
    reassured = [one for one in mapped if one.is_false_reassurance]
    alarms = [one for one in mapped if one.is_false_alarm]
    ratios = ratios_of(mapped)
    cost = [
        one.evidence["cpu verdict"] / one.evidence["cpu map"]
        for one in mapped
        if one.evidence.get("cpu map", 0) > 0
    ]
    seeds = [int(one.source) for one in outcomes if one.source.isdecimal()]
    groups = Counter(one.group for one in outcomes)
    rows: list[tuple[object, ...]] = [("recordings", len(outcomes), "at least 500")]
    if seeds:
        rows.append((f"of simulated skins, seeds {min(seeds)} to {max(seeds)}", len(seeds), ""))
    if groups["other"]:
        rows.append(("of the second simulator", groups["other"], ""))
    if groups["real"]:
        rows.append(("of real skins, which were seen during development", groups["real"], ""))
    share = len(alarms) / max(1, len(good))
    rows += [
        ("maps", len(mapped), ""),
        (f"false reassurance: called usable, but r < {MIN_R} or error > {MAX_ERROR:g} spacing",
         f"{len(reassured)} of {len(bad)}", "none"),
        (f"false alarm: called not usable, but r >= {GOOD_R} and error < {GOOD_ERROR:g} spacing",
         f"{len(alarms)} of {len(good)} ({share:.1%})", "at most 5 %"),
    ]  # fmt: skip
    if ratios.size:
        within = np.mean((ratios >= 1 / 2) & (ratios <= 2))
        rows += [
            ("expected error over true error, median", f"{np.median(ratios):.2f}", "0.67 to 1.5"),
            ("expected error within a factor of 2 of the true error", f"{within:.0%}", ""),
            ("true error above the expected", f"{np.mean(ratios < 1):.0%}", ""),
        ]
    if cost:
        what = "CPU time of the search for faults and the verdict over that of the map, median"
        rows.append((what, f"{np.median(cost):.1f}", ""))
    lines = markdown_table(("figure", "value", "goal"), rows)
    lines += ["", *heading(("maps", "number", *LEVELS[:-1]))]
    between = [one for one in mapped if not one.is_bad and not one.is_good]
    for title, group in (
        (f"good: r >= {GOOD_R}, error < {GOOD_ERROR:g}", good),
        ("between", between),
        (f"bad: r < {MIN_R} or error > {MAX_ERROR:g}", bad),
    ):
        counts = Counter(one.level for one in group)
        cells = [title, str(len(group)), *(str(counts[level]) for level in LEVELS[:-1])]
        lines.append(line(cells))
    lines += ["", *by_group(mapped)]
    for title, group in (("False reassurance", reassured), ("False alarms", alarms)):
        lines += ["", f"{title}: {'none' if not group else ''}".rstrip()]
        lines += [""] if group else []
        lines += [
            f"- {one.name}: r {one.r:.3f}, error {one.error:.2f}, expected {one.expected:.2f}"
            for one in sorted(group, key=lambda one: one.r)
        ]
    return "\n".join(lines) + "\n"


def ratios_of(outcomes: Iterable[Outcome]) -> np.ndarray:
    """Return expected errors over true ones, where both are known."""
    known = (one for one in outcomes if math.isfinite(one.expected) and one.error > 0)
    return np.array([one.expected / one.error for one in known])


def by_group(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the lines of a table of how well errors are expected, by group of recordings."""
    lines = heading(
        (
            "recordings", "maps", "expected / true error, median", "within 1.5", "within 2",
            "true error in its interval", "true positions in ellipses of 95 %",
        )
    )  # fmt: skip
    names = {
        "simulated": "simulated", "other": "second simulator", "real": "real skins",
    }  # fmt: skip
    for name, title in names.items():
        for damaged in (False, True):
            group = [
                one
                for one in outcomes
                if one.group == name and bool(one.fault) == damaged and math.isfinite(one.expected)
            ]
            if not group:
                continue
            ratios = ratios_of(group)
            apart = np.abs(np.log(ratios))
            held = [
                one.evidence.get("expected_error_low", 0.0)
                <= one.error
                <= one.evidence.get("expected_error_high", math.inf)
                for one in group
            ]
            shares = [one.evidence.get("inside", math.nan) for one in group]
            known = [share for share in shares if math.isfinite(share)]
            cells = (
                f"{title}, with a fault" if damaged else title,
                len(group),
                f"{np.median(ratios):.2f}",
                *(f"{np.mean(apart < math.log(limit)):.0%}" for limit in (1.5, 2)),
                f"{np.mean(held):.0%}",
                f"{np.mean(known):.0%}" if known else "-",
            )
            lines.append(line(cells))
    return lines


def draw(outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw expected against true errors, coloured by level."""
    figure = Figure(figsize=(6, 5.5), layout="constrained")
    axes = figure.subplots()
    for level, (colour, marker) in zip(LEVELS, _LOOKS, strict=False):
        chosen = [one for one in outcomes if one.level == level and math.isfinite(one.expected)]
        axes.scatter(
            [one.error for one in chosen],
            [one.expected for one in chosen],
            s=14,
            color=colour,
            marker=marker,
            alpha=0.6,
            linewidths=0.8,
            label=f"{level} ({len(chosen)})",
        )
    ends = np.array([0.03, 30])
    axes.plot(ends, ends, color="0.4", linewidth=0.8)
    axes.axvline(MAX_ERROR, color="0.7", linewidth=0.8)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=ends,
        ylim=ends,
        aspect="equal",
        xlabel="true RMS error (spacings)",
        ylabel="expected error (spacings)",
    )
    axes.legend(title="verdict")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
