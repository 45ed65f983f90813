"""Count lines, functions and constants, words of the docs, and what a map passes (``make size``).

Templates and JavaScript are counted beside Python. Pages for users are those on how to start, how
to do something, explanations and references; tables that commands write are not counted.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import anisomap
from anisomap.method.pipeline import reconstruct_with_stages
from benchmarks.harness import columns, markdown_table

PACKAGE = Path(anisomap.__file__).parent
ROOT = PACKAGE.parents[1]
GOALS = {"files": 195, "lines": 42_000, "code": 28_700}
TESTS_GOAL = {"lines": 20_900}
PATH_GOAL = ("150", "25")
WORDS_GOALS = {"users": 22_000, "developers": 8_000}
USERS = ("getting-started.md", "how-to/", "explanation/", "reference/", "robots/")
DEVELOPERS = ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md", "README.md")


@dataclass(frozen=True)
class Size:
    """Counts of some source files.

    code: Lines that are neither blank, nor comments, nor docstrings.
    constants: Numbers in assignments and defaults of modules and classes.
    """

    files: int
    lines: int
    code: int
    functions: int
    classes: int
    constants: int


@dataclass(frozen=True)
class Passed:
    """What runs while a map is made."""

    functions: int
    modules: int


def size_of(paths: list[Path]) -> Size:
    """Count the contents of some files."""
    sources = [path.read_text(encoding="utf-8") for path in paths]
    nodes = [node for source in sources for node in ast.walk(ast.parse(source))]
    return Size(
        files=len(paths),
        lines=sum(source.count("\n") for source in sources),
        code=sum(len(_code_lines(source)) for source in sources),
        functions=sum(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in nodes),
        classes=sum(isinstance(node, ast.ClassDef) for node in nodes),
        constants=sum(_n_constants(ast.parse(source)) for source in sources),
    )


def path_of(call: Callable[[], Any]) -> Passed:
    """Count the functions and modules of the package that a call runs, after a first call."""
    call()
    seen: set[tuple[str, str, int]] = set()

    def profile(frame: FrameType, event: str, _: object) -> None:
        file = frame.f_code.co_filename
        if event == "call" and file.startswith(str(PACKAGE)) and frame.f_code.co_name[0] != "<":
            seen.add((file, frame.f_code.co_name, frame.f_code.co_firstlineno))

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return Passed(len(seen), len({file for file, _, _ in seen}))


def main(arguments: list[str] | None = None) -> None:
    """Print the counts as Markdown tables."""
    parser = argparse.ArgumentParser(prog="benchmarks.size", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="file for the tables")
    chosen = parser.parse_args(arguments)
    tables = (_size_table(), _page_table(), _path_table(), _words_table())
    text = "\n\n".join("\n".join(table) for table in tables) + "\n"
    print(text)
    if chosen.output:
        chosen.output.write_text(text, encoding="utf-8")


def _size_table() -> list[str]:
    names = columns(Size)
    rooms = sorted(path for path in PACKAGE.iterdir() if (path / "__init__.py").exists())
    rows = {room.name: size_of(sorted(room.rglob("*.py"))) for room in rooms}
    rows["modules beside them"] = size_of(sorted(PACKAGE.glob("*.py")))
    rows["all"] = size_of(sorted(PACKAGE.rglob("*.py")))
    goals = {"goal for all": GOALS, "goal for tests": TESTS_GOAL}
    rows["tests"] = size_of(sorted((ROOT / "tests").rglob("*.py")))
    cells = [(name, *(f"{count:,}" for count in astuple(size))) for name, size in rows.items()]
    cells += [
        (title, *(f"{goal[name]:,}" if name in goal else "" for name in names))
        for title, goal in goals.items()
    ]
    return [*markdown_table(("", *names), cells)]


def _page_table() -> list[str]:
    """Count the files of pages and reports that are not in Python."""
    rows = []
    for kind in ("js", "css", "html", "txt"):
        paths = sorted(PACKAGE.rglob(f"*.{kind}"))
        if paths:
            lines = sum(path.read_text(encoding="utf-8").count("\n") for path in paths)
            rows.append((f".{kind}", len(paths), f"{lines:,}"))
    return [*markdown_table(("other files of the package", "files", "lines"), rows)]


def _words_table() -> list[str]:
    """Count the words of the docs, without code and without tables that commands write."""
    docs = ROOT / "docs"
    words = dict.fromkeys(WORDS_GOALS, 0)
    for path in [*docs.rglob("*.md"), *(ROOT / name for name in DEVELOPERS)]:
        name = str(path.relative_to(docs)) if path.is_relative_to(docs) else path.name
        if name.startswith("_build") or path.stem.endswith("-table"):
            continue
        text = re.sub(r"^(```|~~~).*?^\1|^\|.*?$|<!--.*?-->", "", path.read_text(encoding="utf-8"),
                      flags=re.DOTALL | re.MULTILINE)  # fmt: skip
        words["users" if name.startswith(USERS) else "developers"] += len(text.split())
    rows = [(who, f"{words[who]:,}", f"{goal:,}") for who, goal in WORDS_GOALS.items()]
    return [*markdown_table(("words of pages for", "words", "goal"), rows)]


def _path_table() -> list[str]:
    rng = np.random.default_rng(1)
    places, touches = rng.uniform(0, 8, (60, 2)), rng.uniform(0, 8, (2000, 1, 2))
    readings = np.maximum(0, 2 - np.linalg.norm(touches - places, axis=2))
    rows: list[tuple[object, ...]] = []
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")
        for name, call in _calls(readings, Path(folder)).items():
            rows.append((name, *astuple(path_of(call))))
    rows.append(("goal for the default method", *PATH_GOAL))
    return [*markdown_table(("map of 60 sensors", "functions", "modules"), rows)]


def _calls(readings: np.ndarray[Any, Any], folder: Path) -> dict[str, Callable[[], Any]]:
    """Return the ways to a map that are counted."""
    made, stages = reconstruct_with_stages(readings, dimensions=2)
    return {
        "default method": lambda: anisomap.reconstruct(readings, dimensions=2),
        "r-anisomap": lambda: anisomap.reconstruct(readings, "r-anisomap", 2),
        "verdict on the default map": lambda: anisomap.diagnose(made, readings, stages=stages),
        "files: readings in, map out": lambda: _through_files(readings, folder),
    }


def _through_files(readings: np.ndarray[Any, Any], folder: Path) -> None:
    path = folder / "readings.csv"
    if not path.exists():
        np.savetxt(path, readings, delimiter=",")
    made = anisomap.reconstruct(anisomap.read(path), dimensions=2)
    anisomap.write(made, folder / "map.csv")


def _code_lines(source: str) -> set[int]:
    """Return the lines of statements, without docstrings."""
    tree = ast.parse(source)
    documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    texts: set[int] = set()
    for node in ast.walk(tree):
        body = node.body if isinstance(node, documented) else []
        if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            texts |= set(range(body[0].lineno, (body[0].end_lineno or body[0].lineno) + 1))
    lines = source.splitlines()
    return {
        number
        for number, line in enumerate(lines, 1)
        if line.strip() and not line.strip().startswith("#") and number not in texts
    }


def _n_constants(tree: ast.Module) -> int:
    """Count the numbers in assignments and in defaults, outside functions' bodies."""
    values: list[ast.expr] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            assigned = [one for one in node.body if isinstance(one, ast.Assign | ast.AnnAssign)]
            values += [one.value for one in assigned if one.value is not None]
        elif isinstance(node, ast.arguments):
            values += [*node.defaults, *(default for default in node.kw_defaults if default)]
    return sum(
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
        for value in values
        for node in ast.walk(value)
    )


if __name__ == "__main__":
    main()
