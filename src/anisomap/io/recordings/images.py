"""Stacks of images whose pixels are pads: a folder of them, or a TIFF or GIF of several pages."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.foreign import foreign, imported
from anisomap.io.parsing.grids import grid_names, grid_positions
from anisomap.io.parsing.source import check_unpacked
from anisomap.io.stream import Block, ReadOptions, Stream, salvaged

EXTRA = "images"

_MAGICS = (b"GIF87a", b"GIF89a", b"II*\0", b"MM\0*")
_SUFFIXES = {".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg"}
_AS_THEY_ARE = {"L", "I", "F", "I;16", "I;16B"}
_LARGEST_RATIO = 1032
_BLOCK_BYTES = 1 << 22


def recognises(path: Path, head: bytes) -> bool:
    """Tell a folder of images by their suffixes, a file of several by its mark."""
    if path.is_dir():
        return len(_images(path)) > 1
    return head.startswith(_MAGICS)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a stack of images.

    Parameters
    ----------
    path : pathlib.Path
        A folder of images of one size, in the order of the numbers in their names, or a TIFF or
        GIF of several pages.
    options : ReadOptions
        None of them matters here.

    Yields
    ------
    Stream
        A sensor a pixel, row after row; colours become grey. Positions are in pixels.

    Raises
    ------
    FileError
        If a file is damaged, there is only one image, or sizes differ.
    MissingExtraError
        If Pillow is not installed.
    """
    pillow = imported("PIL.Image", "reading images", EXTRA)
    if path.is_dir():
        files = _images(path)
        yield _stream(path, len(files), lambda i: _opened(pillow, files[i], 0))
        return
    with foreign(path), pillow.open(path) as image:
        count = int(getattr(image, "n_frames", 1))
    if count < 2:
        raise FileError(f"{path} is one image, which is one frame; give a folder of images")
    with foreign(path):
        image = pillow.open(path)
    with image:
        yield _stream(path, count, lambda i: _page(path, image, i))


def _stream(path: Path, count: int, read: Callable[[int], NDArray[Any]]) -> Stream:
    with foreign(path):
        rows, columns = read(0).shape
    return Stream(
        path,
        rows * columns,
        salvaged(_blocks(path, count, read, (rows, columns)), path),
        names=grid_names(rows, columns),
        positions=grid_positions(rows, columns),
        units="pixels",
        source=path.name,
        metadata={"format": "images", "rows": rows, "columns": columns},
    )


def _blocks(
    path: Path, count: int, read: Callable[[int], NDArray[Any]], shape: tuple[int, int]
) -> Iterator[Block]:
    at_once = max(1, _BLOCK_BYTES // (4 * shape[0] * shape[1]))
    pixels: list[NDArray[Any]] = []
    for i in range(count):
        try:
            with foreign(path):
                pixels.append(read(i).ravel())
        except FileError:
            if pixels:
                yield Block(np.array(pixels), i / count)
            raise
        if pixels[-1].size != shape[0] * shape[1]:
            raise FileError(
                f"{path}: image {i} has {pixels[-1].size} pixels, but the first "
                f"{shape[0]} x {shape[1]}; all must be of one size"
            )
        if len(pixels) == at_once or i == count - 1:
            yield Block(np.array(pixels), (i + 1) / count)
            pixels = []


def _images(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES]
    return sorted(found, key=lambda path: _counted(path.name))


def _counted(name: str) -> list[tuple[int, str]]:
    """Give a key by which image2 comes before image10."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _opened(pillow: Any, path: Path, page: int) -> NDArray[Any]:
    with foreign(path), pillow.open(path) as image:
        return _page(path, image, page)


def _page(path: Path, image: Any, page: int) -> NDArray[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a picture as large as to be warned of is no skin
        image.seek(page)
        size, packed = 4 * image.width * image.height, path.stat().st_size
        check_unpacked(path, f"page {page}", packed, size, largest_ratio=_LARGEST_RATIO)
        image.load()
        grey = image if image.mode in _AS_THEY_ARE else image.convert("L")
        return np.asarray(grey)
