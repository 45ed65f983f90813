"""Fixtures that several rooms share."""

import os
import signal
from pathlib import Path

import pytest

SHARED = Path(os.environ.get("ANISOMAP_SHARED", Path(__file__).parents[2] / "shared"))


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """Let tests interrupt the processes that they start.

    A shell starts background jobs with SIGINT ignored, and nohup with SIGHUP ignored; child
    processes inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP"):  # not on Windows
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session")
def recordings_folder() -> Path:
    """Give the folder of real recordings; skip where it is absent, as their licence is not ours."""
    folder = SHARED / "recordings"
    if not folder.is_dir():
        pytest.skip("the real recordings are not here (set ANISOMAP_SHARED to their parent folder)")
    return folder


@pytest.fixture(scope="session")
def hard_recordings_folder() -> Path:
    """Give the folder of recordings of whole bodies and other arrays; skip where it is absent."""
    folder = SHARED / "recordings-hard"
    if not folder.is_dir():
        pytest.skip("the hard recordings are not here (set ANISOMAP_SHARED to their parent folder)")
    return folder


@pytest.fixture
def machine_with(monkeypatch):
    """Return a function that sets the physical memory that the operating system reports."""
    ask = os.sysconf

    def set_memory(n_bytes):
        answers = {"SC_PAGE_SIZE": 1, "SC_PHYS_PAGES": n_bytes}
        monkeypatch.setattr(os, "sysconf", lambda name: answers.get(name) or ask(name))

    return set_memory
