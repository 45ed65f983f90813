"""Verdicts on maps of recordings that nobody tuned on (``make trust``).

Maps at least 500 recordings with known positions by the default method: all bodies, stimuli and
faults, from 100 to 8,000 frames, and real skins. The verdict on each map, which is made without the
positions, is compared with the error of the map. Verdicts were tuned on seeds 1 to 300 and 2001
to 2038; seeds from 3001 on are used here. The output is a table in Markdown, a scatter picture, and
all results with all evidence as CSV. A run that was interrupted continues where it stopped.
"""

from __future__ import annotations

import argparse
import csv
import logging
import math
import multiprocessing
import os
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import anisomap
from anisomap.diagnosis import judge
from anisomap.diagnosis.diagnostics import collect_evidence
from anisomap.reconstruction import reconstruct_with_stages
from benchmarks.trust_recordings import Case, cases_of_file, cases_of_seed
from benchmarks.trust_tables import Outcome, draw, number, table

FIRST_SEED = 3001
SEEDS = 130
"""Number of seeds; each gives four recordings."""

FACTS = (
    "sensors", "frames", "dimensions", "cpu map", "cpu verdict",
    "repeatability", "extent", "placed",
)  # fmt: skip
"""Columns of the evidence; those of the doubts follow them."""

REFUSED = "refused"
"""Level of a recording of which no map is made."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="0 maps real skins only")
    parser.add_argument(
        "--shard", default="1/1", help="such as 2/3: the second third of the seeds and files"
    )
    parser.add_argument(
        "--recordings", type=Path, nargs="+", default=(), help="folders of NPZ files with positions"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("trust"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--cases", help="only recordings whose name contains this text")
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    part, parts = (int(text) for text in chosen.shard.split("/"))
    # Real skins first: the largest take minutes, and would keep one process busy at the end.
    files = [path for folder in chosen.recordings for path in folder.glob("*.npz")]
    every: list[int | Path] = [*sorted(files, key=lambda path: -path.stat().st_size)]
    every += range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    path = chosen.output / "trust.csv"
    outcomes = read_csv(path) if path.exists() else []
    done = {outcome.source for outcome in outcomes}
    todo = [source for source in every[part - 1 :: parts] if str(source_name(source)) not in done]
    started = time.monotonic()
    with ProcessPoolExecutor(chosen.workers, initializer=_end_with_parent) as pool:
        jobs = [
            pool.submit(outcomes_of, source, chosen.output / "recordings", chosen.cases)
            for source in todo
        ]
        for n_done, job in enumerate(as_completed(jobs), start=1):
            outcomes += job.result()
            write_csv(outcomes, path)
            left = (time.monotonic() - started) / n_done * (len(jobs) - n_done)
            print(
                f"\r{n_done} of {len(jobs)} skins, {len(outcomes)} recordings, "
                f"{left / 60:.0f} min left ",
                end="",
                flush=True,
            )
    print()
    text = table(outcomes)
    (chosen.output / "trust-table.md").write_text(text, encoding="utf-8")
    draw(outcomes, chosen.output / "trust.png")
    print(text)


def _end_with_parent() -> None:
    """End this worker when the process that started it ends, even if that one is killed."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def source_name(source: int | Path) -> str:
    """Return the seed or the name of a file."""
    return source.stem if isinstance(source, Path) else str(source)


def outcomes_of(source: int | Path, folder: Path, chosen: str | None = None) -> list[Outcome]:
    """Map all recordings of a seed or of a file."""
    logging.getLogger("anisomap").setLevel(logging.ERROR)
    cases: Iterator[Case] = (
        cases_of_file(source) if isinstance(source, Path) else cases_of_seed(source, folder)
    )
    with threadpool_limits(1):
        return [
            judged(case, source_name(source)) for case in cases if not chosen or chosen in case.name
        ]


def judged(case: Case, source: str = "") -> Outcome:
    """Map a recording, and compare the verdict on the map with its error."""
    recording = case.recording
    facts = {
        "sensors": float(recording.n_sensors),
        "frames": float(recording.n_frames),
        "dimensions": float(case.dimensions),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        try:
            begun = time.process_time()
            made, stages = reconstruct_with_stages(recording, dimensions=case.dimensions)
            mapped = time.process_time()
            faults = anisomap.find_faults(recording)
            evidence = collect_evidence(made, recording, faults, stages=stages)
            verdict = judge(evidence)
            facts["cpu map"] = mapped - begun
            facts["cpu verdict"] = time.process_time() - mapped
            scored = anisomap.score(made, np.asarray(recording.positions), permutations=0)
        except anisomap.InputError as error:
            return Outcome(
                source, case.name, case.fault, REFUSED, math.nan, math.nan, math.nan, math.nan,
                str(error), facts,
            )  # fmt: skip
    facts |= {
        "repeatability": evidence.repeatability,
        "extent": evidence.extent,
        "placed": float(np.mean(made.component == 0)),
    }
    for doubt in evidence.doubts:
        name = f"doubt: {doubt.kind}"
        facts[name] = math.hypot(doubt.size, facts.get(name, 0.0))
        if not math.isnan(doubt.measured):
            facts[f"measured: {doubt.kind}"] = doubt.measured
    return Outcome(
        source,
        case.name,
        case.fault,
        verdict.level,
        verdict.expected_error,
        scored.mantel.r,
        scored.rms_in_spacings,
        scored.neighbours_kept,
        "; ".join(verdict.reasons),
        facts,
    )


def write_csv(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write all outcomes; columns of evidence follow the others."""
    evidence = list(dict.fromkeys([*FACTS, *(name for one in outcomes for name in one.evidence)]))
    partial = path.with_suffix(".part")
    with partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow([*Outcome.FIXED, *evidence])
        for one in outcomes:
            fixed = [getattr(one, name) for name in Outcome.FIXED]
            writer.writerow([*fixed, *(one.evidence.get(name, "") for name in evidence)])
    partial.replace(path)


def read_csv(path: Path) -> list[Outcome]:
    """Read the outcomes of an earlier run."""
    outcomes = []
    with path.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            fixed: dict[str, Any] = {name: row.pop(name) for name in Outcome.FIXED}
            fixed |= {name: number(fixed[name]) for name in Outcome.NUMBERS}
            evidence = {name: number(text) for name, text in row.items() if text}
            outcomes.append(Outcome(**fixed, evidence=evidence))
    return outcomes


if __name__ == "__main__":
    main()
