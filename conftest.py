"""Run the README's code, and the examples in docstrings."""

import pytest
from sybil import Sybil
from sybil.parsers.doctest import DocTestParser
from sybil.parsers.myst import PythonCodeBlockParser


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """Let examples write into a folder of their own."""
    monkeypatch.chdir(tmp_path)


readme = Sybil([PythonCodeBlockParser()], patterns=["README.md"], fixtures=["elsewhere"])
docstrings = Sybil([DocTestParser()], patterns=["src/**/*.py"])
pytest_collect_file = (readme + docstrings).pytest()
