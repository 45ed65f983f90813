"""Vertices and faces of mesh files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, import_extra
from anisomap.files.paths import open_regular
from anisomap.files.reader_process import opened

# Names of objects, groups and materials, by which trimesh splits a mesh in quadratic time.
_OBJ_GROUPS = re.compile(rb"^[ \t]*+(?:usemtl|mtllib|o|g|s)\b[^\r\n]*+", re.MULTILINE)
_STL_START, _STL_HEADER, _STL_TRIANGLE = 150, 84, 50  # bytes of a binary file


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Read a mesh without materials, which may be in other files.

    Returns vertices (V, 3), faces.
    """
    with opened(_read, path) as parts:
        vertices, faces = next(parts)
    if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise FileError(f"{path} is damaged: a face has vertex {faces.max()} of {len(vertices)}")
    return vertices, faces


def _read(path: Path) -> Iterator[list[NDArray[np.generic]]]:
    """Yield the vertices and faces; runs in the reader process."""
    trimesh = import_extra("trimesh", "reading a mesh", "mesh")
    with open_regular(path) as stream:
        content = stream.read()
    suffix = path.suffix.lower()
    if suffix == ".stl":
        _check_triangles(path, content)
    if suffix == ".obj":
        content = _OBJ_GROUPS.sub(b"", content)
    # trimesh does not open other files if it is given bytes without a name.
    mesh = trimesh.load_mesh(BytesIO(content), file_type=suffix[1:])
    yield [np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.intp)]


def _check_triangles(path: Path, content: bytes) -> None:
    """Check the number of triangles of a binary STL file; trimesh reads incorrect files as text."""
    n_triangles = int.from_bytes(content[_STL_HEADER - 4 : _STL_HEADER], "little")
    start = content[:_STL_START].lstrip().lower()
    is_text = start.startswith(b"solid") and b"facet" in content.lower()
    if not is_text and len(content) != _STL_HEADER + _STL_TRIANGLE * n_triangles:
        raise FileError(
            f"{path} is damaged: it announces {n_triangles} triangles in {len(content)} bytes"
        )
