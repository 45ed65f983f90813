"""Formats of robot software, checked with that software where it is installed."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.map_verdict import Verdict
from anisomap.placement import surface_normals
from anisomap.placement.placing import judgement
from anisomap.sensor_map import SensorMap

xml = pytest.importorskip("defusedxml.ElementTree")

IN_METRES = (".urdf", ".xacro", ".mjcf", ".xml", ".icub.txt")
READ_BACK = (".urdf", ".mjcf", ".icub.txt")
NAMES = st.text(
    st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\ufffe\uffff"), max_size=8
)


@st.composite
def skins(draw: st.DrawFn) -> SensorMap:
    count = draw(st.integers(1, 8))
    coordinates = st.floats(-10, 10, allow_subnormal=False)
    positions = draw(hnp.arrays(np.float64, (count, 3), elements=coordinates))
    names = draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))
    return SensorMap(positions, names=tuple(names), units="m")


def dome(n_sensors: int = 60) -> SensorMap:
    turn = np.arange(n_sensors)
    height = 1 - (turn + 0.5) / n_sensors
    ring, angle = np.sqrt(1 - height**2), np.pi * (3 - np.sqrt(5)) * turn
    points = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height])
    return SensorMap(
        40 * points, names=tuple(f"taxel{3 * i + 1}" for i in turn), units="mm", frame="l_hand"
    )


HOSTILE = (
    "$(command id)",
    "\\$(command id)",
    "\\\\$(env HOME)",
    "$$(command id)",
    "a'$(command id)'b",
    '" $(command id) "',
    "' --frame-id x '",
    "${3*7*191}",
    "$${3*7}",
    "a$$b",
    "$",
    "tail\\",
    "$$$(find x)$",
    "${'${1+1}'}",
    "<xacro:insert_block name='x'/>",
)


def hostile_skin() -> SensorMap:
    skin = dome(len(HOSTILE) + 1)
    notes = ("xacro:eval-comments", "xacro:eval-comments:on", "${undefined}")
    names = ("plain", *HOSTILE)
    return replace(skin, names=names, frame="f$(command id)${6*7}$$x", notes=notes)


def test_xacro_evaluates_nothing_in_names(tmp_path: Path) -> None:
    xacro = pytest.importorskip("xacro", reason="the parser of xacro files")
    skin, path = hostile_skin(), tmp_path / "skin.xacro"
    io.write(skin, path)
    robot = tmp_path / "robot.xacro"
    robot.write_text(
        f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r"><xacro:include '
        f'filename="{path}"/><link name="base"/><xacro:skin parent="base"/></robot>'
    )
    root = xml.fromstring(xacro.process_file(str(robot)).toxml())
    assert [link.get("name") for link in root.iter("link")][1:] == list(skin.names)
    assert [j.get("name") for j in root.iter("joint")] == [f"{name}_fixed" for name in skin.names]
    assert root.find("sensor").get("name") == f"{skin.frame}_tactile"
    # Processing the notes of the map would fail, because one of them has an undefined name.
    xacro.process_file(str(path))


@pytest.mark.parametrize("name", ["$(command id)", "${3*7*191}"])
@pytest.mark.parametrize("where", ["sensor", "frame"])
def test_a_urdf_has_no_expressions_of_xacro(name: str, where: str, tmp_path: Path) -> None:
    skin = SensorMap(np.eye(3), names=["a", name, "c"] if where == "sensor" else (), units="m")
    skin = replace(skin, frame=name) if where == "frame" else skin
    with pytest.raises(FileError, match="xacro would evaluate"):
        io.write(skin, tmp_path / "skin.urdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", READ_BACK)
@given(skin=skins())
@settings(max_examples=25, deadline=None)
def test_maps_are_read_back_equal(
    suffix: str, skin: SensorMap, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("robot") / f"skin{suffix}"
    io.write(skin, path)
    found = io.read_map(path)
    assert found.units == "m"
    if suffix == ".icub.txt":
        # A sensor at the origin is not a taxel, and names are port indices.
        np.testing.assert_array_equal(np.sort(found.positions, 0), np.sort(skin.positions, 0))
        return
    np.testing.assert_array_equal(found.positions, skin.positions)
    assert found.names == skin.names


@pytest.mark.parametrize("suffix", [".urdf", ".mjcf", ".xml", ".icub.txt"])
def test_millimetres_become_metres(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"skin{suffix}"
    io.write(dome(), path)
    found = io.read_map(path)
    assert found.units == "m"
    assert found.names == dome().names
    np.testing.assert_allclose(found.positions, dome().positions / 1000)


def test_mujoco_places_the_sites(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    path = tmp_path / "skin.xml"
    io.write(dome(), path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    names = tuple(model.site(i).name for i in range(model.nsite))
    assert names == dome().names
    np.testing.assert_allclose(data.site_xpos, dome().positions / 1000, atol=1e-9)
    z = data.site_xmat.reshape(-1, 3, 3)[:, :, 2]
    np.testing.assert_allclose(z, surface_normals(dome()), atol=1e-9)
    io.write(dome(), tmp_path / "skin.urdf")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "skin.urdf")).nbody >= 1


def test_the_tactile_element_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "skin.urdf"
    io.write(dome(), path)
    root = xml.fromstring(path.read_text())
    (sensor,) = root.findall("sensor")
    assert sensor.find("parent").get("link") == "l_hand"
    tactile = sensor.find("tactile")
    assert tactile.get("channel")
    taxels = tactile.findall("taxel")
    assert [int(taxel.get("idx")) for taxel in taxels] == list(range(60))
    turns = [[float(v) for v in taxel.get("rpy").split()] for taxel in taxels]
    z = Rotation.from_euler("xyz", turns).as_matrix()[:, :, 2]
    np.testing.assert_allclose(z, surface_normals(dome()), atol=1e-9)
    assert all(taxel.find("geometry/sphere").get("radius") for taxel in taxels)
    names = [link.get("name") for link in root.iter("link")]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("suffix", [".urdf", ".xacro", ".mjcf"])
def test_comments_state_method_verdict_and_notes(suffix: str, tmp_path: Path) -> None:
    notes = ("sensors 3--5 & <7> were rarely touched-", "ends with -->", "a\x07b\nc")
    verdict = Verdict("usable", 0.25, reasons=("the halves agree",))
    skin = replace(dome(), method="r-anisomap", verdict=verdict, notes=notes)
    path = tmp_path / f"skin{suffix}"
    io.write(skin, path)
    text = path.read_text(encoding="utf-8")
    xml.fromstring(text)
    comments = re.findall("<!-- (.*?) -->", text)
    assert "60 sensors in metres, right-handed" in comments[0]
    assert f"known up to {skin.known_up_to}" in comments
    assert "method: r-anisomap" in comments
    said = judgement(skin)
    assert " mm" in said[0]
    assert "The halves agree." in said
    assert set(said) < set(comments)
    assert "note: sensors 3- -5 & <7> were rarely touched-" in comments
    assert "note: a?b c" in comments
    assert len(comments) == 6 + len(said)
    io.write(dome(), path)
    assert "<!-- Verdict: cannot tell. -->" in path.read_text(encoding="utf-8")


def test_many_frames_give_a_warning(tmp_path: Path) -> None:
    with pytest.warns(AnisomapWarning, match="101 frames, one per sensor"):
        io.write(dome(101), tmp_path / "skin.urdf")


def test_icub_positions_are_indexed_by_port(tmp_path: Path) -> None:
    path = tmp_path / "l_hand.icub.txt"
    io.write(dome(), path)
    lines = path.read_text().splitlines()
    assert lines[0] == "name l_hand"
    assert lines[1] == "spatial_sampling taxel"
    assert lines[2].startswith("taxel2Repr ( ")
    assert lines[2].endswith(" )")
    assert lines[3] == "[calibration]"
    rows = np.array([[float(v) for v in line.split()] for line in lines[4:]])
    assert all(line == line.lstrip() for line in lines)
    ports = 3 * np.arange(60) + 1
    stands_for = np.array(lines[2].split()[2:-1], dtype=int)
    assert len(stands_for) == len(rows)
    np.testing.assert_array_equal(np.flatnonzero(stands_for >= 0), ports)
    np.testing.assert_allclose(rows[ports, :3], dome().positions / 1000)
    np.testing.assert_allclose(np.linalg.norm(rows[ports, 3:], axis=1), 1)
    assert not np.delete(rows, ports, axis=0).any()
    assert not rows[-1].any()
    unnumbered = SensorMap(dome().positions, names=[f"s{i}x" for i in range(60)], units="mm")
    io.write(unnumbered, path)
    assert io.read_map(path).names == tuple(f"taxel{i}" for i in range(60))


def test_point_cloud_readers_agree(tmp_path: Path) -> None:
    io.write(dome(), tmp_path / "skin.ply")
    meshio = pytest.importorskip("meshio", reason="an independent reader of PLY")
    cloud = meshio.read(tmp_path / "skin.ply")
    np.testing.assert_array_equal(cloud.points, dome().positions)
    normals = np.column_stack([cloud.point_data[name] for name in ("nx", "ny", "nz")])
    np.testing.assert_array_equal(normals, surface_normals(dome()))
    trimesh = pytest.importorskip("trimesh", reason="an independent reader of PLY")
    np.testing.assert_allclose(trimesh.load(tmp_path / "skin.ply").vertices, dome().positions)


@pytest.mark.parametrize("suffix", IN_METRES)
def test_a_map_without_scale_or_with_two_components_is_rejected(
    suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"skin{suffix}"
    assert io.needs_scale(path)
    with pytest.raises(InputError, match="needs positions in metres"):
        io.write(SensorMap(np.eye(3)), path)
    with pytest.raises(InputError, match=r"the map has 2; .*split"):
        io.write(SensorMap(np.eye(3), component=[0, 0, 1], units="m"), path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".urdf", ".mjcf"])
def test_names_with_control_characters_are_rejected(suffix: str, tmp_path: Path) -> None:
    skin = SensorMap(np.eye(3), names=["a", "b\x07", "c"], units="m")
    with pytest.raises(FileError, match="cannot represent control characters"):
        io.write(skin, tmp_path / f"skin{suffix}")
