"""Terminal output: tables and facts on stdout; messages and progress on stderr."""

from __future__ import annotations

import io
import json
import logging
import math
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Any, TypeAlias

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from anisomap.base.wording import join_items, printable, shortened
from anisomap.errors import MAX_CHARACTERS, FileError

MAX_SHOWN = 50
"""Maximum rows of a table and names in a line; with --json, all are printed. Chosen by hand."""

Columns: TypeAlias = Mapping[str, tuple[str, Callable[[Any], str]]]
"""For each heading of a table, a field of the records and the format of this field."""

_MIN_WIDTH = 12  # characters of a value beside its name
_WORD = 20  # maximum characters of an unbroken word, such as the name of a method
_GAP = 2  # characters between columns


class _Terminal(Console):
    """A standard stream; if the reader closes the pipe, the command continues without it.

    as_json: Whether errors are printed as JSON.
    arguments: Arguments of the process, for reports.
    """

    as_json = False
    arguments: Sequence[str] = ()

    def __exit__(self, *raised: Any) -> None:
        """Write the captured text, or drop it if writing fails, as on a full disk."""
        try:
            super().__exit__(*raised)
        except OSError as error:
            discard(self.file)
            self.begin_capture()
            self.end_capture()  # discards unwritten text
            raise FileError(f"cannot write to standard output: {error.strerror}") from error

    def on_broken_pipe(self) -> None:
        self.quiet = True
        discard(self.file)


def discard(stream: IO[str]) -> None:
    """Redirect a stream, including buffered text, to the null device."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


console = _Terminal(highlight=False, soft_wrap=False)
errors = _Terminal(stderr=True, highlight=False, soft_wrap=True)


def print_error(message: str, code: int) -> None:
    """Print an error on stderr; with --json, an object on stdout."""
    text = shortened(_one_line(message), MAX_CHARACTERS)  # escapes lengthen the message
    if errors.as_json:
        console.out(json.dumps({"error": text, "exit_code": code}))
        return
    _complain(Text.assemble(("error:", "bold red"), " ", text))


def print_warning(message: str) -> None:
    """Print a warning on stderr."""
    _complain(Text.assemble(("warning:", "bold yellow"), " ", _one_line(message)))


def _complain(text: Text) -> None:
    with suppress(FileError):  # a full disk, which cannot be reported either
        errors.print(text, soft_wrap=not errors.is_terminal)


def prepare_streams() -> None:
    """Make the standard streams accept any text.

    Characters that the encoding lacks are written as escapes. A closed stream, as by ``>&-`` in a
    shell, is replaced by the null device, so that no output file gets its file descriptor.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _one_line(message: str) -> str:
    return printable(" ".join(message.split()))


def _lines(text: str) -> str:
    return "\n".join(map(printable, text.split("\n")))


