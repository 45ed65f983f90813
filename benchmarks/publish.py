r"""Copy results of benchmarks and of the paper to the docs, and update the tables in documents.

From the root of the repository: ``python -m benchmarks.publish``. Folders that are absent are
skipped; a file is copied where the docs have one of its name. For the numbers of the paper, run

    anisomap paper --output-dir paper-out --only settings
    anisomap paper --output-dir paper-out/unseen --first-seed 41 --recordings recordings \
        --only claims --only figure-3 --only figure-4 --only figure-7 --only ablations --only reach
"""

from __future__ import annotations

import shutil
from pathlib import Path

from benchmarks import numbers

MEASURED = ("bench", "dimension", "faults", "noise", "quality", "trust")
DOCS = Path("docs")
FOLDERS = (DOCS / "development", DOCS / "results", DOCS / "_static")
COPIED = {
    "settings/settings.csv": DOCS / "results",
    "settings/settings.png": DOCS / "_static",
    "unseen/claims/claims-cases.csv": DOCS / "results",
    "unseen/reach/reach.csv": DOCS / "results",
    **{
        f"unseen/{name}/{name}.png": DOCS / "_static"
        for name in ("figure-3", "figure-4", "figure-7", "reach")
    },
}
"""What is published of the paper besides the tables of its pages."""


def main() -> None:
    """Copy the files, and update the documents."""
    for path in [path for folder in MEASURED for path in sorted(Path(folder).rglob("*.*"))]:
        for target in FOLDERS:
            if (target / path.name).is_file():
                shutil.copyfile(path, target / path.name)
    paper = Path("paper-out")
    for name, copied in COPIED.items():
        if (paper / name).exists():
            shutil.copy(paper / name, copied)
    tables = str(DOCS / "results")
    for results, documents in {
        "quality": ("README.md", "paper/paper.md", "docs/explanation/accuracy.md"),
        "paper-out/unseen": tuple(map(str, sorted((DOCS / "explanation").glob("paper*.md")))),
    }.items():
        numbers.main([results, tables, *documents])


if __name__ == "__main__":
    main()
