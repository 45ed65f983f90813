"""Damage of recordings: found, falsely found, and mended.

Skins of `benchmarks.skins.independent`, and recordings in folders, are damaged in each way. The
output is two tables in Markdown and all results as CSV: whether the damage was found, what else was
found, which sensors were called faulty, and the accuracy (Mantel r) of maps of the undamaged, the
damaged and the repaired recording; and what is found in sound recordings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import anisomap
from anisomap.sensor_map import is_faulty
from benchmarks.accuracy.compare import spanned_dimensions
from benchmarks.harness import files_in, frame, keyed_table, measured, options, write_rows
from benchmarks.skins.independent import FLAT, SOLID, Case, damaged, drawn, make
from benchmarks.verdicts.suite import DAMAGES

FIRST_SEED = 701
FRAMES = 2000
TOUCHES = ("poke", "stroke", "multi", "rain", "uneven")
TRANSDUCERS = ("linear", "exact", "8-bits", "logarithmic")
SOUND = 10
"""Sound recordings for each seed, of all kinds."""

WAYS = ("", *(one for one in DAMAGES if one != "swapped"))  # all the time: maps are right
OK = "ok"

FOUND = {
    "swapped": "changed steps", "shifted": "changed steps", "modules": "changed steps",
    "posture": "changed", "mounting": "changed steps", "inverted": "inverted",
    "copied": "copies", "shorted": "copies", "saturating": "saturation", "leak": "leak",
    "common-noise": "common-noise", "spikes": "spikes", "frozen": "frozen", "steps": "steps",
    "gaps": "gaps",
}  # fmt: skip
"""Kinds of findings that are right, by damage."""

TRUE_OF_SOUND = {"hum": "hum", "saturating": "saturation", "crosstalk": "leak"}
"""Findings that are true of a transducer; of all: the contacts may be in separate regions."""

STATES = ("undamaged", "damaged", "repaired")
"""Of recordings, whose maps are scored."""

GOOD, LOSS = 0.9, 0.01
"""Mantel r of a map that a repair must not lower, and by how much it lowers it."""


@dataclass(frozen=True)
class Result:
    """Findings about a recording, and the accuracy of its maps.

    faulty, named: Sensors at fault, and those of them that are not called sound.
    flagged: Other sensors that are called faulty.
    """

    recording: str
    damage: str
    found: bool
    falsely_found: str
    undamaged: float
    damaged: float
    repaired: float
    faulty: int
    named: int
    flagged: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Damage, examine, repair and map all recordings, and write the results."""
    parser = options(__doc__, "faults", seeds=4, first_seed=FIRST_SEED, workers=True)
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    sources = [*seeds, *files_in(chosen.recordings)]
    results = measured(examined, sources, chosen.workers)
    write_rows(chosen.output / "faults.csv", results, digits=4)
    sound = range(SOUND * chosen.first_seed, SOUND * (chosen.first_seed + chosen.seeds))
    text = table(results) + "\n" + alarms(measured(flagged, [*sound], chosen.workers))
    (chosen.output / "faults-table.md").write_text(text, encoding="utf-8")
    print(text)


def examined(source: int | Path) -> list[Result]:
    """Examine a skin of a seed, or a recording in a file, with every damage."""
    if isinstance(source, int):
        case = _case(source)
        return _examinations(str(case), {one: make(replace(case, damage=one)) for one in WAYS})
    whole = anisomap.read(source)
    if whole.positions is None or not np.isfinite(whole.positions).all():
        return []
    rng = np.random.default_rng(1)
    ways = [one for one in WAYS if one not in ("", "posture")]
    spoilt = {"": whole, **{one: damaged(whole, one, rng) for one in ways}}
    return _examinations(source.stem, spoilt)


