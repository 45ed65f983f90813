"""Help on one screen: what a command is for, its frequent options in a line each, and examples."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Sequence
from inspect import getdoc
from typing import TYPE_CHECKING, Any

from anisomap.cli.parameters import expert_group

if TYPE_CHECKING:
    from cyclopts import App, Argument

HELP_ALL = "--help-all"
"""Flag that describes all options in full."""

_WIDTH = 80
_HEADING = "Examples\n--------\n"  # of a docstring


def commands_page(app: App, names: Iterable[str]) -> str:
    """Return the list of the commands, and how they are used."""
    rows = [(name, _sentence(_doc(app[name]))) for name in names]
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


def command_page(command: App, title: str) -> str:
    """Return the help of a command: options of the group for experts are named only."""
    given, shown, others = [], [], []
    for one in command.assemble_argument_collection(parse_docstring=True):
        if not one.show:
            continue
        if not one.name.startswith("-"):
            given.append(one)
        elif expert_group in (one.parameter.group or ()):  # type: ignore[operator]
            others.append(_long_name(one))
        else:
            shown.append(one)
    words = " ".join(_positional(one) for one in given)
    doc = _doc(command)
    lines = [f"Usage: {title} {words} [OPTIONS]".replace("  ", " "), "", f"{_sentence(doc)}.", ""]
    lines += _aligned([(_names(one), _sentence(one.parameter.help or "")) for one in shown])
    lines += ["Examples:", *_examples(doc)]
    if others:
        more = f"More ({HELP_ALL} describes them): {', '.join(others)}"
        lines += textwrap.wrap(more, _WIDTH, break_on_hyphens=False)
    return "\n".join(lines)


def _doc(command: App) -> str:
    function: Callable[..., Any] | None = command.default_command
    return getdoc(function) or ""


def _examples(doc: str) -> list[str]:
    return [f"  {line}" for line in doc.partition(_HEADING)[2].splitlines()]


def _sentence(text: str) -> str:
    """Return the first sentence of a text on one line, without its full stop."""
    first = " ".join(text.partition("\n\n")[0].split()).partition(". ")[0]
    return first.replace("`", "").removesuffix(".")


def _positional(argument: Argument) -> str:
    name = f"{argument.name} ..." if _is_list(argument) else argument.name
    return name if argument.required else f"[{name}]"


def _names(argument: Argument) -> str:
    """Return the names of an option and what it takes, as in ``-o, --output FILE``."""
    short = [name for name in argument.names if len(name) == 2]
    return f"{', '.join([*short, _long_name(argument)])} {_value(str(argument.hint))}".rstrip()


def _long_name(argument: Argument) -> str:
    """Return the long name of an option, of a switch that is on by default the one that ends it."""
    negative = [name for name in argument.names if name.startswith("--no-")]
    return negative[0] if argument.field_info.default is True else argument.name


def _value(hint: str) -> str:
    """Say what an option of a type takes; nothing for a switch."""
    kinds = {"bool": "", "Path": "FILE", "Literal": "CHOICE", "int": "N", "float": "X"}
    return next((shown for kind, shown in kinds.items() if kind in hint), "TEXT")


def _is_list(argument: Argument) -> bool:
    return str(argument.hint).startswith("list")


def _aligned(rows: Sequence[tuple[str, str]]) -> list[str]:
    width = max((len(name) for name, _ in rows), default=0) + 2
    return [f"  {name:{width}}{text}" for name, text in rows]
