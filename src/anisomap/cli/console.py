"""What the commands show: messages, tables, progress. Results to stdout, the rest to stderr."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import isnan

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

_UNBROKEN = 12  # characters that a narrow terminal leaves together

console = Console(highlight=False, soft_wrap=False)
errors = Console(stderr=True, highlight=False, soft_wrap=True)


def complain(message: str) -> None:
    """Say what is wrong, in red, on stderr."""
    errors.print(f"[bold red]error:[/] {escape(message)}")


def warn(message: str) -> None:
    """Say what is doubtful, in yellow, on stderr."""
    errors.print(f"[bold yellow]warning:[/] {escape(message)}")


def show_facts(title: str, facts: dict[str, str]) -> None:
    """Print names and values, a line each."""
    table = Table(
        title=title, title_justify="left", title_style="bold", box=None, show_header=False
    )
    table.add_column(style="dim")
    table.add_column(overflow="fold")
    for name, value in facts.items():
        table.add_row(escape(name), escape(value))
    console.print(table)


def show_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows; a column is set right if all it holds looks like numbers."""
    table = Table(
        title=title, title_justify="left", title_style="bold", box=None, header_style="dim"
    )
    for i, column in enumerate(columns):
        numeric = all(_is_number(row[i]) for row in rows)
        table.add_column(
            escape(column),
            justify="right" if numeric else "left",
            overflow="fold",
            min_width=min(_UNBROKEN, max(len(text) for text in (column, *(r[i] for r in rows)))),
        )
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)


@contextmanager
def progress(task: str) -> Iterator[Callable[[float], None]]:
    """Show that something goes on, and how far it is; gone from the screen once it is done.

    Parameters
    ----------
    task : str
        What goes on. The library's own log messages replace it as they come.

    Yields
    ------
    callable
        Takes the share done, from 0 to 1; until it is called, only time passes.
    """
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(pulse_style="dim"),
        TimeElapsedColumn(),
    )
    library = logging.getLogger("anisomap")
    silent = not errors.is_terminal  # a bar in a log file is noise
    with Progress(*columns, console=errors, transient=True, disable=silent) as display:
        shown = display.add_task(escape(task), total=None)
        handler = _Describing(lambda text: display.update(shown, description=escape(text)))
        level = library.level
        library.addHandler(handler)
        library.setLevel(logging.INFO)
        try:
            yield lambda share: display.update(shown, completed=share, total=1.0)
        finally:
            library.removeHandler(handler)
            library.setLevel(level)


class _Describing(logging.Handler):
    """Hands every message to a function."""

    def __init__(self, describe: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self._describe = describe

    def emit(self, record: logging.LogRecord) -> None:
        self._describe(record.getMessage())


def number(value: float | None, digits: int = 4) -> str:
    """Write a number with some significant digits; a dash if there is none."""
    return "-" if value is None or isnan(value) else f"{value:.{digits}g}"


def percent(share: float) -> str:
    """Write a share as per cent."""
    return f"{share:.1%}"


def _is_number(text: str) -> bool:
    return text == "-" or text.removesuffix("%").lstrip("-").replace(".", "").isdigit()
