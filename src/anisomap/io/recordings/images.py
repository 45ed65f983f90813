"""Image sequences with one sensor per pixel: a folder of images, or a multi-page TIFF or GIF."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, import_extra
from anisomap.files import check_regular
from anisomap.io.presets import grid_names, grid_positions
from anisomap.io.stream import BLOCK_BYTES, Block, ReadOptions, Stream

EXTRA = "images"

MAGICS = (b"GIF87a", b"GIF89a", b"II*\0", b"MM\0*")
_SUFFIXES = {".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg"}
_GREY_MODES = {"L", "I", "F", "I;16", "I;16B"}


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a folder by the suffixes of its files."""
    return path.is_dir() and len(_images(path)) > 1


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a folder of images of equal size, in the order of the numbers in their names, or a file.

    Sensors are pixels in row-major order with positions in pixels; colours are converted to grey.
    """
    pillow = import_extra("PIL.Image", "reading images", EXTRA)
    if path.is_dir():
        files = _images(path)
        yield _stream(path, len(files), lambda i: _image(pillow, files[i]))
        return
    with pillow.open(path) as image:
        count = int(getattr(image, "n_frames", 1))
        if count < 2:
            raise FileError(f"{path} holds a single image (one frame); give a folder of images")
        yield _stream(path, count, lambda i: _page(image, i))


def _stream(path: Path, count: int, read: Callable[[int], NDArray[Any]]) -> Stream:
    rows, columns = read(0).shape
    return Stream(
        path,
        rows * columns,
        _blocks(path, count, read, (rows, columns)),
        names=grid_names(rows, columns),
        positions=grid_positions(rows, columns),
        units="pixels",
        source=path.name,
        metadata={"format": "images", "rows": rows, "columns": columns},
    )


def _blocks(
    path: Path, count: int, read: Callable[[int], NDArray[Any]], shape: tuple[int, int]
) -> Iterator[Block]:
    at_once = max(1, BLOCK_BYTES // (4 * shape[0] * shape[1]))
    pixels: list[NDArray[Any]] = []
    for i in range(count):
        try:
            pixels.append(read(i).ravel())
        except Exception:
            if pixels:
                yield Block(np.array(pixels), i / count)
            raise
        if pixels[-1].size != shape[0] * shape[1]:
            raise FileError(
                f"{path}: all images must have the size of the first, {shape[0]} x {shape[1]}, but "
                f"image {i} has {pixels[-1].size} pixels"
            )
        if len(pixels) == at_once or i == count - 1:
            yield Block(np.array(pixels), (i + 1) / count)
            pixels = []


def _images(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES]
    return sorted(found, key=lambda path: _natural_key(path.name))


def _natural_key(name: str) -> list[tuple[int, str]]:
    """Return a sort key that orders image2 before image10."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _image(pillow: Any, path: Path) -> NDArray[Any]:
    check_regular(path)
    with pillow.open(path) as image:
        return _page(image, 0)


def _page(image: Any, page: int) -> NDArray[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Pillow warns about damage
        image.seek(page)
        grey = image if image.mode in _GREY_MODES else image.convert("L")
        return np.asarray(grey)
