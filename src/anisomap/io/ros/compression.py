"""Decompress the parts of bags within a budget.

rosbags decompresses without a limit, so that each compressed part is measured before it, or is
decompressed here.
"""

from __future__ import annotations

import bz2
import io
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from anisomap.budget import Budget
from anisomap.extras import import_extra
from anisomap.io.parsing.libraries import DamagedError, library_errors

EXTRA = "ros"

_STEP = 1 << 20
_CHUNK, _CHUNK_HEADER = 0x06, 40  # MCAP: opcode, and bytes beside the name of the compression
_MAGIC_BYTES = 8
_MAX_NAME = 1 << 8


def decompress_chunk(path: Path, budget: Budget, compressed: bytes, compression: str) -> bytes:
    """Decompress a chunk of a ROS 1 bag.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    budget : Budget
        The content is counted.
    compressed : bytes
    compression : {"none", "bz2", "lz4"}

    Returns
    -------
    bytes

    Raises
    ------
    DamagedError
        If the chunk is damaged.
    FileError
        If the chunk is a decompression bomb.
    MissingExtraError
        If lz4 is required and not installed.
    """
    decompressor: Any
    if compression == "lz4":
        lz4 = import_extra("lz4.frame", "reading bags", EXTRA)
        decompressor = lz4.LZ4FrameDecompressor()
    elif compression == "bz2":
        decompressor = bz2.BZ2Decompressor()
    else:
        return compressed
    return _decompress(path, budget, decompressor, compressed, "a chunk")


def decompress_message(path: Path, budget: Budget, compressed: bytes) -> bytes:
    """Decompress a message of a ROS 2 bag whose messages are compressed one by one.

    Raises
    ------
    DamagedError
        If the message is damaged.
    FileError
        If the message is a decompression bomb.
    """
    return _decompress(path, budget, _zstd().ZstdDecompressor(), compressed, "a message")


def _decompress(
    path: Path, budget: Budget, decompressor: Any, compressed: bytes, what: str
) -> bytes:
    with library_errors(path):
        content: bytes = decompressor.decompress(compressed, max_length=budget.limit + 1)
    budget.spend(len(content), what)
    if not decompressor.eof:
        raise DamagedError(f"{path} is damaged or cut short: {what} has no end")
    return content


def decompress_file(source: BinaryIO, path: Path, target: BinaryIO) -> None:
    """Decompress a file of a ROS 2 bag whose files are compressed as a whole.

    Parameters
    ----------
    source : binary file
        Opened `path`.
    path : pathlib.Path
    target : binary file

    Raises
    ------
    DamagedError
        If the file is damaged.
    FileError
        If the file is a decompression bomb.
    """
    budget = Budget(path)
    with library_errors(path), _zstd().open(source, "rb") as unpacked:
        while content := unpacked.read(_STEP):
            budget.spend(len(content), "its content")
            target.write(content)


def check_chunks(path: Path, file: BinaryIO, budget: Budget) -> None:
    """Measure all chunks of an MCAP file, up to the first incomplete record.

    Parameters
    ----------
    path : pathlib.Path
    file : binary file
        Opened `path`.
    budget : Budget
        Of the bag.

    Raises
    ------
    DamagedError
        If a chunk unpacks to more than it declares.
    FileError
        If the chunks are a decompression bomb.
    """
    size, at = file.seek(0, io.SEEK_END), _MAGIC_BYTES
    while at < size:
        file.seek(at)
        kind, length = file.read(1), int.from_bytes(file.read(8), "little")
        at += 9 + length
        if at > size:
            return
        if kind[0] != _CHUNK or length < _CHUNK_HEADER:
            continue
        header = file.read(32)
        declared, name_length = (
            int.from_bytes(header[start:stop], "little") for start, stop in ((16, 24), (28, 32))
        )
        compression = file.read(min(name_length, _MAX_NAME)).decode("latin-1")
        packed = int.from_bytes(file.read(8), "little")
        budget.spend(declared, "a chunk")
        if compression:
            check_chunk(path, file.read(min(packed, length)), compression, declared)


def check_chunk(path: Path, compressed: bytes, compression: str, declared: int) -> None:
    """Compare the size of a chunk of an MCAP file with the declared size.

    Parameters
    ----------
    path : pathlib.Path
    compressed : bytes
    compression : str
        Other names than ``lz4`` and ``zstd`` are accepted; rosbags rejects them.
    declared : int

    Raises
    ------
    DamagedError
        If it is larger. Other damage is left to rosbags, so that earlier frames are read.
    """
    size = 0
    if compression == "lz4":
        size = _lz4_size(compressed, declared)
    elif compression == "zstd":
        size = _zstd_size(compressed, declared)
    if size > declared:
        raise DamagedError(
            f"{path} is damaged: a chunk of {declared} bytes unpacks to more than that"
        )


def _zstd_size(compressed: bytes, limit: int) -> int:
    """Return the unpacked size of all frames before any damage, counted up to about `limit`."""
    zstd, total, left = _zstd(), 0, memoryview(compressed)
    while left and total <= limit:
        try:
            size = zstd.get_frame_info(left).decompressed_size
            length = zstd.get_frame_size(left)
        except zstd.ZstdError:
            size, length = None, len(left)
        total += size or _count(zstd.ZstdDecompressor(), left[:length], zstd.ZstdError, limit)
        left = left[length:]
    return total


def _lz4_size(compressed: bytes, limit: int) -> int:
    """Return the unpacked size of a frame before any damage, counted up to about `limit`."""
    lz4 = import_extra("lz4.frame", "reading bags", EXTRA)
    return _count(lz4.LZ4FrameDecompressor(), compressed, RuntimeError, limit)


def _count(decompressor: Any, compressed: Any, damage: type[Exception], limit: int) -> int:
    """Return the number of bytes that a decompressor gives, up to about `limit`."""
    total = 0
    with suppress(damage):
        while total <= limit:
            count = len(decompressor.decompress(compressed, max_length=_STEP))
            total += count
            compressed = b""
            if decompressor.eof or not count:
                break
    return total


def _zstd() -> Any:
    """Import the module that rosbags uses."""
    name = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_extra(name, "reading bags", EXTRA)
