"""The page on architecture names every package and only files that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "anisomap"
PAGE = (ROOT / "docs/explanation/architecture.md").read_text("utf-8")


def named(text: str) -> set[str]:
    return set(re.findall(r"`([\w/.]+)`", text))


def exists(name: str) -> bool:
    return (PACKAGE / name).exists() or (PACKAGE / f"{name}.py").exists()


def test_the_first_table_names_every_package():
    table = PAGE.partition("do not import one another")[0]
    modules = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    public = {name for name in modules if not name.startswith("_")}
    assert public <= named(table)


def test_every_file_that_answers_a_question_exists():
    answers = PAGE.partition("## Where do I find")[2].partition("## Conventions")[0]
    paths = {name for name in named(answers) if "/" in name or name.endswith(".py")}
    paths -= {"tests/x/", "tests/test_x.py"}  # placeholders
    missing = {name for name in paths if not exists(name)}
    assert len(paths) > 15
    assert not missing
