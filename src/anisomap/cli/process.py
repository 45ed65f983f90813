"""The process of a command line: what it does when it is interrupted or terminated."""

from __future__ import annotations

import gc
import signal
import sys
from _thread import interrupt_main
from threading import Timer, current_thread, main_thread
from types import CodeType, FrameType

from anisomap.cli import INTERRUPTED, INTERRUPTION, end
from anisomap.cli.app import run

_AGAIN_S = 0.01  # short for a user, long for a processor
_EXTENSIONS, _CALLBACK = "ExtensionFileLoader.", "_get_module_lock.<locals>.cb"  # of importlib


def run_process(arguments: list[str] | None) -> None:
    """Run a command, and end the process with its exit code.

    Parameters
    ----------
    arguments : list of str or None
        None for those of the process.

    Raises
    ------
    SystemExit
        Always.
    """
    signals = _Signals()
    is_main = current_thread() is main_thread()
    if is_main:
        signals.handle()
    code = INTERRUPTED
    try:
        code = run(arguments, signals.received)
    except KeyboardInterrupt:
        print(f"error: {INTERRUPTION}", file=sys.stderr)  # noqa: T201
    finally:
        if is_main:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process ends, without a traceback
        gc.freeze()  # Python would search all objects for unreachable ones before it ends: .2 s
    sys.exit(code)


class _Signals:
    """Handlers of signals that ask the process to end; `received` lists what arrived."""

    def __init__(self) -> None:
        self.received: list[int] = []

    def handle(self) -> None:
        """Handle the signals, except those that the process was started to ignore."""
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            # `nohup` ignores SIGHUP, so that a command outlives its terminal.
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._stop)
        if signal.getsignal(signal.SIGINT) is end:
            signal.signal(signal.SIGINT, self._interrupt)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.received.append(number)
        if not _deferred(number, frame):
            raise KeyboardInterrupt

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.received.append(number)
        if not _deferred(number, frame):
            signal.signal(number, signal.SIG_DFL)  # a second signal ends the process at once
            sys.exit(128 + number)


def _deferred(number: int, frame: FrameType | None) -> bool:
    """Return whether an exception would be lost here; if so, the signal comes again.

    Extension modules replace an exception within their import by an ImportError, and Python
    ignores one within the callback of the locks of imports.
    """
    while frame is not None and not _loses_exceptions(frame.f_code):
        frame = frame.f_back
    if frame is not None:
        again = Timer(_AGAIN_S, interrupt_main, (number,))
        again.daemon = True
        again.start()
    return frame is not None


def _loses_exceptions(code: CodeType) -> bool:
    in_import = code.co_filename.startswith("<frozen importlib")
    return in_import and code.co_qualname.startswith((_EXTENSIONS, _CALLBACK))
