"""Compare the results of all rows with the record (``make golden``), or write a new record.

A row differs if a position, a number or a text does. The exit status is 1 if a row differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from golden.cases import CASES, CHAOTIC, REAL
from golden.results import (
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
    """Make all maps, print the table, and accept the differences on request."""
    parser = argparse.ArgumentParser(prog="golden", description=__doc__)
    parser.add_argument("--exact", action="store_true", help=f"{EXACT:g} spacings for every row")
    parser.add_argument("--accept", action="store_true", help="write the rows that differ")
    parser.add_argument("--rows", help="only rows whose name contains this text")
    parser.add_argument("--workers", type=int, help="number of processes; default: all cores")
    chosen = parser.parse_args(arguments)
    cases = {**CASES, **{name: case for name, case in REAL.items() if case.path.exists()}}
    cases = {name: case for name, case in cases.items() if (chosen.rows or "") in name}
    record = read_record()
    seconds, different = 0.0, []
    print(f"{'row':38} {'moved':>7} {'r':>6} {'dr':>7} {'expected':>8} {'level':14} CPU s")
    with ProcessPoolExecutor(chosen.workers, mp_context=get_context("spawn")) as pool:
        for name, new in zip(cases, pool.map(result_of, cases.values()), strict=True):
            old = record.get(name, Result({}))
            limits = (EXACT,) if chosen.exact else (SIMILAR, CHAOTIC.get(name, (0.0, ""))[0])
            found = differences(old, new, *limits)
            print(_line(name, old, new), *found, sep="\n    ", flush=True)
            seconds += new.seconds
            if found:
                different.append(name)
                record[name] = new
    print(f"{len(different)} of {len(cases)} rows differ, {seconds:.0f} s of CPU")
    if chosen.accept:
        write_record({name: record[name] for name in [*CASES, *REAL] if name in record})
    else:
        print(*different, sep="\n")
    return 1 if different and not chosen.accept else 0


def _line(name: str, old: Result, new: Result) -> str:
    r, before, expected = (
        float(facts.get(key, "nan"))
        for facts, key in ((new.facts, "r"), (old.facts, "r"), (new.facts, "expected error"))
    )
    level = new.facts.get("level", "refused")
    return (
        f"{name:38} {displacement(old, new):7.0e} {r:6.3f} {r - before:7.0e} {expected:8.2f} "
        f"{level:14} {new.seconds:5.1f}"
    )


if __name__ == "__main__":
    sys.exit(main())