def _case(seed: int) -> Case:
    """Return a skin that is touched all over, of which the map should be good."""
    body, touch = ([*names][seed % len(names)] for names in ({**FLAT, **SOLID}, TOUCHES))
    transducer = str(np.random.default_rng(seed).choice(TRANSDUCERS))
    return Case(f"{body}:n=80", touch, transducer, "", FRAMES, seed)


def _examinations(name: str, recordings: Mapping[str, anisomap.Recording]) -> list[Result]:
    """Return the results of a sound recording, and of the same one damaged."""
    sound, rows = accuracy(recordings[""]), []
    for damage, recording in recordings.items():
        repaired = anisomap.repair(recording)
        kinds = {one.kind for one in repaired.findings}
        right = set(FOUND.get(damage.partition(":")[0], "").split())
        faulty = set(filter(None, str(recording.metadata.get("faulty", "")).split(",")))
        health = anisomap.assess(recording)
        called = {one.name for one in health if is_faulty(one.status)}
        named = {one.name for one in health if one.status != OK}
        named |= {name for one in repaired.findings if one.kind in right for name in one.sensors}
        rows.append(
            Result(
                recording=name,
                damage=damage or "none",
                found=bool(kinds & right),
                falsely_found=" ".join(sorted(kinds - right)),
                undamaged=sound,
                damaged=accuracy(recording) if damage else sound,
                repaired=accuracy(repaired.recording),
                faulty=len(faulty),
                named=len(named & faulty),
                flagged=len(called - faulty) if faulty or not damage else 0,
            )
        )
    return rows


def accuracy(recording: anisomap.Recording) -> float:
    """Return the Mantel r of a map of a recording; NaN if there is none."""
    truth = np.asarray(recording.positions)
    try:
        made = anisomap.reconstruct(
            recording.complete("interpolate"), dimensions=spanned_dimensions(truth)
        )
        return anisomap.score(made, truth, permutations=0).mantel.r
    except anisomap.InputError:
        return math.nan


def table(results: Sequence[Result]) -> str:
    """Return a table of all damages, one line each."""
    rows = []
    for text, group in frame(results).groupby("damage", sort=False):
        faulty = group.faulty.sum()
        worse = (group.undamaged >= GOOD) & (group.damaged - group.repaired > LOSS)
        rows.append(
            {
                "damage": text,
                "recordings": len(group),
                "found": group.found.sum() if text.partition(":")[0] in FOUND else "-",
                "something else found": (group.falsely_found != "").sum(),
                "faulty sensors named": f"{group.named.sum() / faulty:.0%}" if faulty else "-",
                "other sensors flagged": group.flagged.sum(),
                **{f"r {what}": f"{group[what].median():.3f}" for what in STATES},
                f"repair loses more than {LOSS:g}": worse.sum(),
            }
        )
    return "\n".join(keyed_table(rows)) + "\n"


def flagged(seed: int) -> list[dict[str, Any]]:
    """Return what is found in a sound recording, beside the case."""
    case = drawn(seed)
    recording = make(case)
    true = {"separate-regions", TRUE_OF_SOUND.get(case.transducer.partition(":")[0])}
    kinds = {one.kind for one in anisomap.find_faults(recording)} - true
    faulty = sum(is_faulty(one.status) for one in anisomap.assess(recording))
    counts = {
        "with a finding": bool(kinds),
        "sensors": recording.n_sensors,
        "called faulty": faulty,
    }
    return [{**asdict(case), **counts}]


def alarms(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table of what is found in sound recordings, by stimulation and transducer."""
    counts = ["with a finding", "sensors", "called faulty"]
    if not rows:
        return ""
    found = pd.DataFrame(rows)
    lines = [
        {"sound recordings": value, "number": len(group), **group[counts].sum()}
        for column in ("stimulation", "transducer")
        for value, group in found.groupby(column)
    ]
    lines.append({"sound recordings": "all", "number": len(found), **found[counts].sum()})
    return "\n".join(keyed_table(lines)) + "\n"


if __name__ == "__main__":
    main()
