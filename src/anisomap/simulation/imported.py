"""Bodies from meshes, MuJoCo models and positions of sensors.

What a MuJoCo model declares is checked before MuJoCo allocates it: a few characters can declare any
number of elements (``replicate``) or values (``hfield``), and any file as a part of the model.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.files import check_regular, open_regular, silent_library
from anisomap.memory import Budget
from anisomap.mesh_files import read_mesh
from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.surfaces import estimate_normals
from anisomap.recording import default_names
from anisomap.simulation import solids
from anisomap.simulation.body import Body
from anisomap.simulation.checks import COUNT
from anisomap.simulation.physics import load_mujoco
from anisomap.simulation.solids import Solid, spread

MAX_ELEMENTS = 10_000
"""The time in which MuJoCo 3.9 compiles a model is quadratic: 9 s for so many geoms or bodies."""

_MAX_BYTES = 1 << 26
_INCLUDES, _MULTIPLIERS = {"include", "model"}, {"replicate", "composite", "flexcomp"}
_FOLDERS = ("meshdir", "texturedir", "assetdir")
# Attributes whose product is a number of values, and the bytes per value.
_TABLES = {"hfield": (("nrow", "ncol"), 4), "texture": (("width", "height"), 4)}
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40, "P": 1 << 50, "E": 1 << 60}
_SIZE = re.compile(r"\s*+(\d{1,30})\s*+([KMGTPE]?)\s*+")
_VALUE_BYTES = 8
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass
class _Model:
    """The counts that a MuJoCo model declares, while its files are read."""

    path: Path
    budget: Budget
    n_elements: int = 0
    n_attachable: int = 0  # elements of models that each `attach` copies
    copies: list[int] = field(default_factory=lambda: [1])  # of the elements that are open
    folders: set[Path] = field(default_factory=set)
    seen: set[Path] = field(default_factory=set)

    def read(self, path: Path) -> None:
        """Check the elements of a file, and then the files that they name."""
        if (file := Path(os.path.realpath(path))) in self.seen:
            return  # MuJoCo rejects files that are included twice
        self.seen.add(file)
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = lambda _: self.copies.pop()
        parser.StartDoctypeDeclHandler = self._refuse_types
        try:
            parser.Parse(_markup(path), True)
        except expat.ExpatError as error:
            raise FileError(f"MuJoCo cannot read {path}: it is not valid XML ({error})") from error

    def _start(self, name: str, attributes: Mapping[str, str]) -> None:
        copies = self.copies[-1]
        if name in _MULTIPLIERS:
            copies *= max(1, math.prod(_integers(attributes.get("count", "1"))))
        self.copies.append(copies)
        self.n_elements += copies * (1 + (self.n_attachable if name == "attach" else 0))
        if self.n_elements > MAX_ELEMENTS:
            raise FileError(
                f"{self.path} declares more than {MAX_ELEMENTS} elements with their copies; remove "
                "those that are not part of the body"
            )
        for n_bytes in _declared(name, attributes):
            self.budget.check(n_bytes * copies, f"<{name}>")
        if name == "compiler":
            self.folders |= {self.path.parent / attributes.get(key, "") for key in _FOLDERS}
        for file in (attributes.get("file"), attributes.get("filename")):
            if file:
                self._check_file(name, file)

    def _check_file(self, name: str, file: str) -> None:
        folders = {self.path.parent, *self.folders}
        for candidate in sorted({folder / file for folder in folders}):
            if not candidate.exists():
                continue
            if name in _INCLUDES:
                before = self.n_elements
                self.read(candidate)
                if name == "model":
                    self.n_attachable += self.n_elements - before
                continue
            with open_regular(candidate) as stream:
                head = stream.read(24)
            if head.startswith(_PNG):
                width, height = (int.from_bytes(head[at : at + 4], "big") for at in (16, 20))
                self.budget.check(4 * width * height, str(candidate))

    def _refuse_types(self, *_: object) -> None:
        raise FileError(f"{self.path} declares a document type, which is not supported")


def _declared(name: str, attributes: Mapping[str, str]) -> Iterator[int]:
    """Yield the bytes that the attributes of an element declare."""
    if name in _TABLES:
        keys, n_bytes = _TABLES[name]
        yield n_bytes * math.prod(max(1, *_integers(attributes.get(key, "1"))) for key in keys)
    if name == "size":
        for key, text in attributes.items():
            if match := _SIZE.fullmatch(text):
                n_bytes = int(match[1]) * _UNITS[match[2]]
                yield n_bytes if key == "memory" else n_bytes * _VALUE_BYTES
    if name in ("numeric", "text", "tuple"):
        yield _VALUE_BYTES * max(1, *_integers(attributes.get("size", "1")))
    for key in ("nsample", "dim"):  # of the history of a sensor, and of a sensor of the user
        yield _VALUE_BYTES * max(1, *_integers(attributes.get(key, "1")))


def _integers(text: str) -> list[int]:
    found = []
    for word in text.split():
        with suppress(ValueError, OverflowError):
            found.append(int(float(word)))
    return [count for count in found if count >= 0] or [1]


def _markup(path: Path) -> bytes:
    """Return the markup of a file in ASCII, without comments and declarations.

    MuJoCo accepts what Expat does not: two hyphens in a comment, and bytes that are not UTF-8.
    """
    with open_regular(path) as stream:
        content = stream.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise FileError(f"{path} is larger than {_MAX_BYTES >> 20} MiB, the limit for models")
    for opening, closing in ((b"<!--", b"-->"), (b"<?", b"?>")):
        at, parts = 0, []
        while (start := content.find(opening, at)) >= 0:
            parts.append(content[at:start])
            end = content.find(closing, start)
            at = len(content) if end < 0 else end + len(closing)
        parts.append(content[at:])
        content = b"".join(parts)
    return content.strip().decode("ascii", "replace").replace("\ufffd", "?").encode()


MESH_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")
MODEL_SUFFIXES = (".mjcf", ".xml")

TOLERANCE = 0.02
"""Maximum distance of a given sensor from the surface, as a fraction of the reach of the body."""

_SEED = 0
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}  # of geoms of MuJoCo
_TRIANGLE_BYTES = 72  # of its corners
_MIN_LENGTH = 1e-100  # its cube is within the range of float64
_MIN_SHARE = 1e-9  # of a part in the extent of the body; `TriangleSearch` rounds distances to it
_MAX_BALL_RADIUS = 0.6  # x median spacing: adjacent balls overlap, so nothing passes between them
_MAX_NORMAL_ERROR = 45.0  # degrees between a given and an estimated normal
_MAX_CONTRADICTIONS = 0.1  # share of the sensors; not 0, since estimates can be wrong at edges


def load_body(
    path: Path, sensors: int | ArrayLike | None = None, names: Sequence[str] = ()
) -> Body:
    """Load a body from a mesh or a MuJoCo model.

    Parameters
    ----------
    path : pathlib.Path
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
    mujoco = load_mujoco()
    _Model(path, Budget(path)).read(path)
    try:
        with silent_library():
            model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        first = str(error).strip().splitlines()[0]
        raise FileError(f"MuJoCo cannot read {path}: {first}") from error
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for lengths in (data.geom_xpos, data.geom_xmat, model.geom_size, model.mesh_vert):
        if not np.abs(lengths.astype(np.float64)).max(initial=0) < solids.MAX_LENGTH:
            raise FileError(f"{path} holds coordinates that are not finite or out of range")
    scenery = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
    candidates = [i for i in range(model.ngeom) if int(model.geom_type[i]) not in scenery]
    colliding = [i for i in candidates if model.geom_contype[i] or model.geom_conaffinity[i]]
    used = colliding or candidates
    is_mesh = model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)
    assets = [int(model.geom_dataid[i]) for i in used if is_mesh[i]]
    n_bytes = _TRIANGLE_BYTES * int(model.mesh_facenum[assets].sum(dtype=np.int64))
    Budget(path).check(n_bytes, "the surface of its meshes")
    shapes = {asset: _solid_from_mesh(model.mesh(asset), model) for asset in set(assets)}
    parts = [_solid_from_geom(mujoco, model, data, shapes, i) for i in used]
    if not parts:
        raise FileError(f"{path} has no geoms for sensors")
    if sensors is None:
        if not model.nsite:
            raise FileError(
                f"{path} has no sites to use as sensors; add sites or give the number of sensors "
                "(--sensors)"
            )
        sensors = np.array(data.site_xpos)
        names = [model.site(i).name or f"site{i}" for i in range(model.nsite)]
    return _with_sensors(path.stem, parts, sensors, names, "m")


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


def _solid_from_geom(
    mujoco: Any, model: Any, data: Any, shapes: Mapping[int, Solid], i: int
) -> Solid:
    kind = mujoco.mjtGeom(int(model.geom_type[i])).name.removeprefix("mjGEOM_").lower()
    if kind == "mesh":
        solid = shapes[int(model.geom_dataid[i])]
    elif kind in _SIZES:
        solid = Solid(kind, tuple(float(length) for length in model.geom_size[i][: _SIZES[kind]]))
    else:
        raise InputError(
            f"geom {model.geom(i).name or i} must be a sphere, capsule, cylinder, box, ellipsoid "
            "or mesh"
        )
    return solid.moved(data.geom_xmat[i].reshape(3, 3), data.geom_xpos[i])


def _solid_from_mesh(shape: Any, model: Any) -> Solid:
    first, count = int(shape.vertadr[0]), int(shape.vertnum[0])
    vertices = np.array(model.mesh_vert[first : first + count])
    first, count = int(shape.faceadr[0]), int(shape.facenum[0])
    faces = np.array(model.mesh_face[first : first + count])
    try:
        return solids.mesh(vertices, faces)
    except InputError:
        return solids.mesh(vertices, ConvexHull(vertices).simplices)
