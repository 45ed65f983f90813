"""Accuracy of patches that are placed by self-touch (``python -m benchmarks.placing.self_touch``).

A robot of two arms, of three joints each, carries a patch of 60 taxels on the last link of each
arm, and touches one with the other in random postures. Taxels are 6 mm apart. Readings have noise,
joint angles errors of 0.1 degrees, and in some frames something else touches the patch.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import special_ortho_group

from anisomap import Recording, SensorMap, reconstruct
from anisomap.errors import InputError
from anisomap.io import read_robot
from anisomap.placement import SelfTouch, place_by_self_touch
from anisomap.placement.kinematics import KinematicTree
from benchmarks.harness import options, write_csv

SEEDS = tuple(range(401, 421))
"""Tuned on seeds 1 to 20."""

CONTACTS = (10, 30, 100)
HEADER = (
    "patch", "taxel positions", "contacts", "median error (mm)", "in spacings",
    "worst median (mm)", "within error (%)", "refused",
)  # fmt: skip
SPACING = 0.006
ROWS, COLUMNS = 6, 10
JOINTS = ("a1", "a2", "a3", "b1", "b2", "b3")
_REACH = 2.0  # spacings from the centre of a contact to the last taxel that feels it
RADII = {"flat": np.inf, "curved": 0.03}  # of patch A, in metres; patch B is a ball's part
_BALL = 0.05
_JOINT_NOISE = np.radians(0.1)
_READING_NOISE = 0.02  # of the range
_ASTRAY = 0.1  # share of the contacts during which something else touches patch A elsewhere

URDF = """<?xml version="1.0"?>
<robot name="two_arms">
<link name="base"/><link name="l1"/><link name="l2"/><link name="left"/>
<link name="r1"/><link name="r2"/><link name="right"/>
<joint name="a1" type="revolute"><parent link="base"/><child link="l1"/>
<origin xyz="0 0.12 0.3"/><axis xyz="0 0 1"/></joint>
<joint name="a2" type="revolute"><parent link="l1"/><child link="l2"/>
<origin xyz="0.05 0 0.02" rpy="0.2 0 0.1"/><axis xyz="0 1 0"/></joint>
<joint name="a3" type="continuous"><parent link="l2"/><child link="left"/>
<origin xyz="0.15 0 0" rpy="0 0.3 0"/><axis xyz="1 0 0"/></joint>
<joint name="b1" type="revolute"><parent link="base"/><child link="r1"/>
<origin xyz="0 -0.12 0.3"/><axis xyz="0 0 1"/></joint>
<joint name="b2" type="revolute"><parent link="r1"/><child link="r2"/>
<origin xyz="0.05 0 -0.02" rpy="-0.1 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="b3" type="prismatic"><parent link="r2"/><child link="right"/>
<origin xyz="0.12 0 0" rpy="0 0 0.4"/><axis xyz="1 0 0"/></joint>
</robot>
"""


@dataclass(frozen=True, eq=False)
class Patch:
    """Taxels on a surface, in its own frame: a lattice in the plane, bent to it.

    flat (N, 2): In metres along the surface.
    radii: Of curvature, along both coordinates.
    """

    flat: NDArray[np.float64]
    radii: tuple[float, float]

    def surface(self, flat: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return points of the surface and its outward normals, shapes (n, 3)."""
        first, second = (flat[:, i] / radius for i, radius in enumerate(self.radii))
        normals = np.column_stack(
            [np.sin(first) * np.cos(second), np.sin(second), np.cos(first) * np.cos(second)]
        )
        if np.isinf(self.radii).all():
            return np.column_stack([flat, np.zeros(len(flat))]), normals
        if np.isinf(self.radii[1]):
            points = self.radii[0] * (normals - [0, 0, 1])
            points[:, 1] = flat[:, 1]
            return points, normals
        return self.radii[0] * (normals - [0, 0, 1]), normals

    @property
    def positions(self) -> NDArray[np.float64]:
        """Taxels, shape (N, 3)."""
        return self.surface(self.flat)[0]

    def readings(
        self, touched: NDArray[np.float64], force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the readings under contacts at points of the surface, shape (T, N)."""
        points = self.surface(touched)[0]
        distances = np.linalg.norm(points[:, None] - self.positions, axis=2) / SPACING
        return np.asarray(np.maximum(0, _REACH - distances) * force[:, None])


@dataclass(frozen=True, eq=False)
class Scene:
    """A recording of self-touch, and the truth.

    shape: Taxels of patch A in a frame of their own, in metres.
    truth (N, 3): The same in the frame of link ``left``.
    other: Taxels of patch B in the frame of link ``right``, with normals.
    rubbing: Of patch A alone, to map it.
    """

    touches: SelfTouch
    shape: SensorMap
    truth: NDArray[np.float64]
    other: SensorMap
    rubbing: Recording


def lattice() -> NDArray[np.float64]:
    """Return a triangular lattice around 0, shape (60, 2), in metres."""
    x, y = np.meshgrid(np.arange(COLUMNS, dtype=float), np.arange(ROWS, dtype=float))
    x[1::2] += 0.5
    found = SPACING * np.column_stack([x.ravel(), y.ravel() * 3**0.5 / 2])
    return np.asarray(found - found.mean(axis=0))


def simulate(robot: KinematicTree, seed: int, n_contacts: int, form: str = "curved") -> Scene:
    """Simulate self-touch in random postures; see the module."""
    rng = np.random.default_rng(seed)
    flat = lattice()
    patch = Patch(flat, (RADII[form], np.inf))
    ball = Patch(flat, (_BALL, _BALL))
    mounts = [_mount(rng, offset) for offset in ([0.05, 0.0, 0.03], [0.04, 0.01, 0.03])]
    angles, places = _postures(robot, rng, (patch, ball), mounts, n_contacts)
    force = rng.uniform(0.5, 1.5, n_contacts)
    readings = []
    for part, where in zip((patch, ball), places, strict=True):
        felt = part.readings(where, force)
        if part is patch:
            astray = rng.random(n_contacts) < _ASTRAY
            elsewhere = flat[rng.integers(0, len(flat), n_contacts)]
            felt[astray] = part.readings(elsewhere, force)[astray]
        readings.append(felt)
    both = np.hstack(readings)
    pause = np.zeros((n_contacts, both.shape[1]))  # each contact is followed by a frame without
    frames = np.stack([both, pause], axis=1).reshape(-1, both.shape[1])
    frames += rng.normal(0, _READING_NOISE * both.max(), frames.shape)
    names = tuple([f"a{i}" for i in range(len(flat))] + [f"b{i}" for i in range(len(flat))])
    measured = np.repeat(angles + rng.normal(0, _JOINT_NOISE, angles.shape), 2, axis=0)
    own, other = patch.positions, ball.positions @ mounts[1][:3, :3].T + mounts[1][:3, 3]
    normals = ball.surface(flat)[1] @ mounts[1][:3, :3].T
    low, high = flat.min(axis=0) - SPACING, flat.max(axis=0) + SPACING
    walk = low + np.abs(np.cumsum(rng.normal(0, 0.6 * SPACING, (1500, 2)), axis=0)
                        % (2 * (high - low)) - (high - low))  # fmt: skip
    rubbing = patch.readings(walk, rng.uniform(0.6, 1.4, len(walk)))
    return Scene(
        SelfTouch(
            Recording(frames, names=names),
            robot,
            dict(zip(JOINTS, measured.T, strict=True)),
            "left",
            "right",
        ),
        SensorMap(
            own @ special_ortho_group.rvs(3, random_state=rng).T, names=names[:60], units="m"
        ),
        own @ mounts[0][:3, :3].T + mounts[0][:3, 3],
        SensorMap(other, names=names[60:], units="m", frame="right", normals=normals),
        Recording(rubbing, names=names[:60]),
    )


def _mount(rng: np.random.Generator, offset: list[float]) -> NDArray[np.float64]:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix()
    found[:3, 3] = np.array(offset) + rng.normal(0, 0.01, 3)
    return found


def _postures(
    robot: KinematicTree,
    rng: np.random.Generator,
    patches: tuple[Patch, Patch],
    mounts: list[NDArray[np.float64]],
    count: int,
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Return angles at which random points of the patches touch, and these points.

    Damped Gauss-Newton steps from random angles; those that reach no contact are drawn again.
    """
    angles, places = np.empty((0, 6)), [np.empty((0, 2)) for _ in patches]
    low, high = patches[0].flat.min(axis=0), patches[0].flat.max(axis=0)
    while len(angles) < count:
        n = 4 * count
        where = [rng.uniform(low, high, (n, 2)) for _ in patches]
        mounted = []
        for patch, mount, place in zip(patches, mounts, where, strict=True):
            points, normals = patch.surface(place)
            mounted.append((points @ mount[:3, :3].T + mount[:3, 3], normals @ mount[:3, :3].T))
        x = rng.uniform(-1.5, 1.5, (n, 6))
        x[:, 5] *= 0.05  # in metres
        for _ in range(60):
            value = _gaps(robot, x, mounted)
            slopes = np.stack(
                [(_gaps(robot, x + 1e-6 * e, mounted) - value) / 1e-6 for e in np.eye(6)], axis=2
            )
            normal = np.einsum("nki,nkj->nij", slopes, slopes) + 1e-4 * np.eye(6)
            step = np.linalg.solve(normal, np.einsum("nki,nk->ni", slopes, value)[..., None])
            x = x - np.clip(step[..., 0], -0.3, 0.3)
        met = np.flatnonzero(np.abs(_gaps(robot, x, mounted)).max(axis=1) < 1e-6)
        angles = np.vstack([angles, x[met]])
        places = [np.vstack([old, new[met]]) for old, new in zip(places, where, strict=True)]
    return angles[:count], [old[:count] for old in places]


def _gaps(
    robot: KinematicTree,
    x: NDArray[np.float64],
    mounted: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> NDArray[np.float64]:
    """Return distances between points, in 10 cm, and sums of their normals, shape (n, 6)."""
    (p, m), (q, o) = mounted
    pose = robot.relative_pose("left", "right", dict(zip(JOINTS, x.T, strict=True)))
    reached = np.einsum("nij,nj->ni", pose[:, :3, :3], q) + pose[:, :3, 3]
    against = np.einsum("nij,nj->ni", pose[:, :3, :3], o)
    return np.hstack([10 * (reached - p), m + against])


@dataclass(frozen=True)
class Result:
    """Errors over seeds of one kind of placement.

    `refused` counts recordings that were not placed; errors are those of the others.
    """

    patch: str
    positions: str
    contacts: int
    median_mm: float
    median_spacings: float
    worst_mm: float
    within_percent: int
    refused: int


def measure(form: str, exact: bool, contacts: int, seeds: tuple[int, ...]) -> Result:
    """Place patches of several seeds, with their taxel positions or a map made by rubbing."""
    errors, within, refused = [], [], 0
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(URDF)
            robot = read_robot(file)
        scene = simulate(robot, seed, contacts, form)
        known = scene.shape if exact else reconstruct(scene.rubbing, dimensions=2)
        try:
            found = place_by_self_touch(known, scene.touches, scene.other, exact=exact).map
        except InputError:
            refused += 1
            continue
        placed = found.placed  # rubbing may miss a taxel at the edge
        off = np.linalg.norm(found.positions - scene.truth, axis=1)[placed]
        errors.append(float(np.median(off)))
        within.append(float(np.mean(off <= found.errors[placed])))
    median = float(np.median(errors)) if errors else np.nan
    return Result(
        patch=form,
        positions="known" if exact else "from a map",
        contacts=contacts,
        median_mm=round(1e3 * median, 2),
        median_spacings=round(median / SPACING, 3),
        worst_mm=round(1e3 * max(errors, default=np.nan), 2),
        within_percent=round(100 * float(np.mean(within))) if within else 0,
        refused=refused,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the table."""
    parser = options(__doc__, "self-touch.csv", seeds=len(SEEDS), recordings=False)
    parser.add_argument("--contacts", type=int, nargs="*", default=list(CONTACTS))
    chosen = parser.parse_args(arguments)
    results = []
    for form, exact, contacts in itertools.product(RADII, (True, False), chosen.contacts):
        results.append(measure(form, exact, contacts, SEEDS[: chosen.seeds]))
        print(results[-1], flush=True)
        write_csv(chosen.output, HEADER, map(astuple, results))


if __name__ == "__main__":
    main()
