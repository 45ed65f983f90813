"""List tables and pictures of the documentation whose code changed since they were measured.

From the root of the repository: ``python -m benchmarks.stale``. ``docs/development/measured.csv``
holds the commit at which each file was measured, the modules that it depends on, and the command
that writes it; who measures a file again states the commit there. Comments and docstrings do not
count. The exit status is 1 if a file is stale.
"""

from __future__ import annotations

import ast
import csv
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

MEASURED = Path("docs/development/measured.csv")
FOLDERS = {"development": "*-table.md", "results": "*.csv", "_static": "*.[pw][ne][gb]*"}
"""Folders of the documentation, and the files in them that commands write."""


def read(path: Path = MEASURED) -> dict[str, dict[str, str]]:
    """Read the rows of the list, by file relative to the documentation."""
    with path.open(encoding="utf-8", newline="") as file:
        return {row["file"]: row for row in csv.DictReader(file)}


def written(docs: Path = MEASURED.parents[1]) -> Iterator[str]:
    """Yield the files that commands write."""
    for folder, pattern in FOLDERS.items():
        yield from (f"{folder}/{path.name}" for path in sorted((docs / folder).glob(pattern)))


def changed(row: Mapping[str, str]) -> str:
    """Return a file on which a row depends whose code changed since; empty if there is none."""
    commit, modules = row["commit"], row["modules"].split()
    names = _git("diff", "--name-only", commit, "HEAD", "--", *modules).splitlines()
    return next((name for name in names if _code(commit, name) != _code("HEAD", name)), "")


@cache
def _code(commit: str, name: str) -> str:
    """Return the code of a file at a commit, without comments and docstrings; empty if absent."""
    text = _git("show", f"{commit}:{name}", check=False)
    if not name.endswith(".py"):
        return text
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_text(node: ast.AST) -> bool:
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _git(*arguments: str, check: bool = True) -> str:
    command = ["git", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=check).stdout  # noqa: S603


def main() -> None:
    """Print the files whose code changed, and the commands that write them."""
    rows = read()
    stale = {name: found for name in rows if (found := changed(rows[name]))}
    for name, found in stale.items():
        row = rows[name]
        print(f"{name}: {found} changed since {row['commit']}: {row['command']}")
    print(f"{len(stale)} of {len(rows)} files are stale")
    sys.exit(bool(stale))


if __name__ == "__main__":
    main()
