"""Meshes that declare far more than they hold, or name files of the system."""

import json
import logging
import os
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from anisomap.errors import FileError
from anisomap.files import reader_process
from anisomap.files.meshes import read_mesh

trimesh = pytest.importorskip("trimesh", reason="needs the extra 'mesh'")

needs_limit = pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of time")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes need POSIX")
def test_pipes_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    with pytest.raises(FileError, match="not a regular file"):
        read_mesh(tmp_path / "pipe.stl")


def write_glb(path, scene, content):
    """Write a description and the bytes that it describes."""
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text
    parts += struct.pack("<I4s", len(content), b"BIN\0") + content
    path.write_bytes(b"glTF" + struct.pack("<2I", 2, 12 + len(parts)) + parts)
    return path


def box_file(path, faces, **document):
    """Write a mesh, with its faces and some entries of its description replaced."""
    mesh = trimesh.creation.box()
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="glb")
    end = 20 + int.from_bytes(whole[12:16], "little")
    own, given = (np.asarray(each, "<u4").tobytes() for each in (mesh.faces, faces))
    scene = json.loads(whole[20:end]) | document
    return write_glb(path, scene, whole[end + 8 :].replace(own, given))


def test_faces_beyond_the_vertices_are_refused(tmp_path):
    faces = np.array(trimesh.creation.box().faces)
    assert len(read_mesh(box_file(tmp_path / "box.glb", faces))[1]) == 12
    faces[3, 1] = 70_000
    with pytest.raises(FileError, match=r"bad\.glb.*(vertex 70000|cannot be read)"):
        read_mesh(box_file(tmp_path / "bad.glb", faces))


def test_arrays_without_data_are_refused(tmp_path):
    huge = [{"componentType": 5126, "type": "VEC3", "count": 10**9}] * 2
    path = box_file(tmp_path / "huge.glb", trimesh.creation.box().faces, accessors=huge)
    with pytest.raises(FileError, match="decompression bomb"):
        read_mesh(path)


def test_damage_to_normals_prints_nothing(tmp_path, monkeypatch, capfd):
    """Normals are not read from files; a handler of pytest would hide the log of trimesh."""
    text = trimesh.creation.box().export(file_type="stl_ascii")
    (tmp_path / "skin.stl").write_text(text.replace("facet normal 0", "facet normal !0", 1))
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    assert len(read_mesh(tmp_path / "skin.stl")[1]) == 12
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("named", ["/dev/zero", "pipe.mtl"])
def test_materials_are_not_opened(tmp_path, named):
    if not (hasattr(os, "mkfifo") and Path("/dev/zero").exists()):
        pytest.skip("named pipes and /dev/zero need POSIX")
    os.mkfifo(tmp_path / "pipe.mtl")
    text = trimesh.creation.box().export(file_type="obj")
    (tmp_path / "box.obj").write_text(f"mtllib {named}\nusemtl a\n{text}")
    assert len(read_mesh(tmp_path / "box.obj")[1]) == 12


@needs_limit
def test_copies_of_parts_of_a_mesh_take_limited_time(tmp_path, monkeypatch):
    """Each node places all parts of a mesh, which takes time and memory for each."""
    corners = np.eye(3, dtype="<f4").tobytes()
    scene = {
        "buffers": [{"byteLength": len(corners)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(corners)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 300}],
        "nodes": [{"mesh": 0}] * 300,
        "scenes": [{"nodes": [*range(300)]}],
    }
    path = write_glb(tmp_path / "a.glb", scene, corners)
    monkeypatch.setattr(reader_process, "_SECONDS", 1)
    with pytest.raises(FileError, match=r"a\.glb: reading takes more than 1 s; it is damaged"):
        read_mesh(path)


def test_a_false_number_of_triangles_is_named(tmp_path):
    (tmp_path / "a.stl").write_bytes(bytes(80) + struct.pack("<I", 5000) + bytes(500))
    with pytest.raises(FileError, match="5000 triangles in 584 bytes"):
        read_mesh(tmp_path / "a.stl")
