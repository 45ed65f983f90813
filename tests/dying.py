"""Work at which a process dies; a module of its own, so that other processes can import it."""

import os
import signal
from pathlib import Path

from anisomap.numerics.accumulators import Moments


class Dying:
    """Makes moments of chunks; but the first process that is asked to, it kills."""

    def __init__(self, folder: Path) -> None:
        self.mark, self.owner = folder / "dead", os.getpid()

    def __call__(self, chunk):
        if os.getpid() != self.owner and not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Moments.of(chunk)
