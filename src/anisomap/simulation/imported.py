"""Bodies from meshes, MuJoCo models and positions of sensors.

Another process compiles MuJoCo models, within limits of memory and time: a few characters can
declare any number of elements (``replicate``) or values (``hfield``).
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.files.budget import Budget
from anisomap.files.meshes import read_mesh
from anisomap.files.paths import check_regular, open_regular
from anisomap.files.reader_process import opened
from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.ranges import COUNT
from anisomap.numerics.surfaces import estimate_normals
from anisomap.recording import default_names
from anisomap.simulation import solids
from anisomap.simulation.body import Body
from anisomap.simulation.physics.models import load_mujoco
from anisomap.simulation.solids import Points, Solid, spread

MESH_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")
MODEL_SUFFIXES = (".mjcf", ".xml")

TOLERANCE = 0.02
"""Maximum distance of a given sensor from the surface, as a fraction of the reach of the body."""

_SEED = 0
_MAX_BYTES = 1 << 26  # of a file that is searched for names of others
_NAMED = re.compile(rb"""\b(file|filename|meshdir|texturedir|assetdir)\s*=\s*(["'])(.+?)\2""")
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}  # of geoms of MuJoCo
_TRIANGLE_BYTES = 72  # of its corners
_MAX_GEOMS = 1000  # each is sampled and measured by itself: about 5 ms each
_MIN_LENGTH = 1e-100  # its cube is within the range of float64
_MIN_SHARE = 1e-9  # of a part in the extent of the body; `TriangleSearch` rounds distances to it
_MAX_BALL_RADIUS = 0.6  # x median spacing: adjacent balls overlap, so nothing passes between them
_MAX_NORMAL_ERROR = 45.0  # degrees between a given and an estimated normal
_MAX_CONTRADICTIONS = 0.1  # share of the sensors; not 0, since estimates can be wrong at edges


