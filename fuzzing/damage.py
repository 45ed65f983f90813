"""Damage to files of any format: functions of bytes and a random generator."""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from types import MappingProxyType
from typing import TypeAlias
from zipfile import BadZipFile, ZipFile

from numpy.random import Generator

Damage: TypeAlias = Callable[[bytes, Generator], bytes]

_HEADER = 256  # bytes; longer than the magic number and the first fields of all formats
_MAX_REPEATS = 100_000
_MAX_GROWTH = 1 << 20  # bytes that a damage may add
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_EXTREMES = (
    *(b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"1e999", b"nan", b"inf", b"-inf", b"0x10"),
    *(b"2147483648", b"4294967296", b"9223372036854775808", b"99999999999999999999", b"1e"),
    *(b"1,234", b"1_000", b"", b"'", b"true", b"null", b"\xd9\xa3", b"3" * 5000),
)
_WORDS = (
    *(b"\0", b"\x1b[31m", b"\x80", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\r", b"\n"),
    *(b"\xe2\x80\xae", b"\xe2\x80\xa8", b'"', b"'", b",", b";", b"\t", b" ", b"#", b"=cmd|'/C'!A0"),
    *(b"${1+1}", b"$(command id)", b"<!--", b"]]>", b"&amp;", b"&x;", b"]", b"}", b")", b">", b":"),
    *(b"time", b"name", b"x", b"nan", b"\\", b"../", b"%s", b"{}"),
)
_NESTED = (
    *(b"[", b'{"a":', b"(", b"{", b"<a>", b"<body>", b'"', b"'", b"#", b" ", b"\t", b"\n", b","),
    *(b";", b"0 ", b"1,", b"-", b"a", b"<replicate count='9'>", b"&lt;", b"property float x\n"),
)
_INTEGERS = (0, 1, 2, 127, 128, 255, 32767, 65535, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 62)


def flip_bits(content: bytes, rng: Generator) -> bytes:
    """Flip one to eight bits."""
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 9)) if changed else 0):
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def cut(content: bytes, rng: Generator) -> bytes:
    """Remove the end, the beginning or a part of the middle."""
    first, last = sorted(int(at) for at in rng.integers(len(content) + 1, size=2))
    return (content[:first], content[last:], content[:first] + content[last:])[rng.integers(3)]


def insert(content: bytes, rng: Generator) -> bytes:
    """Insert a word with a meaning in some format, random bytes, or a copy of another part."""
    at = int(rng.integers(len(content) + 1))
    kind = rng.integers(3)
    if kind == 0:
        new = _WORDS[rng.integers(len(_WORDS))]
    elif kind == 1:
        new = rng.bytes(int(rng.integers(1, 64)))
    else:
        first, last = sorted(int(i) for i in rng.integers(len(content) + 1, size=2))
        new = content[first:last]
    return content[:at] + new + content[at:]


def change_header(content: bytes, rng: Generator) -> bytes:
    """Replace bytes near the start."""
    size = min(int(rng.integers(1, 9)), len(content))
    at = int(rng.integers(min(_HEADER, len(content)) - size + 1))
    return content[:at] + rng.bytes(size) + content[at + size :]


def change_count(content: bytes, rng: Generator) -> bytes:
    """Replace a number, in text or binary, by an extreme one."""
    numbers = list(_NUMBER.finditer(content, 0, 1 << 16))
    if numbers and rng.integers(2):
        found = numbers[int(len(numbers) * rng.random() ** 2)]  # mostly near the start
        new = _EXTREMES[rng.integers(len(_EXTREMES))]
        return content[: found.start()] + new + content[found.end() :]
    size = int(rng.choice([1, 2, 4, 8]))
    at = int(rng.integers(max(1, len(content) - size)))
    value = _INTEGERS[rng.integers(len(_INTEGERS))] % (1 << 8 * size)
    order = "little" if rng.integers(2) else "big"
    return content[:at] + value.to_bytes(size, order) + content[at + size :]  # type: ignore[arg-type]


def nest(content: bytes, rng: Generator) -> bytes:
    """Insert many copies of an opening bracket, a quotation mark, a blank or a line of the file."""
    lines = content.splitlines(keepends=True)
    if lines and not rng.integers(4):
        new = lines[rng.integers(len(lines))]
    else:
        new = _NESTED[rng.integers(len(_NESTED))]
    repeats = int(min(_MAX_REPEATS ** rng.random(), _MAX_GROWTH // max(1, len(new))))
    at = int(rng.integers(len(content) + 1))
    return content[:at] + new * repeats + content[at:]


def compress(content: bytes, rng: Generator) -> bytes:
    """Wrap in gzip, sometimes in several layers, with a damaged end or followed by more."""
    for _ in range(int(rng.integers(1, 3))):
        content = gzip.compress(content, 1, mtime=0)
    return cut(content, rng) if rng.integers(2) else content + rng.bytes(int(rng.integers(9)))


def inside(content: bytes, rng: Generator, damage: Damage) -> bytes:
    """Damage what a gzip file or ZIP archive holds, and pack it with valid checksums."""
    if content.startswith(b"\x1f\x8b"):
        try:
            return gzip.compress(damage(gzip.decompress(content), rng), 1, mtime=0)
        except (OSError, EOFError, zlib.error):
            return damage(content, rng)
    if not content.startswith(b"PK"):
        return damage(content, rng)
    packed = BytesIO()
    try:
        with ZipFile(BytesIO(content)) as archive, ZipFile(packed, "w") as target:
            members = archive.namelist() or [""]
            chosen = members[rng.integers(len(members))]
            for member in members:
                found = archive.read(member)
                target.writestr(member, damage(found, rng) if member == chosen else found)
    except (BadZipFile, OSError, EOFError, KeyError, ValueError, RuntimeError, zlib.error):
        return damage(content, rng)
    return packed.getvalue()


DAMAGES: Mapping[str, Damage] = MappingProxyType(
    {
        "bits": flip_bits,
        "cuts": cut,
        "insertions": insert,
        "headers": change_header,
        "counts": change_count,
        "nesting": nest,
        "compression": compress,
    }
)
"""Every damage of bytes, by its name in the table of results."""
