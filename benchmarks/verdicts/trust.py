"""Verdicts on maps of recordings that nobody tuned on.

Maps recordings of two simulators, sound and damaged, noises without any geometry, and real skins by
the default method, and compares the verdict on each map, which is made without the positions, with
the error of the map. The output is a table in Markdown, a scatter picture, and all results with all
evidence as CSV. A run that was interrupted continues where it stopped.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.spatial import KDTree
from scipy.stats import chi2

import anisomap
from anisomap.evaluation import align, median_spacing
from anisomap.map_verdict import ACCURACY
from anisomap.method.pipeline import reconstruct_with_stages
from anisomap.verdict import judge
from anisomap.verdict.chance import MIN_REGION, REGION_RADIUS
from anisomap.verdict.diagnosis import examine
from benchmarks.harness import in_parallel, keyed_table, markdown_table, options, quietly, write_csv
from benchmarks.verdicts.suite import Case, cases_of_file, cases_of_seed

FIRST_SEED = 5001
SEEDS = 60
"""Number of seeds; each gives four recordings."""

COLUMNS = (
    "source", "name", "group", "kind", "damage", "level", "expected", "r", "error", "kept",
    "reasons", "sensors", "frames", "dimensions", "cpu map", "cpu verdict",
    "repeatability", "difference", "metric", "uneven", "regional", "region", "inside", "placed",
    "extent", "agreement", "excluded",
    *(name for name in ACCURACY if name != "repeatability"),
)  # fmt: skip
"""Columns of the results, one row for each recording: verdict, truth, evidence, and what follows.

source: Seed or file; group, kind: See `Case`; expected: Error in spacings; r, error, kept: Mantel
r, RMS error in spacings, and share of neighbours kept; excluded: Whether something else than the
expected error speaks against the map. Of `Measurements`: repeatability to uneven, regional, extent,
and agreement.
"""

REFUSED = "refused"
"""Level of a recording of which no map is made."""

GROUPS = {
    "package": "package's simulator",
    "independent": "independent simulator",
    "noise": "noise without geometry",
    "real": "real skins, which were seen during development",
}
"""Titles of the groups of recordings."""

MIN_R, MAX_ERROR = 0.9, 1.0
"""A map with a smaller Mantel r, or a larger error in spacings, must not be called usable."""

GOOD_R, GOOD_ERROR = 0.97, 0.5
"""A map with at least this r, and a smaller error in spacings, should not be called not usable."""
LEVELS = ("usable", "usable for neighbours", "not usable", "cannot tell")
"""Of maps, in the order of the table; the first three are in the picture."""

_LOOKS = (("#0072B2", "o"), ("#E69F00", "s"), ("#D55E00", "x"))


Outcome: TypeAlias = dict[str, Any]


def is_bad(outcomes: Any) -> Any:
    """Mark maps that are too wrong to be called usable."""
    return (outcomes.r < MIN_R) | (outcomes.error > MAX_ERROR)


def is_good(outcomes: Any) -> Any:
    """Mark maps that are too good to be called not usable."""
    return (outcomes.r >= GOOD_R) & (outcomes.error < GOOD_ERROR)


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings and write the results."""
    parser = options(__doc__, "trust", seeds=SEEDS, first_seed=FIRST_SEED, workers=True)
    parser.add_argument("--cases", help="only recordings whose name contains this text")
    chosen = parser.parse_args(arguments)
    # Real skins first: the largest take minutes, and would keep one process busy at the end.
    files = [path for folder in chosen.recordings for path in folder.glob("*.npz")]
    every: list[int | Path] = [*sorted(files, key=lambda path: -path.stat().st_size)]
    every += range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    path = chosen.output / "trust.csv"
    rows: list[Outcome] = read_outcomes(path).to_dict("records") if path.exists() else []
    done = {row["source"] for row in rows}
    todo = [source for source in every if str(source_name(source)) not in done]
    judge_all = partial(outcomes_of, chosen=chosen.cases)
    for found in in_parallel(judge_all, todo, chosen.workers, ordered=False):
        rows += found
        write_csv(path, COLUMNS, ([row.get(name, "") for name in COLUMNS] for row in rows))
    outcomes = pd.DataFrame(rows, columns=COLUMNS)
    text = table(outcomes)
    (chosen.output / "trust-table.md").write_text(text, encoding="utf-8")
    draw(outcomes, chosen.output / "trust.png")
    print(text)