def load_body(
    path: str | Path, sensors: int | ArrayLike | None = None, names: Sequence[str] = ()
) -> Body:
    """Load a body from a mesh or a MuJoCo model.

    Parameters
    ----------
    path : str or pathlib.Path
        A closed mesh (`MESH_SUFFIXES`) or a model (`MODEL_SUFFIXES`).
    sensors : int or array_like of shape (N, 3), optional
        Number of sensors to spread evenly over the surface, or their positions. Defaults to the
        sites of a model; required for a mesh.
    names : sequence of str, optional
        Names of sensors with given positions.

    Returns
    -------
    Body
        In the length unit of the file: m for a model, unknown for a mesh.

    Raises
    ------
    FileError
        If the file cannot be read, has an unknown suffix, or defines no sensors.
    InputError
        If a sensor is not on the surface.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    check_regular(path)
    if suffix in MESH_SUFFIXES:
        if sensors is None:
            raise FileError(
                f"{path} is a mesh without sensors; give their number or a file with their "
                "positions (--sensors)"
            )
        vertices, faces = read_mesh(path)
        return body_from_mesh(vertices, faces, sensors, names=names, name=path.stem)
    if suffix in MODEL_SUFFIXES:
        return body_from_mjcf(path, sensors, names)
    raise FileError(
        f"{path} is not a body: a mesh ends in {', '.join(MESH_SUFFIXES)}, "
        f"a MuJoCo model in {' or '.join(MODEL_SUFFIXES)}"
    )


def body_from_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    sensors: int | ArrayLike,
    *,
    names: Sequence[str] = (),
    name: str = "mesh",
    units: str = "",
) -> Body:
    """Make a body from a closed mesh.

    Parameters
    ----------
    vertices : array_like of shape (V, 3)
    faces : array_like of int, shape (F, 3)
    sensors : int or array_like of shape (N, 3)
        Number of sensors to spread evenly over the surface, or positions at most `TOLERANCE` x
        reach from the surface, onto which they are projected.
    names : sequence of str, optional
        Names of the sensors.
    name : str
    units : str
        Unit of the lengths, if known.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If the mesh is not closed or has no area, or a sensor is not on its surface.
    """
    return _with_sensors(name, [solids.mesh(vertices, faces)], sensors, names, units)


def body_from_mjcf(
    path: Path, sensors: int | ArrayLike | None = None, names: Sequence[str] = ()
) -> Body:
    """Make a body from the geoms of a MuJoCo model in its initial pose.

    Parameters
    ----------
    path : pathlib.Path
    sensors : int or array_like of shape (N, 3), optional
        See `load_body`. Defaults to the sites of the model.
    names : sequence of str, optional
        Names of sensors with given positions.

    Returns
    -------
    Body
        Planes, height fields and geoms that do not collide are left out (if no geom collides, all
        are kept). A mesh that is not closed is replaced by its convex hull, as MuJoCo does with all
        meshes.

    Raises
    ------
    FileError
        If MuJoCo cannot read the model, or it has no geoms, or no sites and no sensors are given.
    """
    with opened(_read_model, path) as answers:
        found = next(answers)
    if len(found["kinds"]) > _MAX_GEOMS:
        raise FileError(
            f"{path} has {len(found['kinds']):,} geoms, more than {_MAX_GEOMS:,}: give the surface "
            "as a mesh, or turn off collisions of geoms that are not the skin (contype and "
            "conaffinity 0)"
        )
    lengths = [found[name] for name in ("sizes", "centres", "rotations")]
    for values in (*lengths, *(vertices for vertices, _ in found["meshes"])):
        if not np.abs(values.astype(np.float64)).max(initial=0) < solids.MAX_LENGTH:
            raise FileError(f"{path} holds coordinates that are not finite or out of range")
    shown = [found["meshes"][i] for i in found["shown"] if i >= 0]
    n_bytes = _TRIANGLE_BYTES * sum(len(faces) for _, faces in shown)
    Budget(path).check(n_bytes, "the surface of its meshes")
    meshes = [_solid_from_mesh(*mesh) for mesh in found["meshes"]]
    parts = []
    for kind, label, i, size, centre, rotation in zip(
        found["kinds"], found["labels"], found["shown"], *lengths, strict=True
    ):
        if kind != "mesh" and kind not in _SIZES:
            raise InputError(
                f"geom {label} must be a sphere, capsule, cylinder, box, ellipsoid or mesh"
            )
        solid = meshes[i] if kind == "mesh" else Solid(kind, tuple(size[: _SIZES[kind]].tolist()))
        parts.append(solid.moved(rotation.reshape(3, 3), centre))
    if not parts:
        raise FileError(f"{path} has no geoms for sensors")
    if sensors is None:
        if not found["names"]:
            raise FileError(
                f"{path} has no sites to use as sensors; add sites or give the number of sensors "
                "(--sensors)"
            )
        sensors, names = found["sites"], found["names"]
    return _with_sensors(path.stem, parts, sensors, names, "m")


def _read_model(path: Path) -> Iterator[dict[str, Any]]:
    """Yield geoms and sites in the initial pose; this runs in the process for readers."""
    _check_named_files(path)
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_path(os.fspath(path))
    except (ValueError, mujoco.FatalError) as error:
        first = str(error).strip().splitlines()[0]
        raise FileError(f"MuJoCo cannot read {path}: {first}") from error
    except RuntimeError as error:  # of the memory that it was refused
        raise MemoryError from error
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    kinds = [mujoco.mjtGeom(int(kind)).name.removeprefix("mjGEOM_") for kind in model.geom_type]
    solid = np.array([kind not in ("PLANE", "HFIELD") for kind in kinds], dtype=bool)
    colliding = solid & ((model.geom_contype | model.geom_conaffinity) != 0)
    used = np.flatnonzero(colliding if colliding.any() else solid)
    assets = [int(model.geom_dataid[i]) if kinds[i] == "MESH" else -1 for i in used]
    meshes = sorted({*assets} - {-1})
    yield {
        "kinds": [kinds[i].lower() for i in used],
        "labels": [model.geom(i).name or int(i) for i in used],
        "shown": [meshes.index(asset) if asset >= 0 else -1 for asset in assets],
        "sizes": model.geom_size[used],
        "centres": data.geom_xpos[used],
        "rotations": data.geom_xmat[used],
        "meshes": [
            (
                model.mesh_vert[model.mesh_vertadr[i] :][: model.mesh_vertnum[i]],
                model.mesh_face[model.mesh_faceadr[i] :][: model.mesh_facenum[i]],
            )
            for i in meshes
        ],
        "sites": np.array(data.site_xpos),
        "names": [model.site(i).name or f"site{i}" for i in range(model.nsite)],
    }


def _check_named_files(path: Path) -> None:
    """Check that a model names regular files only; MuJoCo would wait for pipes."""
    folders, files = [path.parent], [path]
    for file in files:
        with open_regular(file) as stream:
            named = _NAMED.findall(stream.read(_MAX_BYTES))
        folders += [path.parent / os.fsdecode(name) for kind, _, name in named if b"dir" in kind]
        names = {os.fsdecode(name) for kind, _, name in named if b"dir" not in kind}
        candidates = sorted({folder / name for folder in folders for name in names})
        files += [one for one in candidates if one not in files and one.exists()]


def body_from_points(
    positions: ArrayLike,
    normals: ArrayLike | None = None,
    *,
    names: Sequence[str] = (),
    name: str = "points",
    units: str = "",
) -> Body:
    """Make a body from the positions of sensors alone.

    Parameters
    ----------
    positions : array_like of shape (N, 3)
        At least 4 sensors.
    normals : array_like of shape (N, 3), optional
        Outward normals. By default, and with a warning if they contradict the positions, they are
        estimated from nearby sensors.
    names : sequence of str, optional
        Names of the sensors.
    name, units : str

    Returns
    -------
    Body
        A union of balls, each of which touches the surface at one sensor from below. Where the
        skin is not concave they overlap, and approximate the unknown surface.

    Raises
    ------
    InputError
        If there are fewer than 4 sensors, they are not 3D, or two have the same position.

    Warns
    -----
    AnisomapWarning
        If normals are given and contradict the positions.
    """
    places = np.asarray(positions, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) < 4:
        raise InputError(f"positions must have shape (N, 3) with N at least 4, got {places.shape}")
    spacing = nearest_distances(places)
    if spacing.min() <= 0:
        # Distances, as the difference of two positions may be too small for its square.
        distances = np.linalg.norm(places - places[int(spacing.argmin())], axis=1)
        first, second = np.argsort(distances, kind="stable")[:2]
        raise InputError(f"positions must be distinct; sensors {first} and {second} coincide")
    outward, _ = estimate_normals(places)
    if normals is not None:
        given = np.asarray(normals, dtype=np.float64)
        agreement = np.abs(np.einsum("nd,nd->n", given, outward))
        contradicting = float(np.mean(agreement < np.cos(np.radians(_MAX_NORMAL_ERROR))))
        if contradicting <= _MAX_CONTRADICTIONS:
            outward = given / np.linalg.norm(given, axis=1, keepdims=True)
        else:
            warnings.warn(
                f"the normals of {name} contradict its sensor positions and are replaced by "
                f"estimates ({contradicting:.0%} are off by more than {_MAX_NORMAL_ERROR:g} "
                "degrees)",
                AnisomapWarning,
                stacklevel=2,
            )
    origin = (places.min(axis=0) + places.max(axis=0)) / 2
    centred = places - origin
    largest = _MAX_BALL_RADIUS * float(np.median(spacing))
    balls = []
    for at, normal in zip(centred, outward, strict=True):
        # The largest ball below the sensor without other sensors.
        others = centred - at
        others = others[others @ normal < 0]
        touching = np.einsum("nd,nd->n", others, others) / (-2 * (others @ normal))
        radius = float(min(largest, touching.min(initial=np.inf)))
        balls.append(solids.ball(radius, at - radius * normal))
    named = tuple(names)
    return Body(
        name, centred, outward, balls, names=named, units=units, origin=origin, is_whole=False
    )


def _with_sensors(
    name: str,
    parts: Sequence[Solid],
    sensors: int | ArrayLike,
    names: Sequence[str],
    units: str,
) -> Body:
    """Centre solids at the origin and add sensors."""
    corners = np.vstack([part.outline.vertices for part in parts])
    # Products of three lengths neither overflow nor underflow, nor do sums round parts.
    extent = np.ptp(corners, axis=0).max()
    if not (np.abs(corners).max() < solids.MAX_LENGTH and extent > _MIN_LENGTH):
        raise InputError(
            f"the size of the body {name} is out of range; check its coordinates and unit"
        )
    least = min(float(np.ptp(part.outline.vertices, axis=0).max()) for part in parts)
    if least < _MIN_SHARE * extent:
        raise InputError(
            f"the body {name} has an extent of {extent:.4g}, and a part of {least:.4g}, too small "
            "to be resolved beside it; check its coordinates"
        )
    origin = (corners.min(axis=0) + corners.max(axis=0)) / 2
    centred = [part.moved(np.eye(3), -origin) for part in parts]
    if isinstance(sensors, int | np.integer):
        COUNT.check("sensors", int(sensors))
        positions, normals = spread(centred, int(sensors), np.random.default_rng(_SEED))
    else:
        places = np.asarray(sensors, dtype=np.float64)
        if places.ndim != 2 or places.shape[1] != 3 or not len(places):
            raise InputError(f"sensors must have shape (N, 3), got {places.shape}")
        if not (np.abs(places) < solids.MAX_LENGTH).all():
            raise InputError(
                f"the sensors of {name} have positions that are not finite or out of range; check "
                "their coordinates and unit"
            )
        positions = places - origin
        distances = np.abs(solids.union_distance(centred, positions))
        allowed = TOLERANCE * max(part.reach for part in centred)
        if not distances.max() <= allowed:
            worst = int(distances.argmax())
            label = (tuple(names) or default_names(len(positions)))[worst]
            raise InputError(
                f"sensor {label} is {distances[worst]:.4g}{units and ' ' + units} off the surface "
                f"of {name}, and {int((distances > allowed).sum())} sensors are more than "
                f"{allowed:.4g} off; check that they use the frame and unit of the body"
            )
        positions = solids.project(centred, positions)
        normals = solids.surface_normals(centred, positions)
    return Body(name, positions, normals, centred, names=tuple(names), units=units, origin=origin)


def _solid_from_mesh(vertices: Points, faces: NDArray[np.intp]) -> Solid:
    try:
        return solids.mesh(vertices, faces)
    except InputError:
        return solids.mesh(vertices, ConvexHull(vertices).simplices)
