"""Run the code blocks of the documentation, each page as one program."""

import warnings

import pytest
from sybil import Sybil
from sybil.parsers.myst import PythonCodeBlockParser


@pytest.fixture(autouse=True, scope="module")
def _short_recordings_are_meant() -> None:
    warnings.simplefilter("ignore")


pytest_collect_file = Sybil(parsers=[PythonCodeBlockParser()], patterns=["*.md"]).pytest()
