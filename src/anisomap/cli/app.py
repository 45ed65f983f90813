"""The application: commands, help pages of one screen, error messages, and signals."""

from __future__ import annotations

import gc
import os
import signal
import sys
import textwrap
import threading
import time
import warnings
from _thread import start_new_thread
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from inspect import getdoc
from types import MappingProxyType
from typing import Any

from cyclopts import App, Argument, CycloptsError, MissingArgumentError, Parameter

from anisomap._version import __version__
from anisomap.cli import INTERRUPTED, INTERRUPTION, end
from anisomap.cli.console import (
    Printer,
    console,
    discard,
    errors,
    prepare_streams,
    print_error,
    print_warning,
)
from anisomap.cli.parameters import expert_group
from anisomap.errors import AnisomapError, AnisomapWarning, InputError

BAD_INPUT = 2
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h

HELP_ALL = "--help-all"
"""Flag that describes all options in full."""

_BRIEF = frozenset({"--help", "-h"})
_WIDTH = 80
_HEADING = "Examples\n--------\n"  # of a docstring


def _shown(default: object) -> str | None:
    """Return the default of an option for help; None for switches and options without default."""
    return None if isinstance(default, bool) or default in (None, "", []) else str(default)


app = App(
    name="anisomap",
    help="Reconstruct the positions of the sensors of a robot skin from their readings.",
    version=__version__,
    help_flags=["--help", "-h", HELP_ALL],
    console=console,
    help_format="markdown",
    # "[a].csv" is a file name; switches and lists have no negative form unless they name one.
    default_parameter=Parameter(json_list=False, json_dict=False, negative=(), show_default=_shown),
)

COMMANDS: Mapping[str, str] = MappingProxyType(
    {
        "map": "recording:map_recording",
        "live": "live:live",
        "info": "recording:info",
        "repair": "recording:repair",
        "check": "maps:check",
        "place": "placement:place_map",
        "score": "maps:score_map",
        "diff": "maps:diff",
        "convert": "maps:convert",
        "simulate": "simulation:simulate_body",
        "paper": "simulation:paper",
        "demo": "simulation:demo",
        "list": "listing:list_kind",
    }
)
"""Location of the function of each command. Functions import libraries when they run, so that help
pages and errors of options appear immediately."""

for _i, (_name, _target) in enumerate(COMMANDS.items()):
    app.command(f"anisomap.cli.commands.{_target}", name=_name, sort_key=_i)

app.register_install_completion_command(
    help="Install completion for the current shell (bash, zsh or fish)."
)


def load_commands() -> None:
    """Import all commands, since the list of commands shows their docstrings."""
    for name in COMMANDS:
        app[name]


def run(arguments: list[str] | None, received: Sequence[int] = ()) -> int:
    """Run a command, report any error as one sentence, and return the exit code."""
    prepare_streams()
    given = sys.argv[1:] if arguments is None else arguments
    errors.as_json, console.arguments = "--json" in given, given
    try:
        return _run(given)
    except KeyboardInterrupt as interrupted:
        return _failed(str(interrupted) or INTERRUPTION, INTERRUPTED)
    except Exception as error:
        if signal.SIGINT in received:
            return _failed(INTERRUPTION, INTERRUPTED)
        return 128 + received[0] if received else _report(error)


def _report(error: Exception) -> int:
    """Print an error as one sentence; return the exit code."""
    match error:
        case CycloptsError(__cause__=AnisomapError() as refused):
            return _failed(str(refused), BAD_INPUT)
        case CycloptsError():
            return _failed(_misuse(error), BAD_INPUT)
        case AnisomapError():
            return _failed(str(error), BAD_INPUT)
        case MemoryError():
            return _failed("not enough memory; map fewer sensors or frames", BAD_INPUT)
        case BrokenPipeError():
            discard(sys.stdout)  # it is not an error if the reader closes the pipe
            return 0
    if os.environ.get("ANISOMAP_DEBUG"):
        raise error
    description = f"{type(error).__name__}: {error}"
    return _failed(
        f"a defect in anisomap ({description}); please report it with the traceback that "
        "ANISOMAP_DEBUG=1 in the environment prints",
        INTERNAL_ERROR,
    )


def _misuse(error: CycloptsError) -> str:
    """Describe the error in the arguments of a command."""
    if not isinstance(error, MissingArgumentError) or error.argument is None:
        return f"{str(error).rstrip('.')} (see --help)"
    name = error.keyword or error.argument.name
    what = f"{name} needs a value" if name.startswith("-") else f"{name} is missing"
    return f"{what} (see anisomap {' '.join(error.command_chain or ())} --help)"


