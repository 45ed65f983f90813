"""Forward kinematics of trees of rigid links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError

TURNING, SLIDING, FIXED = ("revolute", "continuous"), ("prismatic",), ("fixed",)
"""Types of joints that can be evaluated, as URDF names them."""


@dataclass(frozen=True, eq=False)
class Mimic:
    """A joint that follows another one: ``multiplier * angle + offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links.

    name, kind, parent, child: `kind` is the type in URDF; `parent` and `child` are links.
    origin (4, 4): Pose of the frame of the child in that of the parent at angle 0.
    axis (3,): Unit vector in the frame of the child.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: NDArray[np.float64]
    axis: NDArray[np.float64]
    mimic: Mimic | None = None


def transform(
    translation: ArrayLike = (0, 0, 0), roll_pitch_yaw: ArrayLike = (0, 0, 0)
) -> NDArray[np.float64]:
    """Return the homogeneous matrix, shape (4, 4), of rotations about the fixed x, y and z axes."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("xyz", np.asarray(roll_pitch_yaw)).as_matrix()
    found[:3, 3] = translation
    return found


class KinematicTree:
    """The links of a robot and the joints between them.

    Parameters
    ----------
    joints : tuple of Joint

    Raises
    ------
    InputError
        If a link has two parents, two joints have one name, or joints form a loop.
    """

    def __init__(self, joints: tuple[Joint, ...]) -> None:
        self.joints = joints
        self._above: dict[str, Joint] = {}
        self._joints: dict[str, Joint] = {}
        for joint in joints:
            if joint.child in self._above:
                raise InputError(f"link {joint.child!r} has two parents")
            if joint.name in self._joints:
                raise InputError(f"two joints have the name {joint.name!r}")
            self._above[joint.child] = self._joints[joint.name] = joint
        self._links = {link for joint in joints for link in (joint.parent, joint.child)}
        try:
            TopologicalSorter({joint.child: [joint.parent] for joint in joints}).prepare()
        except CycleError as error:
            raise InputError(f"the joints above link {error.args[1][0]!r} form a loop") from error

    def relative_pose(
        self, link: str, other: str, angles: Mapping[str, NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Compute the pose of a link in the frame of another one.

        Parameters
        ----------
        link : str
            The frame of the result.
        other : str
        angles : mapping of str to ndarray of shape (T,)
            Angles in radians, and displacements in metres, of the joints between them.

        Returns
        -------
        ndarray of shape (T, 4, 4)
            ``x_link = pose @ x_other``; T is 1 if all joints between the links are fixed.

        Raises
        ------
        InputError
            If a link is unknown, an angle is missing, or a joint between the links is neither
            fixed, revolute, continuous nor prismatic.
        """
        to_link, to_other = self._chain(link), self._chain(other)
        roots = {chain[0].parent if chain else name
                 for chain, name in ((to_link, link), (to_other, other))}  # fmt: skip
        if len(roots) > 1:
            raise InputError(f"no joints connect the links {link!r} and {other!r}")
        while to_link and to_other and to_link[0] is to_other[0]:
            to_link, to_other = to_link[1:], to_other[1:]
        return np.asarray(
            np.linalg.inv(self._along(to_link, angles)) @ self._along(to_other, angles)
        )

    def _chain(self, link: str) -> list[Joint]:
        """Return the joints above a link, from the top."""
        if link not in self._links:
            raise InputError(
                f"the robot has no link {link!r}; its links are {', '.join(sorted(self._links))}"
            )
        chain = []
        while link in self._above:
            chain.append(self._above[link])
            link = chain[-1].parent
        return chain[::-1]

    def _along(
        self, chain: list[Joint], angles: Mapping[str, NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        pose = np.eye(4)[None]
        for joint in chain:
            pose = pose @ joint.origin
            if joint.kind not in FIXED:
                pose = pose @ _motion(joint, self._angle(joint, angles))
        return pose

    def _angle(
        self, joint: Joint, angles: Mapping[str, NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        if joint.mimic is not None and joint.name not in angles:
            leader = self._joints.get(joint.mimic.joint)
            if leader is None or leader.mimic is not None:
                raise InputError(
                    f"joint {joint.name!r} mimics {joint.mimic.joint!r}, which is missing or "
                    "mimics another joint"
                )
            return joint.mimic.multiplier * self._angle(leader, angles) + joint.mimic.offset
        if joint.name not in angles:
            raise InputError(f"the angles of joint {joint.name!r} are missing")
        return np.asarray(angles[joint.name], dtype=np.float64)


def _motion(joint: Joint, angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motion of a joint, shape (T, 4, 4)."""
    found = np.tile(np.eye(4), (len(angle), 1, 1))
    along = angle[:, None] * joint.axis
    if joint.kind in TURNING:
        found[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
    elif joint.kind in SLIDING:
        found[:, :3, 3] = along
    else:
        raise InputError(
            f"joint {joint.name!r} between the links is {joint.kind}; only fixed, revolute, "
            "continuous and prismatic joints can be used"
        )
    return found
