"""Forward kinematics: MuJoCo as the reference, and laws of rigid transforms."""

import numpy as np
import pytest
from benchmarks.placing.self_touch import JOINTS, URDF

from anisomap.errors import FileError, InputError
from anisomap.io import read_robot

MASSES = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
FINGER = """<link name="finger"/><joint name="f" type="fixed"><parent link="left"/>
<child link="finger"/><origin xyz="0.1 0.2 0.3" rpy="1 0.5 -0.7"/></joint></robot>"""


def robot_of(text, folder):
    path = folder / "robot.urdf"
    path.write_text(text)
    return read_robot(path)


@pytest.fixture
def robot(tmp_path):
    return robot_of(URDF.replace("</robot>", FINGER), tmp_path)


def angles_of(values):
    return dict(zip(JOINTS, np.atleast_2d(values).T, strict=True))


def test_poses_are_those_of_mujoco(robot):
    mujoco = pytest.importorskip("mujoco")
    text = URDF.replace("</robot>", FINGER)
    links = ("base", "l1", "l2", "left", "r1", "r2", "right", "finger")
    for link in links:
        heavy = f'<link name="{link}">{MASSES}</inertial></link>'
        text = text.replace(f'<link name="{link}"/>', heavy)
    text = text.replace("<link", '<mujoco><compiler fusestatic="false"/></mujoco><link', 1)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    values = np.random.default_rng(3).uniform(-1, 1, (5, len(JOINTS)))
    for link, other in (("finger", "right"), ("r1", "l2"), ("base", "finger"), ("left", "left")):
        found = robot.relative_pose(link, other, angles_of(values))
        for pose, row in zip(np.broadcast_to(found, (5, 4, 4)), values, strict=True):
            for name, value in zip(JOINTS, row, strict=True):
                data.joint(name).qpos[0] = value
            mujoco.mj_kinematics(model, data)
            poses = []
            for body in (link, other):
                where = np.eye(4)
                if body != "base":  # MuJoCo makes the root of a URDF its world
                    where[:3, :3] = data.body(body).xmat.reshape(3, 3)
                    where[:3, 3] = data.body(body).xpos
                poses.append(where)
            np.testing.assert_allclose(pose, np.linalg.inv(poses[0]) @ poses[1], atol=1e-9)


def test_a_joint_follows_another(tmp_path):
    text = URDF.replace('<axis xyz="0 1 0"/></joint>\n<joint name="a3"',
                        '<axis xyz="0 1 0"/><mimic joint="a1" multiplier="-2" offset="0.1"/>'
                        '</joint>\n<joint name="a3"')  # fmt: skip
    angles = angles_of([0.3, -0.5, 0.2, 0, 0, 0])
    alone = robot_of(URDF, tmp_path).relative_pose("base", "left", angles)
    del angles["a2"]
    np.testing.assert_allclose(
        robot_of(text, tmp_path).relative_pose("base", "left", angles), alone, atol=1e-12
    )


BAD = [
    (('<child link="l1"/>', '<child link="base"/>'), "loop|two parents"),
    (('<child link="r1"/>', '<child link="l1"/>'), "two parents"),
    (('name="b1"', 'name="a1"'), "two joints have the name"),
    (('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>'), "axis of joint"),
    (('xyz="0 0.12 0.3"', 'xyz="0 a 0.3"'), "3 finite numbers"),
    (('<child link="r1"/>', ""), "a child link"),
    (('robot name="two_arms"', "sdf"), "no URDF"),
    (("<robot", "<!DOCTYPE x []><robot"), "DTD"),
    (("</robot>", ""), "robot.urdf"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_damaged_urdf(tmp_path, change, message):
    old, new = change
    with pytest.raises(FileError, match=message):
        robot_of(URDF.replace(old, new), tmp_path)


def test_joints_and_links_are_refused_only_on_the_way(tmp_path):
    text = URDF.replace('name="b1" type="revolute"', 'name="b1" type="floating"')
    robot, angles = robot_of(text, tmp_path), angles_of(np.zeros(6))
    assert robot.relative_pose("base", "left", angles).shape == (1, 4, 4)
    for links, given_angles, message in (
        (("left", "right"), angles, "'b1' between the links is floating"),
        (("nose", "left"), {}, "no link 'nose'"),
        (("base", "left"), {}, "angles of joint 'a1' are missing"),
    ):
        with pytest.raises(InputError, match=message):
            robot.relative_pose(*links, given_angles)
