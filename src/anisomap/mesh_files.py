"""Vertices and faces of mesh files."""

from __future__ import annotations

import json
import re
from collections import Counter
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, import_extra
from anisomap.files import open_regular, without_log
from anisomap.memory import Budget
from anisomap.wording import printable, shortened

# Names of objects, groups and materials: trimesh takes quadratic time to divide a mesh by them.
_OBJ_GROUPS = re.compile(rb"^[ \t]*+(?:usemtl|mtllib|o|g|s)\b[^\r\n]*+", re.MULTILINE)
_MAX_REASON = 150  # characters of a message of trimesh
_GLB, _GLB_HEADER = b"glTF", 20  # bytes before the JSON
_ITEM_BYTES = 64  # largest item of an accessor: 16 floating-point numbers
_MAX_PARTS = 5000  # that nodes place: trimesh takes 0.2 ms for each
_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes of a binary file


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Read a mesh without its materials, which may be in other files.

    Returns vertices (V, 3), faces.
    """
    trimesh = import_extra("trimesh", "reading a mesh", "simulation")
    suffix = path.suffix.lower()
    with open_regular(path) as stream:
        content = stream.read()
    if suffix == ".glb":
        _check_accessors(path, content)
    if suffix == ".stl":
        _check_triangles(path, content)
    if suffix == ".obj":
        content = _OBJ_GROUPS.sub(b"", content)
    # Messages of trimesh concern parts that are not read, such as the normals of faces.
    with without_log("trimesh"):
        try:
            # Given bytes without a name, trimesh opens no other file.
            loaded = trimesh.load_mesh(BytesIO(content), file_type=suffix[1:])
            vertices = np.asarray(loaded.vertices, dtype=np.float64)
            faces = np.asarray(loaded.faces, dtype=np.intp)
        except Exception as error:
            # The type of the exception depends on the format and the version of trimesh.
            reason = printable(shortened(" ".join(str(error).split()), _MAX_REASON))
            raise FileError(f"{path} cannot be read as a mesh: {reason}") from error
    if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise FileError(
            f"{path} is damaged: a face has vertex {faces.max()}, but the mesh has {len(vertices)} "
            "vertices, numbered from 0"
        )
    return vertices, faces


def _check_accessors(path: Path, content: bytes) -> None:
    """Check the arrays that a GLB file declares, of which those without data are zeros."""
    if not content.startswith(_GLB):
        raise FileError(f"{path} is not a GLB file")
    end = _GLB_HEADER + int.from_bytes(content[12:16], "little")
    try:
        scene = json.loads(content[_GLB_HEADER:end])
        counts = [int(accessor["count"]) for accessor in scene.get("accessors", [])]
        # Each node places a copy of the parts of one mesh.
        nodes = Counter(node["mesh"] for node in scene.get("nodes", []) if "mesh" in node)
        placed = [
            (nodes[i], [counts[at] for at in (part["attributes"]["POSITION"], part.get("indices"))
                        if at is not None])
            for i, mesh in enumerate(scene.get("meshes", []))
            for part in mesh["primitives"]
        ]  # fmt: skip
    except (LookupError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise FileError(f"{path} is damaged: its header is not a description of meshes") from error
    n_items = sum(counts) + sum(copies * sum(items) for copies, items in placed)
    Budget(path).check(_ITEM_BYTES * n_items, "its content")
    n_parts = sum(copies for copies, _ in placed)
    if n_parts > _MAX_PARTS:
        raise FileError(
            f"{path} places {n_parts} copies of parts of meshes; at most {_MAX_PARTS} are "
            "supported, so join them in the program that wrote the file"
        )


def _check_triangles(path: Path, content: bytes) -> None:
    """Check the number of triangles of a binary STL file, which trimesh takes for text if wrong."""
    n_triangles = int.from_bytes(content[_STL_HEADER - 4 : _STL_HEADER], "little")
    start = content[:_MAX_REASON].lstrip().lower()
    is_text = start.startswith(b"solid") and b"facet" in content.lower()
    if not is_text and len(content) != _STL_HEADER + _STL_TRIANGLE * n_triangles:
        raise FileError(
            f"{path} is damaged: it announces {n_triangles} triangles, but its size is "
            f"{len(content)} bytes"
        )
