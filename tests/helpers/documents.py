"""Documents as tests: all examples of a document are one test.

Later examples use names and files of earlier ones, so they must run in order in one process;
Sybil's own integration makes each example a test, which pytest-xdist deals out to any worker.
"""

import contextlib
import importlib
import shlex
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sybil import Example, Sybil


class DocumentFile(pytest.File):
    """A document with examples."""

    sybil: Sybil

    def collect(self) -> Iterator[pytest.Item]:
        if any(self.sybil.parse(self.path).examples()):
            yield Examples.from_parent(self, name="examples")


class Examples(pytest.Item):
    """The examples of a document, run in an empty folder."""

    parent: DocumentFile

    def runtest(self) -> None:
        document = self.parent.sybil.parse(self.path)
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            for example in document.examples():
                example.evaluate()

    def reportinfo(self) -> tuple[Path, int | None, str]:
        return self.path, 0, f"examples of {self.path.name}"


def collector(*sybils: Sybil) -> Callable[..., DocumentFile | None]:
    """Make the hook that collects the documents matched by one of these."""

    def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> DocumentFile | None:
        for sybil in sybils:
            if sybil.should_parse(file_path):
                document = DocumentFile.from_parent(parent, path=file_path)
                document.sybil = sybil
                return document
        return None

    return pytest_collect_file


def run_commands(example: Example) -> None:
    """Call anisomap line by line, as a shell would; every call must succeed."""
    for line in example.parsed.splitlines():
        program, *arguments = shlex.split(line, comments=True) or ["#"]
        if program == "#":
            continue
        # Imported late, since conftest.py imports this module before it sets the threads of numpy.
        if program != "anisomap" or importlib.import_module("anisomap.cli.app").run(arguments):
            pytest.fail(line)
