"""Options of ``anisomap place --self-touch``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from anisomap import io
from anisomap.errors import InputError
from anisomap.numerics.kinematics import TURNING, KinematicTree
from anisomap.placement import SelfTouch, TouchPlacement, place_by_self_touch
from anisomap.sensor_map import SensorMap


@dataclass(frozen=True)
class SelfTouchOptions:
    """Contacts of the patch with another patch of the robot, whose positions are known.

    Parameters
    ----------
    self_touch
        Recording of the sensors of both patches, while they touch each other in many postures.
    urdf
        Kinematics of the robot.
    joints
        Angles of the joints: a file with a column per joint and a row per frame of the recording.
        In radians, and metres for prismatic joints.
    degrees
        Angles are in degrees.
    link
        Link of the patch that is placed.
    other
        Layout of the other patch, in the frame of its link.
    other_link
        Link of the other patch.
    exact
        The map holds the positions of the sensors in a frame of their own, with a unit; only its
        pose is fitted.
    """

    self_touch: Path | None = None
    urdf: Path | None = None
    joints: Path | None = None
    degrees: Annotated[bool, Parameter(negative=())] = False
    link: str = ""
    other: Path | None = None
    other_link: str = ""
    exact: Annotated[bool, Parameter(negative=())] = False

    @property
    def files(self) -> list[Path]:
        """Files that are read."""
        given = (self.self_touch, self.urdf, self.joints, self.other)
        return [path for path in given if path is not None]

    def check(self, *, alone: bool) -> bool:
        """Return whether a map is to be placed by self-touch.

        Parameters
        ----------
        alone : bool
            Whether nothing else is given that places the map.

        Raises
        ------
        InputError
            If an option is missing, or contradicts another one.
        """
        required = {
            "--self-touch": self.self_touch,
            "--urdf": self.urdf,
            "--joints": self.joints,
            "--link": self.link,
            "--other": self.other,
            "--other-link": self.other_link,
        }
        missing = [name for name, value in required.items() if not value]
        if len(missing) == len(required) and not (self.exact or self.degrees):
            return False
        if missing:
            raise InputError(f"to place a map by self-touch, give {', '.join(missing)} as well")
        if not alone:
            raise InputError(
                "a map is placed by self-touch alone; leave out anchors, modules, --mesh and "
                "--spacing"
            )
        return True

    def place(self, sensor_map: SensorMap, handedness: str) -> TouchPlacement:
        """Read the files and place a map; `check` must have returned True."""
        recording, robot, joints, other = self.files
        tree = io.read_robot(robot)
        touches = SelfTouch(
            recording=io.read(recording).complete("error"),
            robot=tree,
            angles=self._angles(joints, tree),
            link=self.link,
            other_link=self.other_link,
        )
        return place_by_self_touch(
            sensor_map, touches, io.read_map(other), exact=self.exact, handedness=handedness
        )

    def _angles(self, path: Path, robot: KinematicTree) -> dict[str, np.ndarray]:
        table = io.read(path).complete("error")
        found = {
            name: np.asarray(column, dtype=np.float64)
            for name, column in zip(table.names, table.readings.T, strict=True)
        }
        if self.degrees:
            turning = {joint.name for joint in robot.joints if joint.kind in TURNING}
            found |= {name: np.radians(found[name]) for name in turning & found.keys()}
        return found


NO_SELF_TOUCH = SelfTouchOptions()
