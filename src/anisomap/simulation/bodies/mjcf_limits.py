"""Check what a MuJoCo model declares before MuJoCo allocates it.

A few characters can declare any number of elements (``replicate``) or values (``hfield``), and any
file of the system as a part of the model.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from anisomap.budget import Budget
from anisomap.errors import FileError
from anisomap.files import open_regular

MAX_ELEMENTS = 10_000
"""The time in which MuJoCo 3.9 compiles a model is quadratic: 9 s for so many geoms or bodies."""

_MAX_BYTES = 1 << 26
_INCLUDES, _MULTIPLIERS = {"include", "model"}, {"replicate", "composite", "flexcomp"}
_FOLDERS = ("meshdir", "texturedir", "assetdir")
# Attributes whose product is a number of values, and the bytes per value.
_TABLES = {"hfield": (("nrow", "ncol"), 4), "texture": (("width", "height"), 4)}
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40, "P": 1 << 50, "E": 1 << 60}
_SIZE = re.compile(r"\s*+(\d{1,30})\s*+([KMGTPE]?)\s*+")
_VALUE_BYTES = 8
_PNG = b"\x89PNG\r\n\x1a\n"


def check_model(path: Path) -> None:
    """Check the numbers, sizes and files that a model declares.

    Parameters
    ----------
    path : pathlib.Path
        A model, whose included files are checked too.

    Raises
    ------
    FileError
        If the model has more than `MAX_ELEMENTS` elements, declares more memory than the `Budget`
        of the file, refers to something that is not a regular file, or is not XML.
    """
    _Model(path, Budget(path)).read(path)


@dataclass
class _Model:
    """The counts of a model while its files are read."""

    path: Path
    budget: Budget
    n_elements: int = 0
    n_attachable: int = 0  # elements of models that each `attach` copies
    copies: list[int] = field(default_factory=lambda: [1])  # of the elements that are open
    folders: set[Path] = field(default_factory=set)
    seen: set[Path] = field(default_factory=set)

    def read(self, path: Path) -> None:
        """Check the elements of a file, and then the files that they name."""
        if (file := Path(os.path.realpath(path))) in self.seen:
            return  # MuJoCo rejects files that are included twice
        self.seen.add(file)
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = lambda _: self.copies.pop()
        parser.StartDoctypeDeclHandler = self._refuse_types
        try:
            parser.Parse(_markup(path), True)
        except expat.ExpatError as error:
            raise FileError(f"MuJoCo cannot read {path}: it is not valid XML ({error})") from error

    def _start(self, name: str, attributes: Mapping[str, str]) -> None:
        copies = self.copies[-1]
        if name in _MULTIPLIERS:
            copies *= max(1, math.prod(_integers(attributes.get("count", "1"))))
        self.copies.append(copies)
        self.n_elements += copies * (1 + (self.n_attachable if name == "attach" else 0))
        if self.n_elements > MAX_ELEMENTS:
            raise FileError(
                f"{self.path} declares more than {MAX_ELEMENTS} elements with their copies; remove "
                "those that are not part of the body"
            )
        for n_bytes in _declared(name, attributes):
            self.budget.check(n_bytes * copies, f"<{name}>")
        if name == "compiler":
            self.folders |= {self.path.parent / attributes.get(key, "") for key in _FOLDERS}
        for file in (attributes.get("file"), attributes.get("filename")):
            if file:
                self._check_file(name, file)

    def _check_file(self, name: str, file: str) -> None:
        folders = {self.path.parent, *self.folders}
        for candidate in sorted({folder / file for folder in folders}):
            if not candidate.exists():
                continue
            if name not in _INCLUDES:
                self._check_part(candidate)
                continue
            before = self.n_elements
            self.read(candidate)
            if name == "model":
                self.n_attachable += self.n_elements - before

    def _check_part(self, file: Path) -> None:
        with open_regular(file) as stream:
            head = stream.read(24)
        if head.startswith(_PNG):
            width, height = (int.from_bytes(head[at : at + 4], "big") for at in (16, 20))
            self.budget.check(4 * width * height, str(file))

    def _refuse_types(self, *_: object) -> None:
        raise FileError(f"{self.path} declares a document type, which is not supported")


def _declared(name: str, attributes: Mapping[str, str]) -> Iterator[int]:
    """Yield the bytes that the attributes of an element declare."""
    if name in _TABLES:
        keys, n_bytes = _TABLES[name]
        yield n_bytes * math.prod(max(1, *_integers(attributes.get(key, "1"))) for key in keys)
    if name == "size":
        for key, text in attributes.items():
            if match := _SIZE.fullmatch(text):
                n_bytes = int(match[1]) * _UNITS[match[2]]
                yield n_bytes if key == "memory" else n_bytes * _VALUE_BYTES
    if name in ("numeric", "text", "tuple"):
        yield _VALUE_BYTES * max(1, *_integers(attributes.get("size", "1")))
    if "nsample" in attributes:
        yield _VALUE_BYTES * max(1, *_integers(attributes["nsample"]))


def _integers(text: str) -> list[int]:
    return [int(float(word)) for word in text.split() if _is_count(word)] or [1]


def _is_count(word: str) -> bool:
    try:
        return math.isfinite(float(word)) and float(word) >= 0
    except ValueError:
        return False


def _markup(path: Path) -> bytes:
    """Return the markup of a file in ASCII, without comments and declarations.

    MuJoCo accepts what Expat does not: two hyphens in a comment, and bytes that are not UTF-8.
    """
    with open_regular(path) as stream:
        content = stream.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise FileError(f"{path} is larger than {_MAX_BYTES >> 20} MiB, the limit for models")
    for opening, closing in ((b"<!--", b"-->"), (b"<?", b"?>")):
        at, parts = 0, []
        while (start := content.find(opening, at)) >= 0:
            parts.append(content[at:start])
            end = content.find(closing, start)
            at = len(content) if end < 0 else end + len(closing)
        parts.append(content[at:])
        content = b"".join(parts)
    return content.strip().decode("ascii", "replace").replace("\ufffd", "?").encode()