def _run(given: list[str]) -> int:
    """Run a command; return its exit code, 0 by default."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # users cannot act on warnings of other packages
        warnings.simplefilter("always", AnisomapWarning)
        said = set[str]()

        def say_once(message: Warning | str, *_: object, **__: object) -> None:
            if str(message) not in said:
                said.add(str(message))
                print_warning(str(message))

        warnings.showwarning = say_once
        if given and not given[0].startswith("-") and given[0] not in COMMANDS:
            near = get_close_matches(given[0], COMMANDS, n=1)
            hint = f"did you mean {near[0]}?" if near else "anisomap --help lists the commands"
            raise InputError(f"there is no command {given[0]!r}; {hint}")
        if not given or given[0] in app.help_flags:
            load_commands()
        if not given or _BRIEF.intersection(given):
            name = next((word for word in given if word in COMMANDS), "")
            console.out(_command_page(name) if name else _commands_page())
            return 0
        command, bound, _ = app.parse_args(given, exit_on_error=False, print_error=False)
        printer = None
        if "printer" in bound.signature.parameters:
            printer = bound.arguments.setdefault("printer", Printer())
        code = command(*bound.args, **bound.kwargs)
        if printer is not None:
            printer.finish()
    return code if isinstance(code, int) else 0


def _commands_page() -> str:
    """Return the list of commands, and their usage."""
    rows = [(name, _sentence(_doc(app[name]))) for name in COMMANDS]
    return "\n".join(
        [
            f"Usage: {app.name[0]} COMMAND",
            "",
            f"{_sentence(app.help)}.",
            "Maps are known up to rotation, translation, scale and reflection.",
            "",
            *_aligned(rows),
            "",
            f"{app.name[0]} COMMAND --help describes a command, and {HELP_ALL} all of its options.",
            "Others: --version, --install-completion (bash, zsh or fish)",
        ]
    )


def _command_page(name: str) -> str:
    """Return the help of a command; options of the expert group are only named."""
    given, shown, others = [], [], []
    for one in app[name].assemble_argument_collection(parse_docstring=True):
        if not one.show:
            continue
        if not one.name.startswith("-"):
            given.append(one)
        elif expert_group in (one.parameter.group or ()):  # type: ignore[operator]
            others.append(_long_name(one))
        else:
            shown.append(one)
    words = " ".join(_positional(one) for one in given)
    doc, usage = _doc(app[name]), f"Usage: {app.name[0]} {name} {words} [OPTIONS]"
    lines = [usage.replace("  ", " "), "", f"{_sentence(doc)}.", ""]
    lines += _aligned([(_names(one), _meaning(one)) for one in shown])
    lines += ["Examples:", *(f"  {line}" for line in doc.partition(_HEADING)[2].splitlines())]
    if others:
        more = f"More ({HELP_ALL} describes them): {', '.join(others)}"
        lines += textwrap.wrap(more, _WIDTH, break_on_hyphens=False)
    return "\n".join(lines)


def _doc(command: App) -> str:
    function: Callable[..., Any] | None = command.default_command
    return getdoc(function) or ""


def _sentence(text: str) -> str:
    """Return the first sentence of a text on one line, without its full stop."""
    first = " ".join(text.partition("\n\n")[0].split()).partition(". ")[0]
    return first.replace("`", "").removesuffix(".")


def _meaning(argument: Argument) -> str:
    """Return the first sentence of the help of an option, and its default."""
    default = _shown(argument.field_info.default)
    return _sentence(argument.parameter.help or "") + (f" [{default}]" if default else "")


def _positional(argument: Argument) -> str:
    is_list = str(argument.hint).startswith("list")
    name = f"{argument.name} ..." if is_list else argument.name
    return name if argument.required else f"[{name}]"


def _names(argument: Argument) -> str:
    """Return the names of an option and its placeholder, as in ``-o, --output FILE``."""
    short = [name for name in argument.names if len(name) == 2]
    return f"{', '.join([*short, _long_name(argument)])} {_value(str(argument.hint))}".rstrip()


def _long_name(argument: Argument) -> str:
    """Return the long name of an option; the negative name if a switch is on by default."""
    negative = [name for name in argument.names if name.startswith("--no-")]
    return negative[0] if argument.field_info.default is True else argument.name


def _value(hint: str) -> str:
    """Return the placeholder for an option of a type; empty for a switch."""
    kinds = {"bool": "", "Path": "FILE", "Literal": "CHOICE", "int": "N", "float": "X"}
    return next((shown for kind, shown in kinds.items() if kind in hint), "TEXT")


def _aligned(rows: Sequence[tuple[str, str]]) -> list[str]:
    width = max((len(name) for name, _ in rows), default=0) + 2
    return [f"  {name:{width}}{text}" for name, text in rows]


def _failed(message: str, code: int) -> int:
    print_error(message, code)
    return code


_PATIENCE_S = 3.0  # for the removal of temporary files and the end of other processes


def run_process(arguments: list[str] | None) -> None:
    """Run a command, and end the process with its exit code."""
    ending = _Ending()
    is_main = threading.current_thread() is threading.main_thread()
    if is_main:
        ending.handle()
    code = INTERRUPTED
    try:
        code = run(arguments, ending.received)
    except KeyboardInterrupt:
        print(f"error: {INTERRUPTION}", file=sys.stderr)  # noqa: T201
    finally:
        ending.is_told = True
        if is_main:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # end without a traceback
        gc.freeze()  # a last garbage collection of all objects would take .2 s
    sys.exit(code)


class _Ending:
    """Ends the process on a signal by an exception, or by a thread if the exception is lost.

    Extension modules replace exceptions during their import. Python ignores exceptions within
    callbacks, or leaves locks locked.

    received: Numbers of the received signals.
    is_told: Whether the user was informed.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self.is_told = False

    def handle(self) -> None:
        """Handle the signals, except signals that were ignored at the start, as by nohup."""
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._end)

    def _end(self, number: int, _: object) -> None:
        if self.received:
            return
        self.received.append(number)
        sys.unraisablehook = lambda _: None  # do not report ignored exceptions
        start_new_thread(self._end_anyway, ())
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)

    def _end_anyway(self) -> None:
        time.sleep(_PATIENCE_S)
        if self.received[0] == signal.SIGINT and not self.is_told:
            end()
        os._exit(128 + self.received[0])
