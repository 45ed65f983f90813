"""Run the code blocks of the documentation, each page as one program in an empty folder.

Commands run as well, but for those in blocks of the kind ``console``, which need a robot, a network
or a file that nobody has. Blocks of the kind ``py`` are only shown.
"""

import pytest
from sybil import Sybil
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser

from documents import collector, run_commands

pages = Sybil(
    [PythonCodeBlockParser(), CodeBlockParser("sh", run_commands)],
    patterns=["*.md"],
    excludes=["development/*.md"],
)
pytest_collect_file = collector(pages)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all pages slow: each of them makes several maps."""
    for item in items:
        if "docs" in item.path.parts and item.path.suffix == ".md":
            item.add_marker(pytest.mark.slow)
