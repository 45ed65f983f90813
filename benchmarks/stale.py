"""List tables and pictures of the documentation whose modules changed since they were measured.

From the root of the repository: ``python -m benchmarks.stale``. ``docs/development/measured.csv``
holds the commit at which each file was measured, the modules that it depends on, and the command
that writes it; who measures a file again states the commit there. The exit status is 1 if a file is
stale.
"""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Iterator, Mapping
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


def changes(row: Mapping[str, str]) -> list[str]:
    """Return the changes of the modules of a file since it was measured, one a line."""
    command = ["git", "log", "--oneline", f"{row['commit']}..HEAD", "--", *row["modules"].split()]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    return done.stdout.splitlines()


def main() -> None:
    """Print the files whose modules changed, and the commands that write them."""
    rows = read()
    stale = {name: found for name in rows if (found := changes(rows[name]))}
    for name, found in stale.items():
        print(f"{name}: {len(found)} commits since {rows[name]['commit']}: {rows[name]['command']}")
    print(f"{len(stale)} of {len(rows)} files are stale")
    sys.exit(bool(stale))


if __name__ == "__main__":
    main()
