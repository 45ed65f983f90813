"""The application: its commands, and what becomes of errors."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterable

from cyclopts import App, CycloptsError

from anisomap._version import __version__
from anisomap.cli.console import complain, console, warn
from anisomap.errors import AnisomapError, AnisomapWarning

BAD_INPUT = 2
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED = 130

app = App(
    name="anisomap",
    help="Find out where the sensors of a skin are, from nothing but what they read.",
    version=__version__,
    help_epilogue="A map is known up to rotation, translation, scale and mirror image.",
    console=console,
    help_format="plaintext",
)

# Commands are named, not imported: only the one that runs costs its imports.
for name, target, summary in (
    ("map", "map:map_recording", "Make a map from a recording."),
    ("info", "info:info", "Say what is in a recording, before anyone spends time on it."),
    ("score", "score:score_map", "Compare a map with the true positions of its sensors."),
    ("convert", "convert:convert", "Write a map in another format, or in metres."),
    ("compare", "compare:compare", "Score several methods on recordings with known positions."),
    ("methods", "listing:methods", "List the methods and the similarities."),
    ("formats", "listing:formats", "List the file formats."),
    ("demo", "demo:demo", "Simulate a skin, map it, and score the map."),
    ("simulate", "simulate:simulate_body", "Make a recording whose truth is known."),
    ("paper", "paper:paper", "Make every figure and table of the paper again."),
    ("coverage", "coverage:coverage", "Tell how long a skin must be stimulated."),
    ("spoil", "spoil:spoil", "Break sensors of a recording, on the record."),
    ("bodies", "listing:bodies", "List the bodies that can be simulated."),
    ("scenarios", "listing:scenarios", "List what can happen to a body, and its parameters."),
    ("faults", "listing:faults", "List what can go wrong with a recording."),
):
    app.command(f"anisomap.cli.commands.{target}", name=name, help=summary)


def main(arguments: Iterable[str] | None = None) -> None:
    """Run a command, and turn whatever goes wrong into one sentence and an exit code.

    Parameters
    ----------
    arguments : iterable of str, optional
        Those of the process unless given.

    Raises
    ------
    SystemExit
        Always: 0 if all went well, 2 for bad input, 70 for a defect of ours, 130 if interrupted.
    """
    sys.exit(_exit_code(None if arguments is None else list(arguments)))


def _exit_code(arguments: list[str] | None) -> int:
    try:
        _run(arguments)
    except CycloptsError as error:
        return _failed(f"{error} (see --help)", BAD_INPUT)
    except AnisomapError as error:
        return _failed(str(error), BAD_INPUT)
    except MemoryError:
        return _failed("there is not enough memory; map fewer sensors or frames", BAD_INPUT)
    except KeyboardInterrupt:
        return _failed("interrupted; nothing was half-written", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has gone (`anisomap info x | head`), which is no error; without
        # this, flushing stdout at exit would complain once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        if os.environ.get("ANISOMAP_DEBUG"):
            raise
        what = f"{type(error).__name__}: {error}"
        return _failed(
            f"a defect in anisomap ({what}); please report it, with what it says when "
            "ANISOMAP_DEBUG=1 is in the environment",
            INTERNAL_ERROR,
        )
    return 0


def _run(arguments: list[str] | None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # those of other packages are not the user's to mend
        warnings.simplefilter("always", AnisomapWarning)
        warnings.showwarning = lambda message, *_, **__: warn(str(message))
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")


def _failed(message: str, code: int) -> int:
    complain(message)
    return code
