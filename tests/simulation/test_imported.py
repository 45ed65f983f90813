"""Bodies from meshes, MuJoCo models and positions."""

import numpy as np
import pytest

from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.simulation import body_from_mesh, body_from_points, load_body, simulate, solids
from anisomap.simulation.bodies import hand, sphere

trimesh = pytest.importorskip("trimesh", reason="needs the extra 'simulation'")
mujoco = pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

ROBOT = """<mujoco><worldbody><geom type="plane" size="3 3 .1"/>
<body pos="0 0 1" euler="0 0 90"><geom type="capsule" fromto="0 0 0 .5 0 0" size=".1"/>
<geom type="ellipsoid" size=".2 .1 .15" pos=".6 0 0"/>
<geom type="box" size=".5 .5 .5" contype="0" conaffinity="0"/>
{sites}</body></worldbody></mujoco>"""
SITES = """<site name="a" pos="0 0 .1"/><site pos=".2 0 .1"/><site name="c" pos=".2 .1 0"/>"""


@pytest.fixture
def folder(tmp_path):
    part = trimesh.creation.annulus(0.5, 1.0, 1.0)
    part.apply_translation([10, 20, 30])
    for suffix in ("stl", "obj", "ply", "off", "glb"):
        part.export(tmp_path / f"part.{suffix}")
    (tmp_path / "robot.xml").write_text(ROBOT.format(sites=SITES))
    (tmp_path / "bare.xml").write_text(ROBOT.format(sites=""))
    (tmp_path / "floor.xml").write_text(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    (tmp_path / "broken.stl").write_bytes(b"solid nothing at all")
    (tmp_path / "long.off").write_text("OFF\n3 1 0\n" + "0 0 x" * 5000)
    (tmp_path / "notes.txt").write_text("no body")
    open_part = trimesh.Trimesh(part.vertices, part.faces[:-5], process=False)
    open_part.export(tmp_path / "open.stl")
    return tmp_path


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "glb"])
def test_sensors_are_spread_over_a_mesh_of_any_format(folder, suffix):
    body = load_body(folder / f"part.{suffix}", 40)
    assert (body.name, body.n_sensors) == ("part", 40)
    np.testing.assert_allclose(body.distance(body.positions), 0, atol=1e-6)
    np.testing.assert_allclose(body.origin, [10, 20, 30], atol=1e-6)


def test_sites_of_a_model_become_sensors(folder):
    body = load_body(folder / "robot.xml")
    assert body.names == ("a", "site1", "c")
    places = body.positions + body.origin
    np.testing.assert_allclose(places, [[0, 0, 1.1], [0, 0.2, 1.1], [-0.1, 0.2, 1]], atol=1e-9)
    np.testing.assert_allclose(body.normals, [[0, 0, 1], [0, 0, 1], [-1, 0, 0]], atol=1e-4)
    # Without the floor and the visual box.
    assert {solid.kind for solid in body.solids} == {"capsule", "ellipsoid"}
    assert body.units == "m"
    assert load_body(folder / "bare.xml", 30).n_sensors == 30


def test_given_sensors_near_the_surface_are_projected_onto_it():
    outline, exact = solids.ball(1.0).outline, sphere(40).positions
    names = [f"n{i}" for i in range(40)]
    body = body_from_mesh(outline.vertices, outline.faces, exact, names=names)
    assert np.linalg.norm(body.positions - exact, axis=1).max() < 0.01
    assert body.names[3] == "n3"
    for sensors, message in (
        (np.vstack([exact[:7], 1.5 * exact[7:8]]), r"sensor s7 is 0\.5.* off the surface of mesh"),
        (1000 * exact, "check that they use the frame and unit of the body"),
        (exact[:, :2], r"sensors must have shape \(N, 3\), got \(40, 2\)"),
    ):
        with pytest.raises(InputError, match=message):
            body_from_mesh(outline.vertices, outline.faces, sensors)