def source_name(source: int | Path) -> str:
    """Return the seed or the name of a file."""
    return source.stem if isinstance(source, Path) else str(source)


def outcomes_of(source: int | Path, chosen: str | None = None) -> list[Outcome]:
    """Map all recordings of a seed or of a file."""
    logging.getLogger("anisomap").setLevel(logging.ERROR)
    cases: Iterable[Case]
    cases = cases_of_file(source) if isinstance(source, Path) else cases_of_seed(source)
    return [
        judged(case, source_name(source)) for case in cases if not chosen or chosen in case.name
    ]


def judged(case: Case, source: str = "") -> Outcome:
    """Map a recording, and compare the verdict on the map with its error; a row of `COLUMNS`."""
    recording = case.recording
    found: Outcome = {
        "source": source,
        "name": case.name,
        "group": case.group,
        "kind": case.kind,
        "damage": case.damage,
        "sensors": recording.n_sensors,
        "frames": recording.n_frames,
        "dimensions": case.dimensions,
    }
    with quietly():
        try:
            begun = time.process_time()
            made, stages = reconstruct_with_stages(recording, dimensions=case.dimensions)
            mapped = time.process_time()
            faults = anisomap.find_faults(recording)
            evidence, covariances = examine(made, recording, faults=faults, stages=stages)
            verdict = judge(evidence)
            judged = time.process_time()
            found |= {"level": verdict.level, "reasons": "; ".join(verdict.reasons)}
            if recording.positions is None:
                return found
            truth = recording.positions
            scored = anisomap.score(made, truth, permutations=0)
        except anisomap.InputError as error:
            return found | {"level": REFUSED, "reasons": str(error)}
    return found | {
        "expected": verdict.expected_error,
        "r": scored.mantel.r,
        "error": scored.rms_in_spacings,
        "kept": scored.neighbours_kept,
        "cpu map": mapped - begun,
        "cpu verdict": judged - mapped,
        "repeatability": evidence.repeatability,
        "difference": evidence.difference,
        "metric": evidence.metric,
        "uneven": int(evidence.uneven),
        "regional": evidence.regional,
        "region": region_error(made, truth),
        "inside": share_inside(made, covariances, truth),
        "extent": evidence.extent,
        "agreement": evidence.agreement,
        "excluded": int(bool(evidence.ruining or evidence.unseen)),
        "placed": float(np.mean(made.component == 0)),
        **{name: getattr(verdict, name) for name in ACCURACY},
    }


def region_error(made: anisomap.SensorMap, truth: np.ndarray) -> float:
    """Return the RMS error of regions of 5 spacings, each aligned by itself, in spacings."""
    largest = made.component == 0
    points, true = made.positions[largest], truth[largest]
    spacing = median_spacing(true)
    near = KDTree(true).query_ball_point(true, REGION_RADIUS * spacing)
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


def read_outcomes(path: Path) -> Any:
    """Read the results of an earlier run, a data frame with `COLUMNS`; NaN where it lacks one."""
    texts = ["source", "name", "group", "kind", "damage", "level", "reasons"]
    found = pd.read_csv(path, dtype=dict.fromkeys(texts, str)).reindex(columns=list(COLUMNS))
    return found.fillna(dict.fromkeys(texts, ""))


