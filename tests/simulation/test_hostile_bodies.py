"""Bodies that declare far more than they hold, or name files of the system."""

import json
import logging
import os
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from anisomap.errors import FileError, InputError
from anisomap.files import reader_process
from anisomap.files.meshes import read_mesh
from anisomap.simulation import load_body

trimesh = pytest.importorskip("trimesh", reason="needs the extra 'simulation'")
pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

needs_limit = pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of time")
BODY = """<geom type="box" size="1 1 1"/><site pos="1 0 0"/><site pos="0 1 0"/><site pos="0 0 1"/>
<site pos="-1 0 0"/>"""
MEMORY = r"robot\.xml.*memory"
DECLARED = {
    "hfield": ('<hfield name="a" nrow="100000" ncol="100000" size="1 1 1 1"/>', "", MEMORY),
    "texture": (
        '<texture name="a" type="2d" builtin="flat" width="60000" height="60000"/>',
        "",
        MEMORY,
    ),
    "memory": ('</asset><size memory="50G"/><asset>', "", MEMORY),
    "nuser": ('</asset><size nuser_body="200000000"/><asset>', "", MEMORY),
    "geoms": (
        "",
        '<replicate count="1001"><geom size=".1"/></replicate>',
        r"robot\.xml has 1,002 geoms, more than 1,000",
    ),
}


@pytest.fixture
def model(tmp_path):
    def write(assets="", parts="", name="robot.xml"):
        path = tmp_path / name
        path.write_text(
            f"<mujoco><!-- a -- b --><asset>{assets}</asset><worldbody>{BODY}{parts}</worldbody>"
            "</mujoco>"
        )
        return path

    return write


@pytest.mark.parametrize("what", DECLARED)
def test_models_that_declare_too_much_are_refused(model, what):
    assets, parts, message = DECLARED[what]
    with pytest.raises(FileError, match=message):
        load_body(model(assets, parts))


def test_solids_with_a_length_of_almost_0_are_refused(model):
    with pytest.raises(InputError, match="lengths of a cylinder differ too much"):
        load_body(model("", '<geom type="cylinder" size="1e-320 .2"/>'))


@needs_limit
def test_copies_of_elements_take_limited_time(model, monkeypatch):
    monkeypatch.setattr(reader_process, "_SECONDS", 1)
    with pytest.raises(FileError, match="takes more than 1 s"):
        load_body(model("", '<replicate count="100000"><geom size=".1"/></replicate>'))


def test_copies_of_a_mesh_are_limited_by_their_triangles(model, tmp_path):
    trimesh.creation.icosphere(subdivisions=5).export(tmp_path / "ball.stl")  # 20,480 triangles
    asset, copy = '<mesh name="m" file="ball.stl"/>', '<geom type="mesh" mesh="m"/>'
    with pytest.raises(FileError, match="surface of its meshes expands to"):
        load_body(model(asset, copy * 100), 4)
    assert load_body(model(asset, copy), 4).n_sensors == 4


def test_models_with_copies_and_comments_are_read(model):
    copies = '<replicate count="5" offset="0 0 .1"><geom size=".1"/></replicate>'
    assert len(load_body(model("", copies)).solids) == 6


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes need POSIX")
@pytest.mark.parametrize("name", ["pipe.stl", "pipe.xml"])
def test_pipes_in_models_are_refused(model, tmp_path, name):
    os.mkfifo(tmp_path / name)
    assets = '<mesh name="m" file="pipe.stl"/>'
    path = model(*((assets, "") if name == "pipe.stl" else ("", f'<include file="{name}"/>')))
    with pytest.raises(FileError, match="not a regular file"):
        load_body(path)
    with pytest.raises(FileError, match="not a regular file"):
        load_body(tmp_path / name, 5)


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
    assert load_body(box_file(tmp_path / "box.glb", faces), 9).n_sensors == 9
    faces[3, 1] = 70_000
    with pytest.raises(FileError, match=r"bad\.glb.*(vertex 70000|cannot be read)"):
        load_body(box_file(tmp_path / "bad.glb", faces), 9)


def test_arrays_without_data_are_refused(tmp_path):
    huge = [{"componentType": 5126, "type": "VEC3", "count": 10**9}] * 2
    path = box_file(tmp_path / "huge.glb", trimesh.creation.box().faces, accessors=huge)
    with pytest.raises(FileError, match="decompression bomb"):
        load_body(path, 9)


def test_damage_to_normals_prints_nothing(tmp_path, monkeypatch, capfd):
    """Normals are not read from files; a handler of pytest would hide the log of trimesh."""
    text = trimesh.creation.box().export(file_type="stl_ascii")
    (tmp_path / "skin.stl").write_text(text.replace("facet normal 0", "facet normal !0", 1))
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    assert load_body(tmp_path / "skin.stl", 9).n_sensors == 9
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("named", ["/dev/zero", "pipe.mtl"])
def test_materials_are_not_opened(tmp_path, named):
    if not (hasattr(os, "mkfifo") and Path("/dev/zero").exists()):
        pytest.skip("named pipes and /dev/zero need POSIX")
    os.mkfifo(tmp_path / "pipe.mtl")
    text = trimesh.creation.box().export(file_type="obj")
    (tmp_path / "box.obj").write_text(f"mtllib {named}\nusemtl a\n{text}")
    assert load_body(tmp_path / "box.obj", 9).n_sensors == 9


def test_groups_of_a_mesh_are_not_divided(tmp_path):
    """The 20,000 groups would take a minute."""
    box = trimesh.creation.box().export(file_type="obj", include_normals=False)
    vertices = [line for line in box.splitlines() if line.startswith("v ")]
    faces = [line for line in box.splitlines() if line.startswith("f ")]
    groups = [f"o a{i}\ng g{i}\nusemtl m{i}\ns {i}" for i in range(20_000)]
    groups[: len(faces)] = [f"{g}\n{face}" for g, face in zip(groups, faces, strict=False)]
    (tmp_path / "plain.obj").write_text("\n".join(vertices + faces))
    (tmp_path / "groups.obj").write_text("\n".join(vertices + groups))
    plain, grouped = read_mesh(tmp_path / "plain.obj"), read_mesh(tmp_path / "groups.obj")
    assert len(plain[1]) == 12
    for expected, found in zip(plain, grouped, strict=True):
        np.testing.assert_array_equal(found, expected)


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
    with pytest.raises(FileError, match="announces 5000 triangles"):
        read_mesh(tmp_path / "a.stl")
