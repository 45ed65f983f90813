"""Run the code blocks of the documentation, each page as one program."""

import pytest
from sybil import Sybil
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser

from documents import collector, run_commands

# Pages whose commands run, too: they make the files that they use.
_RUNNABLE = [
    "getting-started.md",
    "how-to/check-a-layout.md",
    "how-to/compare-two-maps.md",
    "how-to/contacts-and-spikes.md",
    "how-to/map-a-skin.md",
    "how-to/place-a-map.md",
    "how-to/score-a-map.md",
    "reference/formats.md",
    "robots/*.md",
]
commands = Sybil(
    [PythonCodeBlockParser(), CodeBlockParser("sh", run_commands)],
    patterns=_RUNNABLE,
)
others = Sybil(
    [PythonCodeBlockParser()],
    patterns=["*.md"],
    excludes=_RUNNABLE,
)
pytest_collect_file = collector(commands, others)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all pages slow: each of them makes several maps."""
    for item in items:
        if "docs" in item.path.parts and item.path.suffix == ".md":
            item.add_marker(pytest.mark.slow)
