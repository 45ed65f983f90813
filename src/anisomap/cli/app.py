"""The application: its commands, its errors as messages and exit codes, and its signals."""

from __future__ import annotations

import gc
import os
import signal
import sys
import warnings
from _thread import interrupt_main
from collections.abc import Mapping, Sequence
from inspect import getdoc
from threading import Timer, current_thread, main_thread
from types import CodeType, FrameType, MappingProxyType

from cyclopts import App, CycloptsError, Parameter

from anisomap._version import __version__
from anisomap.cli import INTERRUPTED, INTERRUPTION, end
from anisomap.cli.console import (
    console,
    discard_stdout,
    prepare_streams,
    print_error,
    print_warning,
)
from anisomap.errors import AnisomapError, AnisomapWarning

BAD_INPUT = 2
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h

app = App(
    name="anisomap",
    help="Reconstruct the positions of the sensors of a robot skin from their readings.",
    version=__version__,
    help_epilogue="Maps are known up to rotation, translation, scale and reflection.",
    console=console,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,  # `run` reports it
    default_parameter=Parameter(json_list=False, json_dict=False),  # "[a].csv" is a file name
)

COMMANDS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "map": ("recording:map_recording", "Make a map from a recording."),
        "live": ("live:live", "Map a skin while it is touched, and show where to touch next."),
        "info": ("recording:info", "Summarise a recording and flag faulty sensors."),
        "score": ("comparison:score_map", "Score a map against reference positions."),
        "diff": (
            "maps:diff",
            "Compare two maps of one skin: which sensors moved, appeared or were lost.",
        ),
        "update": ("maps:update", "Add the evidence of a new recording to a map."),
        "place": ("placement:place_map", "Place a map in the frame of the robot, in metres."),
        "check": ("layout:check", "Check sensor positions against a recording."),
        "convert": ("maps:convert", "Write a map in another format, or in metres."),
        "compare": (
            "comparison:compare",
            "Score several methods on recordings with known positions.",
        ),
        "methods": ("listing:methods", "List the methods and the similarities."),
        "formats": ("listing:formats", "List the file formats."),
        "demo": ("demo:demo", "Simulate a skin, map it, and score the map."),
        "simulate": (
            "simulation:simulate_body",
            "Simulate a recording with known sensor positions.",
        ),
        "paper": ("demo:paper", "Reproduce every figure and table of the paper."),
        "coverage": ("simulation:coverage", "Estimate how long a skin must be stimulated."),
        "spoil": ("simulation:spoil", "Inject documented faults into a recording."),
        "repair": ("recording:repair", "Mend the faults of a recording."),
        "bodies": ("listing:bodies", "List the bodies that can be simulated."),
        "scenarios": (
            "listing:scenarios",
            "List the scenarios of simulation and their parameters.",
        ),
        "faults": ("listing:faults", "List the faults that can be injected."),
    }
)
"""Where the function of each command is, and a line for the list of commands. Commands are imported
when they run, so that --help stays fast."""

for _name, (_target, _summary) in COMMANDS.items():
    app.command(f"anisomap.cli.commands.{_target}", name=_name, help=_summary)

app.register_install_completion_command(
    help="Install completion for the current shell (bash, zsh or fish)."
)


def describe(name: str) -> None:
    """Show the docstring of a command on its help page, instead of its line in `COMMANDS`."""
    command = app[name]
    text = (getdoc(command.default_command) or "").partition("\n\nParameters\n")[0]
    command.help = "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def run(arguments: list[str] | None, received: Sequence[int] = ()) -> int:
    """Run a command, report any error as one sentence, and return the exit code."""
    prepare_streams()
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        return _failed(INTERRUPTION, INTERRUPTED)
    except Exception as error:
        if signal.SIGINT in received:
            return _failed(INTERRUPTION, INTERRUPTED)
        return 128 + received[0] if received else _report(error)


def _report(error: Exception) -> int:
    """Print an error as one sentence; return the exit code."""
    match error:
        case CycloptsError():
            return _failed(f"{error} (see --help)", BAD_INPUT)
        case AnisomapError():
            return _failed(str(error), BAD_INPUT)
        case MemoryError():
            return _failed("not enough memory; map fewer sensors or frames", BAD_INPUT)
        case BrokenPipeError():
            discard_stdout()  # the reader has closed the pipe, which is not an error
            return 0
    if os.environ.get("ANISOMAP_DEBUG"):
        raise error
    description = f"{type(error).__name__}: {error}"
    return _failed(
        f"a defect in anisomap ({description}); please report it with the traceback that "
        "ANISOMAP_DEBUG=1 in the environment prints",
        INTERNAL_ERROR,
    )


def _run(arguments: list[str] | None) -> int:
    """Run a command; return its exit code, which is 0 unless the command returns another."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # users cannot act on warnings of other packages
        warnings.simplefilter("always", AnisomapWarning)
        warnings.showwarning = lambda message, *_, **__: print_warning(str(message))
        given = sys.argv[1:] if arguments is None else arguments
        if given and given[0] in COMMANDS:
            describe(given[0])
        code = app(given, exit_on_error=False, print_error=False, result_action="return_value")
    return code if isinstance(code, int) else 0


def _failed(message: str, code: int) -> int:
    print_error(message)
    return code


_AGAIN_S = 0.01  # short for a user, long for a processor
_EXTENSIONS, _CALLBACK = "ExtensionFileLoader.", "_get_module_lock.<locals>.cb"  # of importlib


def run_process(arguments: list[str] | None) -> None:
    """Run a command, and end the process with its exit code."""
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