def test_a_body_from_points_leaves_all_sensors_exposed():
    for positions in (part.positions + np.array([3, 2, 1]) for part in (sphere(), hand())):
        body = body_from_points(positions)
        np.testing.assert_allclose(body.distance(body.positions), 0, atol=1e-9)
        np.testing.assert_allclose(body.positions + body.origin, positions, atol=1e-12)
    ball = sphere(200)
    estimated = body_from_points(ball.positions).normals
    assert (np.einsum("nd,nd->n", estimated, ball.normals) > np.cos(np.radians(12))).all()
    assert body_from_points(ball.positions).surface_distances is None
    far = ball.positions + np.array([10, 20, 30])
    recording = simulate(body_from_points(far), "pressing", n_frames=1500)
    assert recording.varying().all()
    np.testing.assert_allclose(recording.positions, far, atol=1e-12)


def test_normals_are_used_unless_they_contradict_the_positions():
    ball = sphere(150)
    kept = body_from_points(ball.positions, 2 * ball.normals)
    np.testing.assert_allclose(kept.normals, ball.normals)
    placeholders = np.tile([1.0, 0, 0], (150, 1))
    with pytest.warns(AnisomapWarning, match="contradict its sensor positions"):
        body = body_from_points(ball.positions, placeholders)
    assert (np.einsum("nd,nd->n", body.normals, ball.normals) > 0.9).all()


@pytest.mark.slow
def test_a_robot_leg_is_simulated_from_positions(recordings_folder):
    path = recordings_folder.parent / "geometry" / "icub_left_leg_upper.npz"
    if not path.exists():
        pytest.skip("needs the geometry of the robot")
    with np.load(path, allow_pickle=False) as part:
        positions, normals = part["positions"], part["normals"]
    with pytest.warns(AnisomapWarning, match="the normals of leg contradict"):
        body = body_from_points(positions, normals, name="leg", units="m")
    recording = simulate(body, n_frames=500)
    np.testing.assert_allclose(recording.positions, positions, atol=1e-12)
    assert recording.n_sensors == 680
    assert recording.varying().mean() > 0.95
    assert float(recording.metadata["energy_drift"]) < 0.02


@pytest.mark.parametrize(
    ("name", "sensors", "error", "message"),
    [
        ("nothing.stl", 10, FileError, "there is no file"),
        ("notes.txt", 10, FileError, "notes.txt is not a body: a mesh ends in .glb"),
        ("part.stl", None, FileError, "is a mesh without sensors"),
        ("part.stl", 0, InputError, "sensors must be an integer of at least 1, got 0"),
        ("open.stl", 10, InputError, "the mesh is not closed"),
        ("broken.stl", 10, FileError, "cannot be read as a mesh|has no area|is damaged"),
        ("long.off", 10, FileError, "damaged or cut short"),
        ("bare.xml", None, FileError, "has no sites to use as sensors"),
        ("floor.xml", 10, FileError, "has no geoms for sensors"),
        ("broken.xml", 10, FileError, "MuJoCo cannot read"),
    ],
)
def test_an_invalid_file_raises_a_short_error(folder, name, sensors, error, message):
    with pytest.raises((error, InputError), match=message) as raised:
        load_body(folder / name, sensors)
    assert len(str(raised.value).replace(str(folder), "")) <= 300


def test_invalid_positions_raise_an_error():
    for positions in (np.zeros((3, 3)), np.zeros((9, 2))):
        with pytest.raises(InputError, match=r"\(N, 3\) with N at least 4"):
            body_from_points(positions)
    with pytest.raises(InputError, match="sensors 0 and 3 coincide"):
        body_from_points(np.vstack([np.eye(3), [[1, 0, 0]]]))


@pytest.mark.parametrize("value", ["nan", "1e308", "-1e30"])
def test_models_out_of_range_leave_nothing_behind(tmp_path, monkeypatch, capfd, value):
    """MuJoCo would print warnings and append them to MUJOCO_LOG.TXT in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.xml").write_text(
        f"<mujoco><worldbody><geom size='1' pos='0 0 {value}'/></worldbody></mujoco>"
    )
    with pytest.raises(InputError, match=r"part"):
        load_body(tmp_path / "part.xml", 4)
    assert [path.name for path in tmp_path.iterdir()] == ["part.xml"]
    assert capfd.readouterr() == ("", "")
