"""Results of rows, their differences, and the record on disk."""

from __future__ import annotations

import json
import math
import re
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.golden.cases import FOLDER, Case
from threadpoolctl import threadpool_limits

import anisomap
from anisomap.evaluation.scoring import median_spacing
from anisomap.method.pipeline import reconstruct_with_stages

EXACT = 1e-9
"""Limit for the same operations in the same order, on the same machine."""

SIMILAR = 1e-3
"""Limit for other arithmetic: another processor, another order of operations, other libraries."""

_NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?")


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a row.

    Attributes
    ----------
    facts : mapping of str to object
        Floats are Mantel r and dimensionless ratios, or errors in spacings. All else is text, or
        lists and dictionaries of it.
    positions : ndarray of shape (N, k)
    component : ndarray of int, shape (N,)
    seconds : float
        CPU time.
    """

    facts: Mapping[str, Any]
    positions: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    component: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    seconds: float = math.nan


def result_of(case: Case) -> Result:
    """Examine, repair and map a recording; map it as ``anisomap map`` does, without the repair."""
    begun = time.process_time()
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        try:
            result = _result(case, case.runs())
        except anisomap.AnisomapError as error:
            result = Result({"refused": str(error)})
    return replace(result, seconds=time.process_time() - begun)


def _result(case: Case, runs: Sequence[anisomap.Recording]) -> Result:
    findings, health = anisomap.find_faults(runs), anisomap.assess(runs)
    made, stages = reconstruct_with_stages(runs, case.method, case.dimensions)
    made = anisomap.diagnose(made, runs, health=health, findings=findings, stages=stages)
    truth = np.asarray(anisomap.join_runs(runs).positions)
    scored = anisomap.score(made, truth, permutations=0)
    repaired = [anisomap.repair(run).recording for run in runs]
    facts = {
        "level": made.verdict.level,
        "expected error": made.verdict.expected_error,
        "r": scored.mantel.r,
        "error": scored.rms_in_spacings,
    }
    if case.is_real:
        return Result({key: _rounded(value, 5) for key, value in facts.items()})
    facts |= {
        "repeatability": made.verdict.repeatability,
        "repaired": _mean_square(repaired) / _mean_square(runs),
        "dimensions": made.dimensions,
        "components": list(made.component_sizes),
        "reasons": list(made.verdict.reasons),
        "notes": list(made.notes),
        "findings": [f"{one.kind}: {one}" for one in findings],
        "health": {one.name: one.status for one in health if one.status != "ok"},
    }
    return Result(facts, made.positions, made.component)


def _rounded(value: Any, digits: int) -> Any:
    return round(value, digits) if isinstance(value, float) else value


def _mean_square(recordings: Iterable[anisomap.Recording]) -> float:
    readings = [np.asarray(one.readings, dtype=np.float64) for one in recordings]
    return float(np.mean([np.mean(part**2) for part in readings]))


def displacement(old: Result, new: Result) -> float:
    """Return the largest displacement of a sensor, in spacings, after alignment.

    Components are aligned one by one, by a similarity transform with reflection. The displacement
    is infinite if dimensions, components or the sensors with a position differ.
    """
    before, after = np.isfinite(old.positions), np.isfinite(new.positions)
    if not (np.array_equal(before, after) and np.array_equal(old.component, new.component)):
        return math.inf
    found = [0.0]
    for label in np.unique(old.component[old.component >= 0]):
        before, after = (one.positions[old.component == label] for one in (old, new))
        if len(before) > 1:
            found.append(anisomap.align(after, before).errors.max() / median_spacing(before))
    return max(found)


def differences(old: Result, new: Result, limit: float) -> list[str]:
    """Describe how a result differs from the record.

    Parameters
    ----------
    old, new : Result
    limit : float
        Largest displacement in spacings, and largest difference of a number. Above `EXACT`, numbers
        in texts may differ, and lists may be in another order.
    """
    moved = displacement(old, new)
    found = [] if moved <= limit else [f"a sensor moved by {moved:.2g} spacings"]
    for name in dict.fromkeys([*old.facts, *new.facts]):
        before, after = old.facts.get(name), new.facts.get(name)
        if isinstance(before, float) and isinstance(after, float):
            same = bool(np.isclose(after, before, rtol=0, atol=limit, equal_nan=True))
        else:
            same = before == after if limit <= EXACT else _rough(before) == _rough(after)
        if not same:
            found.append(f"{name}: {before} became {after}")
    return found


def _rough(value: Any) -> Any:
    texts = value if isinstance(value, list) else [value]
    return sorted(_NUMBER.sub("#", text) if isinstance(text, str) else str(text) for text in texts)


def read_record(folder: Path = FOLDER) -> dict[str, Result]:
    """Read the record."""
    if not (folder / "record.json").exists():
        return {}
    rows = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    with np.load(folder / "positions.npz") as arrays:
        return {
            name: Result(facts, arrays[f"{name}/positions"], arrays[f"{name}/component"])
            for name, facts in rows.items()
        }


def write_record(results: Mapping[str, Result], folder: Path = FOLDER) -> None:
    """Write the record."""
    rows = {
        name: {key: _rounded(value, 12) for key, value in one.facts.items()}
        for name, one in results.items()
    }
    text = json.dumps(rows, indent=1) + "\n"
    (folder / "record.json").write_text(text, encoding="utf-8")
    arrays: dict[str, Any] = {f"{name}/positions": one.positions for name, one in results.items()}
    arrays |= {f"{name}/component": one.component.astype(np.int8) for name, one in results.items()}
    np.savez_compressed(folder / "positions.npz", **arrays)
