"""Pages of the documentation agree with the program: files, messages and columns of tables."""

import ast
import csv
import re
from functools import cache
from pathlib import Path

import pytest
from benchmarks import stale
from benchmarks.accuracy import check, compare, dimension, limits, quality
from benchmarks.harness import columns
from benchmarks.live import coach, session
from benchmarks.placing import placement
from benchmarks.verdicts import faults, trust

from anisomap.paper import accuracy, bodies, claims, reach, sensitivity

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "anisomap"
ARCHITECTURE = (ROOT / "docs/development/architecture.md").read_text("utf-8")
TROUBLESHOOTING = (ROOT / "docs/how-to/troubleshooting.md").read_text("utf-8")


def named(text: str) -> set[str]:
    return set(re.findall(r"`([\w/.]+)`", text))


def exists(name: str) -> bool:
    return (PACKAGE / name).exists() or (PACKAGE / f"{name}.py").exists()


def test_the_first_table_names_every_package():
    table = ARCHITECTURE.partition("do not import one another")[0]
    modules = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    public = {name for name in modules if not name.startswith("_")}
    assert public <= named(table)


def test_every_file_that_answers_a_question_exists():
    answers = ARCHITECTURE.partition("## Where do I find")[2].partition("## Conventions")[0]
    paths = {name for name in named(answers) if "/" in name or name.endswith(".py")}
    paths -= {"tests/x/", "tests/test_x.py"}  # placeholders
    missing = {name for name in paths if not exists(name)}
    assert len(paths) > 15
    assert not missing


def quotations() -> list[str]:
    prose = re.sub(r"```.*?```", "", TROUBLESHOOTING, flags=re.DOTALL)
    return sorted(set(re.findall(r'"([^"]+)"', prose)))


@cache
def messages() -> list[str]:
    """Return every string of the package in lower case, f-strings without their values."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [part.value for part in node.values if isinstance(part, ast.Constant)]
                found.append("".join(parts).lower())
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value.lower())
    return found


def contains(message: str, parts: list[str]) -> bool:
    """Return whether a message contains all parts, in this order."""
    for part in parts:
        _, found, message = message.partition(part)
        if not found:
            return False
    return True


@pytest.mark.parametrize("quotation", quotations())
def test_a_quoted_message_exists(quotation):
    parts = [part for words in quotation.lower().split("…") if (part := words.strip())]
    assert any(contains(message, parts) for message in messages())


HEADERS = {
    "ablations": accuracy.ABLATIONS_COLUMNS,
    "check": columns(check.Result),
    "claims": claims.COLUMNS,
    "claims-cases": claims.CASE_COLUMNS,
    "claims-frozen": ("claim", "where", "test", "measured", "cases", "verdict"),
    "claims-measured": claims.MEASURED_COLUMNS,
    "claims-tests": (
        "claim",
        "sentence",
        "old tests, old settings",
        "new tests, old settings",
        "old tests, new settings",
        "new tests, new settings",
    ),
    "coach": columns(coach.Row),
    "coach-summary": columns(coach.Goal),
    "dimension": columns(dimension.Row),
    "faults": columns(faults.Result),
    "figure-3": accuracy.SUMMARY_COLUMNS,
    "figure-4": bodies.AXIAL_COLUMNS,
    "figure-7": bodies.ROUNDNESS_COLUMNS,
    "limits": columns(limits.Limits),
    "live-memory": session.MEMORY_COLUMNS,
    "placement": columns(placement.Figure),
    "quality": columns(quality.Result),
    "recordings": compare.columns(compare.COMPARED),
    "reach": reach.REACH_COLUMNS,
    "reach-recordings": reach.PLACE_COLUMNS,
    "settings": sensitivity.SETTINGS_COLUMNS,
    "trust": trust.COLUMNS,
}


@pytest.mark.parametrize(
    "path", sorted((ROOT / "docs/results").iterdir()), ids=lambda path: path.name
)
def test_columns_are_those_that_the_command_writes(path):
    with path.open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    assert header == list(HEADERS[path.stem])


def test_every_table_and_picture_states_its_commit_and_modules_that_exist():
    rows = stale.read(ROOT / stale.MEASURED)
    assert set(rows) == set(stale.written(ROOT / "docs"))
    for row in rows.values():
        assert re.fullmatch("[0-9a-f]{8}", row["commit"])
        assert all((ROOT / module).exists() for module in row["modules"].split())
