"""Read JSON files piece by piece, so that objects take memory only while they are looked at.

Parsed JSON takes up to 24 times the memory of its text (measured: a list of empty lists, CPython
3.11). `JsonReader` parses the elements of a list one by one, and limits all else.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from anisomap.errors import FileError
from anisomap.io.parsing.source import open_text
from anisomap.memory import size_on_disk

MAX_ELEMENT = 1 << 20
"""Maximum length of an element of a list in characters: a contact of 100,000 sensors is shorter."""

MAX_KEPT = 1 << 22
"""Maximum length of all other values together; they take up to 100 MB."""

MAX_RATIO = 100
"""Maximum ratio of characters to bytes on disk.

gzip reached 13 on a map of 440 sensors, and 31 where none had a position.
"""

FREE_CHARACTERS = 1 << 22
"""Text up to this length is accepted at any ratio."""

_STEP = 1 << 16
_MAX_DEPTH = 100
_BLANKS = " \t\r\n"
_LITERAL = 12  # characters: an incomplete literal or escape begins that close to the end of text
_EXPONENT = 3  # characters: the "1" of an incomplete "1e+5" ends that close to the end of the text


@contextmanager
def open_json(path: Path) -> Iterator[JsonReader]:
    """Open a JSON file, which may be gzipped, at its first value."""
    with open_text(path) as stream:
        yield JsonReader(path, stream)


class JsonReader:
    """A position in a JSON document, which moves forward only.

    path: The file, for messages.
    """

    def __init__(self, path: Path, stream: io.TextIOWrapper) -> None:
        self.path = path
        self._stream = stream
        self._text, self._at, self._ended = "", 0, False
        self._line, self._column = 1, 1  # of the start of the text
        self._n_dropped = 0  # characters before the text
        self._n_kept = 0
        self._limit = max(FREE_CHARACTERS, MAX_RATIO * size_on_disk(path))
        self._decoder = json.JSONDecoder()

    def peek(self) -> str:
        """Return the first character of the next value; empty at the end of the document."""
        while True:
            while self._at < len(self._text) and self._text[self._at] in _BLANKS:
                self._at += 1
            if self._at < len(self._text):
                return self._text[self._at]
            if not self._read():
                return ""

    def members(self) -> Iterator[str]:
        """Yield the keys of an object; read the value after each before the next."""
        self._expect("{", "Expecting value")
        if self.peek() == "}":
            self._at += 1
            return
        while True:
            if self.peek() != '"':
                raise self._invalid("Expecting property name enclosed in double quotes")
            key = str(self.value())
            self._expect(":", "Expecting ':' delimiter")
            yield key
            if self.peek() == "}":
                self._at += 1
                return
            self._expect(",", "Expecting ',' delimiter")

    def items(self) -> Iterator[None]:
        """Step through the elements of a list; read each before the next."""
        self._expect("[", "Expecting value")
        if self.peek() == "]":
            self._at += 1
            return
        while True:
            yield
            if self.peek() == "]":
                self._at += 1
                return
            self._expect(",", "Expecting ',' delimiter")

    def value(self, max_length: int = MAX_ELEMENT) -> Any:
        """Parse the next value."""
        size = _STEP
        while True:
            self.peek()
            while len(self._text) - self._at < size and self._read():
                pass
            try:
                value, end = self._decoder.raw_decode(self._text, self._at)
            except json.JSONDecodeError as error:
                if not self._may_be_cut(error):
                    raise self._invalid(error.msg, error.pos) from error
            except (ValueError, RecursionError) as error:
                raise FileError(f"{self.path}: not valid JSON ({error})") from error
            else:
                is_number = isinstance(value, int | float)
                if end - self._at > max_length:
                    raise self._too_long(max_length)
                if self._ended or not (is_number and end > len(self._text) - _EXPONENT):
                    self._at = end
                    return value
            if size > max_length:
                raise self._too_long(max_length)
            size *= 2

    def kept_value(self) -> Any:
        """Parse the next value, which counts towards `MAX_KEPT`."""
        self.peek()
        start = self._at + self._n_dropped
        value = self.value(MAX_KEPT - self._n_kept)
        self._n_kept += self._at + self._n_dropped - start
        return value

    def skip(self, depth: int = 0) -> None:
        """Pass over the next value, of any length, whose parts are parsed one by one."""
        if depth > _MAX_DEPTH:
            raise self._invalid("values nested too deeply")
        first = self.peek()
        if first not in ("{", "["):
            self.value()
        elif not self._is_short():
            for _ in self.members() if first == "{" else self.items():
                self.skip(depth + 1)

    def _is_short(self) -> bool:
        """Parse the next value if it is within the text that was read; return whether it was."""
        try:
            _, self._at = self._decoder.raw_decode(self._text, self._at)
        except (ValueError, RecursionError):
            return False
        return True

    def end(self) -> None:
        """Check that the document ends here."""
        if self.peek():
            raise self._invalid("Extra data")

    def _read(self) -> bool:
        """Read more text; return False at its end."""
        if self._ended:
            return False
        more = self._stream.read(max(_STEP, len(self._text) - self._at))
        self._ended = not more
        gone, self._text = self._text[: self._at], self._text[self._at :] + more
        self._line, self._column = self._place(gone)
        self._n_dropped += len(gone)
        self._at = 0
        if self._n_dropped + len(self._text) > self._limit:
            raise FileError(
                f"{self.path} unpacks to more than {self._limit} characters, too many for its size "
                "on disk; it is damaged or a decompression bomb (if not, unpack it first)"
            )
        return bool(more)

    def _place(self, text: str) -> tuple[int, int]:
        """Return the line and column after a part at the start of the text."""
        n_lines = text.count("\n")
        last = len(text) - text.rfind("\n") if n_lines else self._column + len(text)
        return self._line + n_lines, last

    def _may_be_cut(self, error: json.JSONDecodeError) -> bool:
        unclosed = error.msg.startswith("Unterminated string")
        return not self._ended and (unclosed or error.pos > len(self._text) - _LITERAL)

    def _expect(self, character: str, problem: str) -> None:
        if self.peek() != character:
            raise self._invalid(problem)
        self._at += 1

    def _invalid(self, problem: str, at: int | None = None) -> FileError:
        line, column = self._place(self._text[: self._at if at is None else at])
        return FileError(f"{self.path}, line {line}, column {column}: not valid JSON ({problem})")

    def _too_long(self, max_length: int) -> FileError:
        line, column = self._place(self._text[: self._at])
        return FileError(
            f"{self.path}, line {line}, column {column}: a value has more than {max_length} "
            "characters; it is damaged or a decompression bomb"
        )