@dataclass
class Printer:
    """Printer of the results of a command: as text, or as one JSON object.

    Parameters
    ----------
    as_json
        Print the results, or the error, as one JSON object.
    """

    as_json: Annotated[bool, Parameter(name="--json")] = False

    def __post_init__(self) -> None:
        self.values: dict[str, Any] = {}
        self.failure: FileError | None = None

    def record(self, source: object = None, names: str = "", **values: object) -> None:
        """Record some attributes of an object, and other values, for the JSON object."""
        self.values |= attributes(source, names) | values

    def facts(self, title: str, facts: Mapping[str, str]) -> None:
        """Print names and values, one per line; names without a value are omitted."""
        if self.as_json:
            return
        self._emit(console.print, _text(title, "bold"))
        known = {name: value for name, value in facts.items() if value}
        left = max(map(len, known), default=0) + 3
        for name, value in known.items():
            # Names and paths are not broken in narrow terminals, so that they can be copied.
            lines = textwrap.wrap(
                printable(value),
                max(console.width - left, _MIN_WIDTH),
                break_long_words=False,
                break_on_hyphens=False,
            )
            text = Text.assemble((f" {printable(name)}".ljust(left), "dim"))
            text.append(f"\n{' ' * left}".join(lines))
            self._emit(console.print, text, soft_wrap=True)

    def table(
        self,
        title: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        *,
        max_rows: int | None = None,
    ) -> None:
        """Print at most `max_rows` rows, and the number of others; numbers are right-aligned."""
        if self.as_json:
            return
        shown = rows[:max_rows]
        table = Table(
            title=_text(title, "bold"), title_justify="left", box=None, header_style="dim"
        )
        by_column = list(zip(columns, *shown, strict=True))
        narrow = sum(_GAP + max(map(len, one)) for one in by_column) > console.width
        for column, *cells in by_column:
            longest = max(map(len, cells), default=0)
            width = max(longest, *map(len, column.split())) if narrow else len(column)
            table.add_column(
                Text("\n").join(map(_text, textwrap.wrap(column, max(1, width)))),
                justify="right" if all(map(_is_number, cells)) else "left",
                overflow="fold",
                # Rich narrows the widest columns first, and would break names.
                no_wrap=longest <= _WORD and " " not in "".join(cells),
            )
        for row in shown:
            table.add_row(*map(_text, row))
        self._emit(console.print, table)
        if len(shown) < len(rows):
            self.line(f"  ... and {len(rows) - len(shown)} more")

    def rows(
        self,
        title: str,
        columns: Columns,
        records: Sequence[Mapping[str, Any]],
        *,
        max_rows: int | None = None,
    ) -> None:
        """Print a table of records, unless there are none."""
        rows = [[shown(one[name]) for name, shown in columns.values()] for one in records]
        if rows:
            self.table(title, list(columns), rows, max_rows=max_rows)

    def files(self, files: Sequence[tuple[str, Path]]) -> None:
        """Print and record written files with descriptions of their contents, if there are any."""
        records = [{"content": kind, "path": str(path)} for kind, path in files]
        self.rows("Files", {"content": ("content", str), "path": ("path", str)}, records)
        if files:
            self.record(files=records)

    def notes(self, notes: Iterable[str]) -> None:
        """Print the notes on a result, one per line."""
        for note in notes:
            self.say(f"  note: {note}")

    def names(self, lists: Mapping[str, Sequence[str]]) -> None:
        """Print lists of names that are not empty, one per line."""
        for kind, names in lists.items():
            if names:
                self.line(f"{kind}: {join_items(names, MAX_SHOWN)}")

    def line(self, text: str) -> None:
        """Print a line of plain text."""
        if not self.as_json:
            self._emit(console.print, Text(_lines(text)), soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a sentence; a terminal breaks its lines between words."""
        if not self.as_json:
            self._emit(console.print, Text(_lines(text)), soft_wrap=not console.is_terminal)

    def event(self, values: Mapping[str, object]) -> None:
        """Print values immediately as a JSON object on a separate line, if `as_json`."""
        if self.as_json:
            self._emit(console.out, json.dumps(plain(values)))

    def finish(self) -> None:
        """Print the JSON object if `as_json`."""
        if self.as_json:
            values = plain(self.values)
            text = json.dumps(values, indent=2, ensure_ascii=False)
            if _lines(text) != text or not console.encoding.startswith("utf"):
                text = json.dumps(values, indent=2)
            self._emit(console.out, text)
        if self.failure is not None:
            raise self.failure

    def _emit(self, output: Callable[..., None], *arguments: Any, **settings: Any) -> None:
        """Print; after a failure, such as a full disk, the command continues without printing."""
        if self.failure is not None:
            return
        try:
            output(*arguments, **settings)
        except FileError as error:
            self.failure = error


def attributes(source: object, names: str) -> dict[str, Any]:
    """Return attributes of an object by name; `names` are separated by blanks."""
    return {name: getattr(source, name) for name in names.split()}


def _text(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style)


def plain(value: Any) -> Any:
    """Convert a value to types of JSON; NaN and infinities become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


@contextmanager
def progress(task: str) -> Iterator[Callable[[float], None]]:
    """Show progress and the remaining time on stderr; in a log, the stages of long maps."""
    if not errors.is_terminal:
        with _told("anisomap.method", lambda text: _complain(Text(text))):
            yield lambda share: None
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(pulse_style="dim"),
        TimeElapsedColumn(),
        TextColumn("elapsed,"),
        TimeRemainingColumn(elapsed_when_finished=False),
        TextColumn("left"),
    )
    with Progress(*columns, console=errors, transient=True) as display:
        shown = display.add_task(printable(task), total=None)
        with _told("anisomap", lambda text: display.update(shown, description=text)):
            yield lambda share: display.update(shown, completed=share, total=1.0)


@contextmanager
def _told(name: str, describe: Callable[[str], None]) -> Iterator[None]:
    """Pass the messages of a logger and its descendants to a function."""
    library, handler = logging.getLogger(name), _Description(describe)
    level = library.level
    library.addHandler(handler)
    library.setLevel(logging.INFO)
    try:
        yield
    finally:
        library.removeHandler(handler)
        library.setLevel(level)


class _Description(logging.Handler):
    """Handler that passes log messages to a function."""

    def __init__(self, describe: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self._describe = describe

    def emit(self, record: logging.LogRecord) -> None:
        self._describe(printable(record.getMessage()))


def _is_number(text: str) -> bool:
    return text == "-" or text.removesuffix("%").lstrip("-").replace(".", "").isdigit()
