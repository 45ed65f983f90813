"""Bodies that users bring: meshes, MuJoCo models, and bare positions of sensors."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.numerics.normals import estimate_normals
from anisomap.recording import default_names
from anisomap.simulation.bodies.body import Body, nearest_neighbours
from anisomap.simulation.checks import check_count
from anisomap.simulation.engine import load_mujoco
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Points, Solid
from anisomap.simulation.geometry.spreading import spread

MESH_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")
MODEL_SUFFIXES = (".mjcf", ".xml")

TOLERANCE = 0.02
"""How far off the surface a given sensor may be, as a share of the body's reach."""

_SEED = 0
_PEBBLE = 0.6  # of the spacing: neighbouring pebbles overlap, so that nothing slips between them
_DISAGREE = 45.0  # degrees
_CONTRADICTIONS = 0.1  # of the sensors; on an edge an estimate can be wrong


def load_body(
    path: Path, sensors: int | ArrayLike | None = None, names: Sequence[str] = ()
) -> Body:
    """Load a body from a mesh or a MuJoCo model.

    Parameters
    ----------
    path : pathlib.Path
        A closed mesh (`MESH_SUFFIXES`) or a model (`MODEL_SUFFIXES`).
    sensors : int or array_like of shape (N, 3), optional
        How many sensors to spread evenly over the surface, or where they are. A model's sites
        unless given; a mesh has none of its own.
    names : sequence of str, optional
        Of sensors whose places are given.

    Returns
    -------
    Body
        Its lengths are in the unit of the file: metres in a model, unknown in a mesh.

    Raises
    ------
    FileError
        If the file cannot be read, is of another kind, or holds no body with sensors.
    InputError
        If a sensor is off the surface.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise FileError(f"there is no file {path}")
    if suffix in MESH_SUFFIXES:
        if sensors is None:
            raise FileError(
                f"{path} is a mesh and names no sensors: say how many to spread over it, or give "
                "a file with their positions (--sensors)"
            )
        vertices, faces = _read_mesh(path)
        return body_from_mesh(vertices, faces, sensors, names=names, name=path.stem)
    if suffix in MODEL_SUFFIXES:
        return body_from_mjcf(path, sensors, names)
    raise FileError(
        f"{path} is no body: a mesh ends in {', '.join(MESH_SUFFIXES)}, "
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
    """Make a body of a closed mesh.

    Parameters
    ----------
    vertices : array_like of shape (V, 3)
    faces : array_like of int, shape (F, 3)
    sensors : int or array_like of shape (N, 3)
        How many to spread evenly over the surface, or where they are: on the surface, or off it by
        at most `TOLERANCE`.
    names : sequence of str, optional
    name : str
    units : str
        Unit of the lengths, if known.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If the mesh is not closed or has no area, or a sensor is off its surface.
    """
    return _equipped(name, [solids.mesh(vertices, faces)], sensors, names, units)


def body_from_mjcf(
    path: Path, sensors: int | ArrayLike | None = None, names: Sequence[str] = ()
) -> Body:
    """Make a body of the geoms of a MuJoCo model, as it stands in its initial posture.

    Parameters
    ----------
    path : pathlib.Path
    sensors : int or array_like of shape (N, 3), optional
        See `load_body`; the model's sites unless given.
    names : sequence of str, optional

    Returns
    -------
    Body
        Planes and height fields are the scenery and left out, and so is what collides with nothing
        (unless nothing collides). A mesh that is not closed is taken for its convex hull, which is
        what MuJoCo takes any mesh for.

    Raises
    ------
    FileError
        If MuJoCo cannot read the model, or it has no geoms or, with no other sensors, no sites.
    """
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        first = str(error).strip().splitlines()[0]
        raise FileError(f"MuJoCo cannot read {path}: {first}") from error
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scenery = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
    solid_geoms = [i for i in range(model.ngeom) if int(model.geom_type[i]) not in scenery]
    touching = [i for i in solid_geoms if model.geom_contype[i] or model.geom_conaffinity[i]]
    parts = [_solid_of_geom(mujoco, model, data, i) for i in touching or solid_geoms]
    if not parts:
        raise FileError(f"{path} has no geoms that sensors could stand on")
    if sensors is None:
        if not model.nsite:
            raise FileError(
                f"{path} has no sites, which would be its sensors; add some, or say how many "
                "sensors to spread over it (--sensors)"
            )
        sensors = np.array(data.site_xpos)
        names = [model.site(i).name or f"site{i}" for i in range(model.nsite)]
    return _equipped(path.stem, parts, sensors, names, "m")


def body_from_points(
    positions: ArrayLike,
    normals: ArrayLike | None = None,
    *,
    names: Sequence[str] = (),
    name: str = "points",
    units: str = "",
) -> Body:
    """Make a body under sensors of which only the places are known.

    Parameters
    ----------
    positions : array_like of shape (N, 3)
        At least 4 sensors.
    normals : array_like of shape (N, 3), optional
        Which way is out of the skin; estimated from the sensors around each unless given. Normals
        that contradict the positions are warned of, and not used.
    names : sequence of str, optional
    name, units : str

    Returns
    -------
    Body
        Under each sensor lies a ball that touches the surface there and, where the skin is not
        bent inwards, overlaps its neighbours: a pebbled skin, from which things bounce off much as
        from the true one.

    Raises
    ------
    InputError
        If there are too few sensors, two are at one place, or they are not points in space.
    """
    places = np.asarray(positions, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) < 4:
        raise InputError(
            f"positions have shape {places.shape}; a body needs at least 4 sensors in space"
        )
    apart = nearest_neighbours(places, 1)[0]
    if apart.min() <= 0:
        here = places[int(apart.argmin())]
        first, second = np.flatnonzero((places == here).all(axis=1))[:2]
        raise InputError(f"sensors {first} and {second} are at one place")
    outward, _ = estimate_normals(places)
    if normals is not None:
        given = np.asarray(normals, dtype=np.float64)
        agreement = np.abs(np.einsum("nd,nd->n", given, outward))
        contradicting = float(np.mean(agreement < np.cos(np.radians(_DISAGREE))))
        if contradicting <= _CONTRADICTIONS:
            outward = given / np.linalg.norm(given, axis=1, keepdims=True)
        else:
            warnings.warn(
                f"the normals of {name} contradict the places of its sensors ({contradicting:.0%} "
                f"are more than {_DISAGREE:g} degrees off); they are estimated instead",
                AnisomapWarning,
                stacklevel=2,
            )
    origin = (places.min(axis=0) + places.max(axis=0)) / 2
    centred = places - origin
    widest = _PEBBLE * float(np.median(apart))
    radii = np.array(
        [_largest_ball(centred - at, out, widest) for at, out in zip(centred, outward, strict=True)]
    )
    pebbles = [
        solids.ball(radius, centre)
        for radius, centre in zip(radii, centred - radii[:, None] * outward, strict=True)
    ]
    return Body(
        name,
        centred,
        outward,
        pebbles,
        names=tuple(names),
        units=units,
        origin=origin,
        is_whole=False,
    )


def _largest_ball(others: Points, outward: Points, widest: float) -> float:
    """Find the radius of the largest ball below a sensor in the origin that holds no other."""
    below = others @ outward < 0
    squared = np.einsum("nd,nd->n", others[below], others[below])
    touching = squared / (-2 * (others[below] @ outward))
    return float(min(widest, touching.min(initial=np.inf)))


def _equipped(
    name: str,
    parts: Sequence[Solid],
    sensors: int | ArrayLike,
    names: Sequence[str],
    units: str,
) -> Body:
    """Shift solids to the origin, and put sensors on them."""
    corners = np.vstack([part.outline.vertices for part in parts])
    origin = (corners.min(axis=0) + corners.max(axis=0)) / 2
    centred = [part.moved(np.eye(3), -origin) for part in parts]
    if isinstance(sensors, int | np.integer):
        check_count("sensors", int(sensors))
        positions, normals = spread(centred, int(sensors), np.random.default_rng(_SEED))
    else:
        places = np.asarray(sensors, dtype=np.float64)
        if places.ndim != 2 or places.shape[1] != 3 or not len(places):
            raise InputError(
                f"sensors have shape {places.shape}; they must be points in space, shape (N, 3)"
            )
        positions = places - origin
        _check_near_surface(name, centred, positions, names, units)
        positions = solids.projected(centred, positions)
        normals = solids.outward(centred, positions)
    return Body(name, positions, normals, centred, names=tuple(names), units=units, origin=origin)


def _check_near_surface(
    name: str, parts: Sequence[Solid], positions: Points, names: Sequence[str], units: str
) -> None:
    off = np.abs(solids.distance_to_all(parts, positions))
    allowed = TOLERANCE * max(part.reach for part in parts)
    if not off.max() <= allowed:
        worst = int(off.argmax())
        label = (tuple(names) or default_names(len(positions)))[worst]
        raise InputError(
            f"sensor {label} is {off[worst]:.4g}{units and ' ' + units} off the surface of "
            f"{name}, and {int((off > allowed).sum())} sensors are more than {allowed:.4g} off; "
            "are they in the frame and unit of the body?"
        )


def _read_mesh(path: Path) -> tuple[Points, NDArray[np.intp]]:
    trimesh = solids.load_trimesh()
    try:
        loaded = trimesh.load_mesh(path)
        return np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces)
    except Exception as error:
        # What a damaged mesh raises depends on its format and on the library's version.
        raise FileError(f"{path} cannot be read as a mesh: {error}") from error


def _solid_of_geom(mujoco: Any, model: Any, data: Any, i: int) -> Solid:
    kinds = {
        int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
        int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", 2),
        int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
        int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    }
    rotation, centre = data.geom_xmat[i].reshape(3, 3), data.geom_xpos[i]
    kind = int(model.geom_type[i])
    if kind in kinds:
        word, n_sizes = kinds[kind]
        size = tuple(float(length) for length in model.geom_size[i][:n_sizes])
        return Solid(word, size).moved(rotation, centre)
    if kind == int(mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        round_one = solids.ball(1.0).outline
        return solids.mesh(round_one.vertices * model.geom_size[i], round_one.faces).moved(
            rotation, centre
        )
    if kind != int(mujoco.mjtGeom.mjGEOM_MESH):
        raise InputError(
            f"geom {model.geom(i).name or i} is of a kind that sensors cannot stand on; a body "
            "is made of spheres, capsules, cylinders, boxes, ellipsoids and meshes"
        )
    shape = model.mesh(model.geom_dataid[i])
    first, count = int(shape.vertadr[0]), int(shape.vertnum[0])
    vertices = np.array(model.mesh_vert[first : first + count])
    first, count = int(shape.faceadr[0]), int(shape.facenum[0])
    faces = np.array(model.mesh_face[first : first + count])
    try:
        return solids.mesh(vertices, faces).moved(rotation, centre)
    except InputError:
        return solids.mesh(vertices, ConvexHull(vertices).simplices).moved(rotation, centre)
