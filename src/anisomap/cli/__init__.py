"""The command line, with one module per command."""

import signal
import sys
from _thread import interrupt_main
from collections.abc import Iterable
from threading import Timer, current_thread, main_thread
from types import FrameType

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells report it."""

INTERRUPTION = "interrupted; no file was left half-written"
"""Message after Ctrl-C."""

_AGAIN_S = 0.01  # longer than the callback


def main(arguments: Iterable[str] | None = None) -> None:
    """Run the command line of this process: see `anisomap.cli.app.main`.

    If the process is terminated, temporary files are removed before it ends.
    """
    if current_thread() is main_thread():
        for name in ("SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), _stop)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _interrupt)
    code = INTERRUPTED
    try:
        # Imported here, so that an interruption of the imports is reported as any other.
        from anisomap.cli.app import run  # noqa: PLC0415

        code = run(None if arguments is None else list(arguments))
    except KeyboardInterrupt:
        print(f"error: {INTERRUPTION}", file=sys.stderr)  # noqa: T201
    finally:
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process ends, without a traceback
    sys.exit(code)


def _interrupt(_: int, frame: FrameType | None) -> None:
    code = frame and frame.f_code
    if code and code.co_name == "cb" and "importlib" in code.co_filename:
        # Python prints and ignores exceptions in this callback of its imports: interrupt again.
        Timer(_AGAIN_S, interrupt_main).start()
    else:
        raise KeyboardInterrupt


def _stop(number: int, _: FrameType | None) -> None:
    signal.signal(number, signal.SIG_DFL)  # a second signal ends the process at once
    sys.exit(128 + number)
