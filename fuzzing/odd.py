"""Files that are valid in their container but odd in content, and files that expand enormously.

Each function returns the content of a file of one format; `ODD` and `BOMBS` list them by format.
Formats without an entry are damaged as bytes only.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Mapping
from copy import deepcopy
from importlib import import_module
from io import BytesIO
from types import MappingProxyType
from typing import Any, TypeAlias
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Maker: TypeAlias = Callable[[Generator], bytes]

_FIELDS = (
    *("readings", "names", "times", "positions", "units", "source", "rate_hz", "normals"),
    *("surface_distances", "component", "health", "metadata", "notes", "stress", "method", "x"),
)
_DTYPES = (
    *("f8", "f4", "f2", "i8", "i1", "u2", "u8", "?", "c16", "U5", "S3", ">f8", ">i4", "M8[ns]"),
    *("m8[s]", "M8[D]"),
)
_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1e308, 10**400, "", "a", "\u202e", "x" * 2000, [], {}, [[]], [None]),
    *([1, 2, 3], [[1, 2], [3]], {"a": 1}, [True, False], ["a", "a"], "nan", [1e999]),
)
BOMB_BYTES = 1 << 28
"""Bytes that a bomb expands to: more than the budget of 200 MB, little enough to build quickly."""


def odd_array(rng: Generator) -> NDArray[Any]:
    """Make an array of any type and shape, with extreme values."""
    shape = tuple(int(n) for n in rng.choice([0, 1, 2, 3, 5, 9, 24], size=int(rng.integers(4))))
    kind = np.dtype(str(rng.choice(_DTYPES)))
    values = rng.choice([0.0, 1.0, -1.0, 0.5, 255.0, np.nan, np.inf, 1e300, 1e-320], size=shape)
    if kind.kind in "US":
        return np.asarray(values, dtype=kind)
    with np.errstate(all="ignore"):
        if kind.kind in "iuMm?":
            values = np.nan_to_num(values, posinf=1e9, neginf=-1e9).clip(-(2**62), 2**62)
        return np.asarray(values).astype(kind, copy=False)


def _fields(rng: Generator) -> dict[str, NDArray[Any]]:
    names = rng.choice(_FIELDS, size=int(rng.integers(1, 7)), replace=False)
    found = {str(name): odd_array(rng) for name in names}
    if rng.integers(3):
        found["readings"] = rng.random((24, 5))
    if not rng.integers(4):
        found["positions"] = rng.random((5, int(rng.integers(1, 5))))
    return found


def odd_npz(rng: Generator) -> bytes:
    """Make an NPZ archive with the names of ours and arrays of odd types."""
    packed = BytesIO()
    np.savez(packed, allow_pickle=False, **_fields(rng))
    return packed.getvalue()


def odd_mat(rng: Generator) -> bytes:
    """Make a MATLAB file with structures, cells and text."""
    more = ({"a": np.eye(3)}, np.array([np.eye(2), "x"], dtype=object), "x")
    kept = {name: one for name, one in _fields(rng).items() if one.dtype.kind in "fciubUSO"}
    stream = BytesIO()
    packed = bool(rng.integers(2))
    import_module("scipy.io").savemat(
        stream, {**kept, "more": more[rng.integers(len(more))]}, do_compression=packed
    )
    return stream.getvalue()


def odd_hdf5(rng: Generator) -> bytes:
    """Make an HDF5 file with groups, links, references, odd types and declared sizes."""
    h5py = import_module("h5py")
    stream = BytesIO()
    with h5py.File(stream, "w") as file:
        for name, array in _fields(rng).items():
            plain = array.view("i8") if array.dtype.kind in "Mm" and array.ndim else array
            plain = plain if plain.dtype.kind in "biufcS" else np.array([b"text"])
            file["a/" * int(rng.integers(3)) + name] = plain
        odd: tuple[Callable[[], Any], ...] = (
            lambda: file.update({"outside": h5py.ExternalLink("/etc/passwd", "/x")}),
            lambda: file.update({"loop": h5py.SoftLink("/loop")}),
            lambda: file.create_dataset("big", (1 << 50, 9), "f8", chunks=(64, 9)),
            lambda: file.create_dataset("references", (3,), h5py.ref_dtype),
            lambda: file.create_dataset("ragged", (3,), h5py.vlen_dtype("f8")),
            lambda: file.create_dataset("empty", data=h5py.Empty("f4")),
        )
        odd[rng.integers(len(odd))]()
    return stream.getvalue()


def odd_json(rng: Generator) -> bytes:
    """Make a JSON map with one to three values of other types."""
    document: dict[str, Any] = {
        "format": "anisomap map",
        "version": 1,
        "method": "r-anisomap",
        "units": "mm",
        "notes": ["a note"],
        "provenance": {"seed": 3},
        "sensors": [
            {"name": f"s{i}", "position": [i, 1.0, 2.0], "component": 0, "health": "ok"}
            for i in range(4)
        ],
    }
    for _ in range(int(rng.integers(1, 4))):
        _replace(document, rng)
    return json.dumps(document).encode()


def _replace(node: Any, rng: Generator) -> None:
    keys = list(node) if isinstance(node, dict) else list(range(len(node)))
    if not keys:
        return
    key = keys[rng.integers(len(keys))]
    inner = node[key]
    if isinstance(inner, dict | list) and inner and rng.integers(4):
        _replace(inner, rng)
    elif isinstance(node, dict) and not rng.integers(4):
        del node[key]
    else:
        node[key] = deepcopy(_VALUES[rng.integers(len(_VALUES))])


def odd_positions(rng: Generator) -> bytes:
    """Make a map of sensors whose positions are extreme, equal or on a line."""
    n_sensors = int(rng.choice([1, 2, 3, 4, 12]))
    positions = rng.normal(0, 1, (n_sensors, int(rng.choice([1, 2, 3]))))
    positions *= rng.choice([1e-320, 1e-200, 1e-9, 1, 1e9, 1e160, 1e300])
    kind = rng.integers(4)
    if kind == 0:
        positions[:] = positions[0]
    elif kind == 1:
        positions[:, 1:] = 0
    elif kind == 2:
        positions[rng.integers(n_sensors)] = rng.choice([1e308, -1e200, 0.0, 1e-308])
    sensors = [
        {"name": f"a{i}", "position": row, "component": 0}
        for i, row in enumerate(positions.tolist())
    ]
    whole = {"format": "anisomap map", "version": 1, "units": "m", "sensors": sensors}
    return json.dumps(whole).encode()


def bomb_npz(rng: Generator) -> bytes:
    """Compress an array of zeros."""
    stream, header = BytesIO(), BytesIO()
    n_rows = BOMB_BYTES // 8 // 4
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": bool(rng.integers(2)), "shape": (n_rows, 4)}
    )
    with ZipFile(stream, "w", ZIP_DEFLATED, compresslevel=1) as archive:
        name = str(rng.choice(["readings.npy", "names.npy", "other.npy"]))
        with archive.open(name, "w", force_zip64=True) as member:
            member.write(header.getvalue())
            for _ in range(BOMB_BYTES >> 22):
                member.write(bytes(1 << 22))
    return stream.getvalue()


def bomb_gzip(rng: Generator) -> bytes:
    """Compress one line, or lines, of text; fewer of lines, which are read one by one."""
    unit = (b"0", b"1,2,3\n", b" ", b"\n", b"a,b\n", b"1 2 3 ")[rng.integers(6)]
    stream = BytesIO()
    with gzip.GzipFile(fileobj=stream, mode="wb", compresslevel=1, mtime=0) as packed:
        packed.write(b"a,b,c\n1,2,3\n" if rng.integers(2) else b"")
        part = unit * ((1 << 20) // len(unit))
        for _ in range((1 << 24 if unit.endswith(b"\n") else BOMB_BYTES) >> 20):
            packed.write(part)
    return stream.getvalue()


def bomb_hdf5(rng: Generator) -> bytes:
    """Declare a large dataset, of which no chunk, or compressed zeros are stored."""
    h5py = import_module("h5py")
    stream = BytesIO()
    with h5py.File(stream, "w") as file:
        shape = (BOMB_BYTES // 8 // 4, 4)
        if rng.integers(2):
            shape = (1 << 40, 4)
        file.create_dataset("readings", shape, "f8", chunks=(1 << 16, 4), compression="gzip")
    return stream.getvalue()


ODD: Mapping[str, Maker] = MappingProxyType(
    {
        "npz": odd_npz,
        "mat": odd_mat,
        "hdf5": odd_hdf5,
        "json": odd_json,
        "maps": odd_positions,
    }
)
BOMBS: Mapping[str, Maker] = MappingProxyType(
    {
        "npz": bomb_npz,
        "hdf5": bomb_hdf5,
        "text": bomb_gzip,
        "yarp": bomb_gzip,
        "json": bomb_gzip,
        "ply": bomb_gzip,
        "mat-export": bomb_gzip,
    }
)
