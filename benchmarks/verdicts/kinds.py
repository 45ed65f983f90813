"""Verdicts with a given number of dimensions and with ``auto``, on sound skins of all kinds.

Each seed draws a skin of `benchmarks.skins.independent` with 25 to 110 sensors. Contacts are stated
to be compact, or elongated if they roll, and sensors at random places not to be evenly spaced. The
output is a table in Markdown, with intervals of 95 %, and all results as CSV.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

import anisomap
from anisomap.method.pipeline import reconstruct_with_stages
from anisomap.notes import kind_of
from benchmarks.harness import keyed_table, measured, options, quietly
from benchmarks.skins.independent import RANDOM, Case, drawn, make

FIRST_SEED, LONGEST, SENSORS = 11001, 3000, (25, 110)
GOOD, WRONG = 0.5, 1.0
"""Most error of a good map, of which all sensors are placed, and least of a wrong one."""

ROLLED = ("rolling", "rolling-pin")
THIN = ("hand", "glove", "finger", "two-fingers", "torus")


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all seeds and write the results."""
    parser = options(__doc__, "kinds", seeds=200, first_seed=FIRST_SEED, recordings=False,
                     workers=True)  # fmt: skip
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    rows = measured(judged, [*seeds], chosen.workers)
    outcomes = pd.DataFrame(rows)
    chosen.output.mkdir(parents=True, exist_ok=True)
    outcomes.to_csv(chosen.output / "kinds.csv", index=False, float_format="%.4f")
    text = table(outcomes)
    (chosen.output / "kinds-table.md").write_text(text, encoding="utf-8")
    print(text)


def case_of(seed: int) -> Case:
    """Draw a small case."""
    case, rng = drawn(seed, longest=LONGEST), np.random.default_rng([seed, 5])
    count = round(float(np.exp(rng.uniform(*np.log(SENSORS)))))
    return replace(case, body=f"{case.body}:n={count}")


def judged(seed: int) -> list[dict[str, Any]]:
    """Map a skin in its number of dimensions and in that which is chosen; a row each."""
    case = case_of(seed)
    recording = make(case).complete("interpolate")
    true = int(np.asarray(recording.positions).shape[1])
    stated = "elongated" if case.stimulation in ROLLED else "compact"
    rows = []
    with quietly():
        health, findings = anisomap.assess(recording), anisomap.find_faults(recording)
        for dimensions in (true, "auto"):
            row: dict[str, Any] = {
                "seed": seed, "body": case.body.partition(":")[0], "touch": case.stimulation,
                "transducer": case.transducer, "auto": dimensions == "auto", "level": "refused",
                "silent": False, "stated": False, "expected": math.nan, "error": math.nan,
                "placed": 0.0,
            }  # fmt: skip
            rows.append(row)
            try:
                made, stages = reconstruct_with_stages(recording, dimensions=dimensions)
            except anisomap.InputError:
                continue
            made = anisomap.diagnose(
                *(made, recording),
                health=health,
                findings=findings,
                contacts=stated,
                uneven=case.body.startswith(RANDOM),
                stages=stages,
            )
            said = any("whether the skin" in text for text in made.notes)
            said |= any("-d 2 or -d 3" in reason for reason in made.verdict.reasons)
            scored = anisomap.score(made, np.asarray(recording.positions), permutations=0)
            row |= {
                "level": made.verdict.level,
                "silent": made.dimensions != true and not said,
                "stated": "compact" in map(kind_of, made.verdict.reasons),
                "expected": made.verdict.expected_error,
                "error": scored.rms_in_spacings,
                "placed": float(np.mean(made.component == 0)),
            }
    return rows


def table(outcomes: Any) -> str:
    """Return how many maps of each kind are usable, and how well errors are expected."""
    rows = []
    for auto, group in outcomes.groupby("auto"):
        usable = group.level == "usable"
        good, wrong = (group.error <= GOOD) & (group.placed == 1), group.error > WRONG
        figures = {
            "good maps usable": (usable, good),
            "wrong maps usable": (usable, wrong),
            "good maps usable if contacts are not stated": (usable & ~group.stated, good),
            "good maps of random places usable": (usable, good & group.body.str.startswith(RANDOM)),
            "rolled skins usable": (usable, (group.placed > 0) & group.touch.isin(ROLLED)),
            "dimensions wrong without a word": (group.silent, group.placed > 0),
            "these usable": (usable, group.silent),
        }
        ratios = np.log(group.expected / group.error)
        known, thin = np.isfinite(ratios), group.body.isin(THIN)
        figures["expected error within a factor of 2"] = (np.abs(ratios) < math.log(2), known)
        found = {what: _share(*which) for what, which in figures.items()}
        for what, which in (("all", known), ("thin bodies", known & thin)):
            found[f"expected over true error, median, {what}"] = (
                f"{np.exp(ratios[which].median()):.2f} of {which.sum()}"
            )
        rows.append({"dimensions": "auto" if auto else "given", **found})
    names = [one for one in rows[0] if one != "dimensions"]
    lines = ({"figure": n, **{row["dimensions"]: row[n] for row in rows}} for n in names)
    return "\n".join(keyed_table(lines)) + "\n"


def _share(which: Any, among: Any) -> str:
    """Return a count and its interval of 95 % (Wilson)."""
    count, total = int((which & among).sum()), int(among.sum())
    if not total:
        return "-"
    low, high = binomtest(count, total).proportion_ci(method="wilson")
    return f"{count} of {total} ({low:.0%} to {high:.0%})"


if __name__ == "__main__":
    main()
