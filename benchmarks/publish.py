r"""Copy results of benchmarks and of the paper to the docs, and update the tables in documents.

From the root of the repository: ``python -m benchmarks.publish``. Folders that are absent are
skipped; a file is copied where the docs have one of its name. For the numbers of the paper, run

    anisomap paper --output-dir paper-out
    anisomap paper --output-dir paper-out/unseen --first-seed 11 \
        --only claims --only figure-3 --only figure-4 --only figure-7 --only ablations
"""

from __future__ import annotations

import shutil
from pathlib import Path

from benchmarks import numbers

MEASURED = ("bench", "dimension", "faults", "noise", "quality", "trust")
DOCS = Path("docs")
FOLDERS = (DOCS / "development", DOCS / "results", DOCS / "_static")
FIRST_SEEDS = {
    "claims/claims.csv": DOCS / "results" / "claims-seeds-1-to-10.csv",
    "settings/settings.csv": DOCS / "results",
    "settings/settings-best.csv": DOCS / "results",
    "settings/settings.png": DOCS / "_static",
}
"""What is published of the seeds 1 to 10 of the paper; the rest is of the seeds 11 to 20."""


def main() -> None:
    """Copy the files, and update the documents."""
    for path in [path for folder in MEASURED for path in sorted(Path(folder).rglob("*.*"))]:
        for target in FOLDERS:
            if (target / path.name).is_file():
                shutil.copyfile(path, target / path.name)
    paper = Path("paper-out")
    for name, copied in FIRST_SEEDS.items():
        if (paper / name).exists():
            shutil.copy(paper / name, copied)
    tables = str(DOCS / "results")
    for results, documents in {
        "quality": ("README.md", "paper/paper.md", "docs/explanation/accuracy.md"),
        "paper-out/unseen": ("docs/explanation/paper.md",),
    }.items():
        numbers.main([results, tables, *documents])


if __name__ == "__main__":
    main()
