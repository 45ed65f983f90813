"""Run tests under several kinds of arithmetic, and list the tests whose outcome changes.

The order of sums, and that of equal values in sorts, differ between processors, numbers of threads
and versions of libraries; results that depend on it differ between machines. From the root of the
repository: ``python -m tests.profiles [--only NAME,NAME] [ARGUMENTS OF PYTEST]``.
"""

import argparse
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
import tomllib
import venv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from numpy._core import _multiarray_umath as kernels

ROOT = Path(__file__).parents[1]
LOWEST = "lowest-versions"
LOWERED = ("numpy", "scipy", "scikit-learn", "numba")
"""Packages that compute; the profile of the lowest versions takes these from ``pyproject.toml``."""

NOT_SLOW = ["-m", "not slow"]


class Profile(NamedTuple):
    """A kind of arithmetic.

    Attributes
    ----------
    environment : dict of str to str
        Variables that differ from those of `make test`.
    what : str
        Description in one line.
    """

    environment: dict[str, str]
    what: str


class Outcome(NamedTuple):
    """What the tests did under one profile."""

    failed: dict[str, str]  # first line of the message, by test
    counts: dict[str, int]
    seconds: float
    status: int


def available_profiles() -> dict[str, Profile]:
    """Return the profiles that this machine can run, by name."""
    found = {"default": Profile({}, "as make test")}
    # Kernels for wider registers than every processor has: names of the installed version.
    features = [f for f in kernels.__cpu_dispatch__ if kernels.__cpu_features__.get(f)]
    widest = [f for f in features if f.startswith(("AVX512", "X86_V4"))]
    for name, disabled in (("numpy-avx2", widest), ("numpy-baseline", features)):
        if disabled:
            what = f"numpy without {', '.join(disabled)}"
            found[name] = Profile({"NPY_DISABLE_CPU_FEATURES": " ".join(disabled)}, what)
    if platform.machine().lower() in ("x86_64", "amd64"):
        for core in ("Prescott", "Haswell"):
            what = f"OpenBLAS with kernels for {core}"
            found[f"blas-{core.lower()}"] = Profile({"OPENBLAS_CORETYPE": core}, what)
    found["numba-generic"] = Profile({"NUMBA_CPU_NAME": "generic"}, "loops for any processor")
    found["two-threads"] = Profile({"ANISOMAP_TEST_THREADS": "2"}, "BLAS and loops of two threads")
    found[LOWEST] = Profile({}, f"the lowest supported versions of {', '.join(LOWERED)}")
    return found


def lowest_pins(project: Path = ROOT / "pyproject.toml") -> dict[str, str]:
    """Return the lowest supported minor version of each of `LOWERED`, such as ``2.1.*``."""
    stated = tomllib.loads(project.read_text("utf-8"))["project"]
    listed = stated["dependencies"] + stated["optional-dependencies"]["fast"]
    pins = dict(re.findall(r"^([\w-]+)>=(\d+\.\d+)", "\n".join(listed), re.MULTILINE))
    return {name: f"{pins[name]}.*" for name in LOWERED}


def lowest_python() -> Path:
    """Return Python of an environment with the lowest versions; make it first where it is not."""
    folder = ROOT / f".venv-{LOWEST}"
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    ready = folder / "ready"
    if not ready.exists():
        print(f"Setting up {folder.name} (once, some minutes) ...", flush=True)
        pins = lowest_pins()
        free = {*(name.lower() for name in pins), "llvmlite"}
        known = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
        others = [line for line in known if line.partition("==")[0].lower() not in free]
        venv.create(folder, clear=True, with_pip=True)
        constraints = folder / "constraints.txt"
        constraints.write_text("\n".join([*others, *map("==".join, pins.items())]), "utf-8")
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        for what in (["pip"], ["--editable", ".[all]", "--group", "test"]):
            subprocess.run([*pip, "-c", constraints, *what], cwd=ROOT, check=True)
        ready.touch()
    return python


def run(name: str, profile: Profile, arguments: list[str]) -> Outcome:
    """Run the tests under one profile."""
    python = lowest_python() if name == LOWEST else Path(sys.executable)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [python, "-m", "pytest", "--numprocesses", "auto", "--dist", "worksteal", "-q",
                   "--no-header", "--tb=short", "-o", "junit_family=xunit1",
                   f"--junitxml={report}", *arguments]  # fmt: skip
        begin = time.monotonic()
        done = subprocess.run(command, cwd=ROOT, env=os.environ | profile.environment, check=False)
        seconds = time.monotonic() - begin
        failed, counts = read_report(report) if report.exists() else ({}, {})
    return Outcome(failed, counts, seconds, done.returncode)


def read_report(path: Path) -> tuple[dict[str, str], dict[str, int]]:
    """Return the failures of a JUnit report, and the numbers of tests by outcome."""
    suite = next(ET.parse(path).getroot().iter("testsuite"))  # noqa: S314 - written by pytest
    counts = {key: int(suite.get(key, 0)) for key in ("tests", "failures", "errors", "skipped")}
    failed = {}
    for case in suite.iter("testcase"):
        for kind in ("failure", "error"):
            if (found := case.find(kind)) is not None:
                where = f"{case.get('file') or case.get('classname')}::{case.get('name')}"
                failed[where] = (found.get("message") or "").partition("\n")[0][:120]
    return failed, counts


def summary(outcomes: dict[str, Outcome]) -> Iterator[str]:
    """Return lines with a table of the profiles, and the tests that fail under some or all."""
    yield f"{'profile':17} {'tests':>6} {'failed':>6} {'skipped':>7} {'s':>6}"
    for name, outcome in outcomes.items():
        counts = outcome.counts
        yield (
            f"{name:17} {counts.get('tests', 0):6} {len(outcome.failed):6} "
            f"{counts.get('skipped', 0):7} {outcome.seconds:6.0f}"
            + ("" if outcome.status in (0, 1) else f"  pytest ended with status {outcome.status}")
        )
    failing = sorted({test for outcome in outcomes.values() for test in outcome.failed})
    for test in failing:
        under = [name for name, outcome in outcomes.items() if test in outcome.failed]
        yield f"{test}: fails under {'all' if len(under) == len(outcomes) else ', '.join(under)}"
        yield f"    {outcomes[under[0]].failed[test]}"
    if not failing:
        yield "No test fails under any profile."


def main() -> int:
    profiles = available_profiles()
    parser = argparse.ArgumentParser(
        description="Run tests under several kinds of arithmetic.",
        epilog="Further arguments are those of pytest; by default all tests that are not slow run.",
    )
    parser.add_argument("--only", help="profiles to run, joined by commas; by default all")
    parser.add_argument("--list", action="store_true", help="list the profiles")
    options, arguments = parser.parse_known_args()
    if options.list:
        print("\n".join(f"{name:17} {profile.what}" for name, profile in profiles.items()))
        return 0
    chosen = options.only.split(",") if options.only else list(profiles)
    if unknown := [name for name in chosen if name not in profiles]:
        parser.error(f"not a profile of this machine: {', '.join(unknown)}")
    outcomes = {}
    for name in chosen:
        print(f"== {name}: {profiles[name].what}", flush=True)
        outcomes[name] = run(name, profiles[name], arguments or NOT_SLOW)
    print("\n".join(summary(outcomes)))
    return int(any(outcome.status for outcome in outcomes.values()))


if __name__ == "__main__":
    sys.exit(main())
