"""Readers that end their process, or never end, for tests of the process that reads files."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from anisomap.io.stream import Block, Stream


@contextmanager
def open_recording(path, options):
    """Yield a stream of one block, or of none."""

    def blocks() -> Iterator[Block]:
        if options.select != "at once":
            yield Block(np.eye(4), 0.5)
        os.kill(os.getpid(), signal.SIGSEGV)

    yield Stream(path, 4, blocks())


def contents(path, options):
    """Compute without end."""
    while True:
        del path, options
        path = options = ()


def missing_key(path):
    """Fail as a library does that does not expect what it reads."""
    yield {}["b"]
