"""Run the code blocks of the documentation, each page as one program."""

import shlex

import pytest
from sybil import Example, Sybil
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser
from tests.documents import collector

from anisomap.cli import main


def _run_commands(example: Example) -> None:
    """Call anisomap line by line, as a shell would; every call must succeed."""
    for line in example.parsed.splitlines():
        program, *arguments = shlex.split(line, comments=True) or ["#"]
        if program == "#":
            continue
        if program != "anisomap" or _exit_code(arguments):
            pytest.fail(line)


def _exit_code(arguments: list[str]) -> int:
    try:
        main(arguments)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


# Pages whose commands run, too: they make the files that they use.
_RUNNABLE = [
    "getting-started.md",
    "how-to/map-a-skin.md",
    "how-to/score-a-map.md",
    "reference/formats.md",
    "robots/*.md",
]
commands = Sybil(
    [PythonCodeBlockParser(), CodeBlockParser("sh", _run_commands)],
    patterns=_RUNNABLE,
)
others = Sybil(
    [PythonCodeBlockParser()],
    patterns=["*.md"],
    excludes=_RUNNABLE,
)
pytest_collect_file = collector(commands, others)
