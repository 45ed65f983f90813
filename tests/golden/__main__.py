"""Compare the results of all rows with the record (``make golden``), or write a new record.

The exit status is 1 if a position, a number or a text of a row differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from tests.golden.cases import CASES, FOLDER, REAL
from tests.golden.results import (
    EXACT,
    SIMILAR,
    Result,
    differences,
    displacement,
    read_record,
    result_of,
    write_record,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute all rows, print the table, and accept the differences on request."""
    parser = argparse.ArgumentParser(prog="tests.golden", description=__doc__)
    parser.add_argument(
        "--exact", action="store_true", help=f"limit {EXACT:g} for all rows, instead of {SIMILAR:g}"
    )
    parser.add_argument("--accept", action="store_true", help="write the rows that differ")
    parser.add_argument("--rows", default="", help="only rows whose name contains this text")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of the record")
    parser.add_argument("--workers", type=int, help="number of processes; default: all cores")
    chosen = parser.parse_args(arguments)
    every = {**CASES, **{name: case for name, case in REAL.items() if case.path.exists()}}
    cases = {name: case for name, case in every.items() if chosen.rows in name}
    if not cases:
        parser.error(f"no row has a name with {chosen.rows!r}")
    record = read_record(chosen.folder)
    seconds, different = 0.0, []
    print(f"{'row':38} {'moved':>7} {'r':>6} {'dr':>7} {'expected':>8} {'level':14} CPU s")
    with ProcessPoolExecutor(chosen.workers, mp_context=get_context("spawn")) as pool:
        compute = map if chosen.workers == 1 else pool.map
        for name, new in zip(cases, compute(result_of, cases.values()), strict=True):
            old = record.get(name, Result({}))
            found = differences(old, new, EXACT if chosen.exact else SIMILAR)
            print(_line(name, old, new), *found, sep="\n    ", flush=True)
            seconds += new.seconds
            if found:
                different.append(name)
                record[name] = new
    count = f"{len(different)} of {len(cases)} rows differ" + ": " * bool(different)
    print(f"{count}{'; '.join(different)}\n{seconds:.0f} s of CPU")
    if not chosen.accept:
        return 1 if different else 0
    write_record({n: record[n] for n in [*CASES, *REAL] if n in record}, chosen.folder)
    return 0


def _line(name: str, old: Result, new: Result) -> str:
    r, before, expected = (
        float(facts.get(key, "nan"))
        for facts, key in ((new.facts, "r"), (old.facts, "r"), (new.facts, "expected error"))
    )
    return (
        f"{name:38} {displacement(old, new):7.0e} {r:6.3f} {r - before:7.0e} {expected:8.2f} "
        f"{new.facts.get('level', 'refused'):14} {new.seconds:5.1f}"
    )


if __name__ == "__main__":
    sys.exit(main())
