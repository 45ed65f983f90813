"""The arrays of an NPZ file, each checked before its content is touched.

Nothing is ever unpickled, and nothing is unpacked that could not be what it says it is.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.source import check_unpacked
from anisomap.recording import Scalar

SUFFIX = ".npy"
NUMBERS, WHOLE, TEXT = "biuf", "biu", "US"
"""Kinds of arrays, as letters of numpy's `dtype.kind`."""
_WANTED = {NUMBERS: "numbers", WHOLE: "whole numbers"}

_LARGEST_RATIO = 1032  # of deflate
_LARGEST_SCALAR = 1 << 16


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open an NPZ file; whatever is damaged in it becomes a FileError."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield Archive(path, archive)
    except zipfile.BadZipFile as error:
        raise FileError(f"{path} is no NumPy archive, or damaged: {error}") from error
    except (zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise FileError(f"{path} is damaged: {error}") from error


@dataclass(frozen=True)
class Archive:
    """The arrays of an archive, each checked before its content is touched."""

    path: Path
    zip: zipfile.ZipFile

    @property
    def names(self) -> list[str]:
        """The names of all arrays."""
        members = self.zip.namelist()
        return [name.removesuffix(SUFFIX) for name in members if name.endswith(SUFFIX)]

    def require(self, name: str, what: str) -> None:
        """Refuse an archive that lacks an array, saying what it has instead."""
        if name not in self.names:
            held = ", ".join(self.names[:10]) or "no array at all"
            raise FileError(
                f"{self.path} holds no {what}: it needs an array {name}, and has {held}"
            )

    def required(self, name: str, kinds: str) -> NDArray[Any]:
        """Give an array that is there; `kinds` are the letters of numpy's `dtype.kind`."""
        with self._member(name, kinds) as (member, shape, fortran_order, dtype):
            # Reading to the end has zipfile compare the checksum.
            values = np.frombuffer(member.read(), dtype)
        return values.reshape(shape, order="F" if fortran_order else "C")

    def shape(self, name: str, kinds: str) -> tuple[int, ...]:
        """Give the shape of an array that is there."""
        with self._member(name, kinds) as (_, shape, _, _):
            return shape

    def rows(self, name: str, kinds: str, n_bytes: int) -> Iterator[NDArray[Any]]:
        """Give the rows of a 2-D array in blocks of about so many bytes.

        An array that lies column after column has to be unpacked whole.
        """
        with self._member(name, kinds) as (member, shape, fortran_order, dtype):
            row_bytes = shape[1] * dtype.itemsize
            if fortran_order:
                yield self.required(name, kinds)
                return
            n_rows = max(1, n_bytes // max(row_bytes, 1))
            # The last of it is asked for once more, which has zipfile compare the checksum.
            while content := member.read(n_rows * row_bytes):
                yield np.frombuffer(content, dtype).reshape(-1, shape[1])

    @contextmanager
    def _member(
        self, name: str, kinds: str
    ) -> Iterator[tuple[IO[bytes], tuple[int, ...], bool, np.dtype[Any]]]:
        """Open an array behind its header, once that is known to be true."""
        info = self.zip.getinfo(name + SUFFIX)
        self._check_size(info)
        with self.zip.open(info) as member:
            shape, fortran_order, dtype = self._header(member, name)
            if dtype.kind not in kinds:
                wanted = _WANTED.get(kinds, "text")
                kind = "pickled objects" if dtype.hasobject else f"of type {dtype}"
                raise FileError(f"{self.path}: {name} is {kind}; it must be {wanted}")
            promised = math.prod(shape) * dtype.itemsize
            held = info.file_size - member.tell()
            if promised != held or min(shape, default=0) < 0 or not dtype.itemsize:
                raise FileError(
                    f"{self.path}: {name} is damaged: "
                    f"its shape {shape} takes {promised} bytes, but it holds {held}"
                )
            yield member, shape, fortran_order, dtype

    def array(self, name: str, kinds: str) -> NDArray[Any] | None:
        """Give an array, or None if it is not there."""
        return self.required(name, kinds) if name in self.names else None

    def list_of(self, name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Give an array of whole numbers or truth values; an empty one if there is none."""
        values = self.array(name, WHOLE)
        if values is None:
            return np.empty(0, dtype)
        self._check_list(name, values)
        return values.astype(dtype)

    def texts(self, name: str) -> tuple[str, ...]:
        """Give a list of texts; an empty one if it is not there."""
        values = self.array(name, TEXT + WHOLE)
        if values is None:
            return ()
        self._check_list(name, values)
        return tuple(map(str, self._python(name, values)))

    def text(self, name: str, default: str = "") -> str:
        """Give a single text."""
        values = self.array(name, TEXT)
        return default if values is None else str(self._single(name, values))

    def number(self, name: str) -> float | None:
        """Give a single number, or None if it is not there."""
        values = self.array(name, NUMBERS)
        return None if values is None else float(self._single(name, values))

    def mapping(self, name: str) -> dict[str, Scalar]:
        """Give a mapping that was packed as JSON, or any other text under its own name."""
        packed = self.text(name)
        try:
            mapping = json.loads(packed) if packed else {}
        except (ValueError, RecursionError):
            mapping = None
        if not isinstance(mapping, dict):
            return {name: packed}
        return {key: value for key, value in mapping.items() if isinstance(value, Scalar)}

    def scalars(self, but: set[str]) -> dict[str, Scalar]:
        """Give all single values but some; objects are left where they are."""
        found = {}
        for name in dict.fromkeys(self.names):
            info = self.zip.getinfo(name + SUFFIX)
            if name in but or info.file_size > _LARGEST_SCALAR:
                continue
            self._check_size(info)
            with self.zip.open(info) as member:
                shape, _, dtype = self._header(member, name)
            if shape == () and dtype.kind in NUMBERS + TEXT:
                found[name] = self._single(name, self.required(name, NUMBERS + TEXT))
        return found

    def _check_list(self, name: str, values: NDArray[Any]) -> None:
        if values.ndim != 1:
            raise FileError(f"{self.path}: {name} has shape {values.shape}; it must be a list")

    def _single(self, name: str, values: NDArray[Any]) -> Any:
        if values.size != 1:
            raise FileError(f"{self.path}: {name} has shape {values.shape}; it must be one value")
        return self._python(name, values.reshape(1))[0]

    def _python(self, name: str, values: NDArray[Any]) -> list[Any]:
        """Turn an array into Python's own text and numbers."""
        if values.dtype.kind == "f":
            values = values.astype(np.float64)
        if values.dtype.kind == "S":
            return [text.decode("utf-8", "replace") for text in values.tolist()]
        if values.dtype.kind == "U":
            # numpy makes text of whatever number it finds, which then fails far from here.
            characters = values.view(np.dtype(np.uint32).newbyteorder(values.dtype.byteorder))
            if characters.max(initial=0) > sys.maxunicode:
                raise FileError(f"{self.path}: {name} holds characters that do not exist")
        found: list[Any] = values.tolist()
        return found

    def _header(self, member: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                version = np.lib.format.read_magic(member)
                if version == (1, 0):
                    return np.lib.format.read_array_header_1_0(member)
                return np.lib.format.read_array_header_2_0(member)
        except zipfile.BadZipFile:
            raise
        except Exception as error:  # numpy evaluates the header, so damage shows up as anything
            raise FileError(f"{self.path}: the header of the array {name} is damaged") from error

    def _check_size(self, info: zipfile.ZipInfo) -> None:
        """Refuse an array that says it holds more than its bytes could ever unpack to."""
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FileError(
                f"{self.path}: {info.filename} is packed in a way that NumPy never uses"
            )
        ratio = 1 if info.compress_type == zipfile.ZIP_STORED else _LARGEST_RATIO
        packed = min(info.compress_size, self.path.stat().st_size)
        check_unpacked(self.path, info.filename, packed, info.file_size, largest_ratio=ratio)