def table(outcomes: Any) -> str:
    """Return the results in Markdown: figures, levels by quality, and all failures by name."""
    mapped = outcomes[outcomes.r.notna()]
    bad, good = mapped[is_bad(mapped)], mapped[is_good(mapped)]
    reassured, alarms = bad[bad.level == "usable"], good[good.level == "not usable"]
    ratios = ratios_of(mapped)
    cost = (mapped["cpu verdict"] / mapped["cpu map"])[mapped["cpu map"] > 0]
    noises = outcomes[outcomes.group == "noise"]
    reassuring = int(noises.level.isin(LEVELS[:2]).sum())
    rows: list[tuple[object, ...]] = [
        (f"recordings: {title}", int((outcomes.group == group).sum()), "")
        for group, title in GROUPS.items()
    ]
    share = len(alarms) / max(1, len(good))
    rows += [
        ("maps with known errors", len(mapped), ""),
        ("noise called usable, or usable for neighbours",
         f"{reassuring} of {len(noises)}", "none"),
        (f"false reassurance: called usable, but r < {MIN_R} or error > {MAX_ERROR:g} spacing",
         f"{len(reassured)} of {len(bad)}", "none"),
        (f"false alarm: called not usable, but r >= {GOOD_R} and error < {GOOD_ERROR:g} spacing",
         f"{len(alarms)} of {len(good)} ({share:.1%})", "at most 5 %"),
        ("called usable, of good maps", f"{sum(good.level == LEVELS[0])} of {len(good)}", "75 %"),
    ]  # fmt: skip
    if len(ratios):
        within = ratios.between(1 / 2, 2).mean()
        rows += [
            ("expected error over true error, median", f"{ratios.median():.2f}", "0.67 to 1.5"),
            ("expected error within a factor of 2 of the true error", f"{within:.0%}", ""),
            ("true error above the expected", f"{(ratios < 1).mean():.0%}", ""),
        ]
    if len(cost):
        what = "CPU time of the search for faults and the verdict over that of the map, median"
        rows.append((what, f"{cost.median():.1f}", ""))
    levels = [
        (title, len(group), *group.level.value_counts().reindex(LEVELS, fill_value=0))
        for title, group in (
            (f"good: r >= {GOOD_R}, error < {GOOD_ERROR:g}", good),
            ("between", mapped.drop(index=[*bad.index, *good.index])),
            (f"bad: r < {MIN_R} or error > {MAX_ERROR:g}", bad),
        )
    ]
    lines = [*markdown_table(("figure", "value", "goal"), rows)]
    lines += ["", *markdown_table(("maps", "number", *LEVELS), levels), "", *by_group(mapped)]
    for title, group in (("False reassurance", reassured), ("False alarms", alarms)):
        lines += ["", f"{title}:", ""] if len(group) else ["", f"{title}: none"]
        lines += [
            f"- {one.name}: r {one.r:.3f}, error {one.error:.2f}, expected {one.expected:.2f}"
            for one in group.sort_values("r", kind="stable").itertuples(index=False)
        ]
    return "\n".join(lines) + "\n"


def ratios_of(outcomes: Any) -> Any:
    """Return expected errors over true ones, where both are known."""
    known = outcomes[outcomes.expected.notna() & (outcomes.error > 0)]
    return known.expected / known.error


def closeness(ratios: Any) -> dict[str, object]:
    """Return cells on how close expected errors are to true ones, given their ratios."""
    apart = np.abs(np.log(ratios))
    within = {f"within {limit:g}": f"{(apart < math.log(limit)).mean():.0%}" for limit in (1.5, 2)}
    median = f"{ratios.median():.2f}"
    return {"maps": len(ratios), "expected / true error, median": median, **within}


def by_group(outcomes: Any) -> list[str]:
    """Return the lines of a table of how well errors are expected, by group of recordings."""
    known = outcomes[outcomes.expected.notna() & (outcomes.error > 0)]
    rows = []
    for name, damaged in product(GROUPS, (False, True)):
        group = known[(known.group == name) & ((known.damage != "") == damaged)]
        if len(group):
            held = group.error.between(group.expected_error_low, group.expected_error_high)
            inside = "-" if group.inside.isna().all() else f"{group.inside.mean():.0%}"
            rows.append(
                {
                    "recordings": f"{GROUPS[name]}, damaged" if damaged else GROUPS[name],
                    **closeness(ratios_of(group)),
                    "true error in its interval": f"{held.mean():.0%}",
                    "true positions in ellipses of 95 %": inside,
                }
            )
    return [*keyed_table(rows)]


def draw(outcomes: Any, path: Path) -> None:
    """Draw expected against true errors, coloured by level."""
    figure = Figure(figsize=(6, 5.5), layout="constrained")
    axes = figure.subplots()
    for level, (colour, marker) in zip(LEVELS, _LOOKS, strict=False):
        chosen = outcomes[(outcomes.level == level) & outcomes.expected.notna()]
        axes.scatter(
            chosen.error,
            chosen.expected,
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
