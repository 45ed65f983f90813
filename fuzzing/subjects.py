"""What is tried: every format of the registry and of meshes, and other files that are read.

Files are kept in memory as trees: paths within a folder, and their content.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from anisomap import io
from anisomap.errors import AnisomapWarning
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

Tree: TypeAlias = Mapping[str, bytes]

sys.path.append(str(Path(__file__).parents[1] / "tests" / "helpers"))
examples: Any = import_module("example_files")

_LINES = (
    b"time,a,b,c\n" + b"".join(b"%d.5,1,%d,0\n" % (i, i % 7) for i in range(40)),
    b"".join(b'{"t": %d, "a": 1, "b": [2, %d]}\n' % (i, i) for i in range(20)),
    b"".join(b"[0, %d, 3, null]\n" % (i % 3) for i in range(20)),
    b"".join(b"%d 1%d.5 (0 1 2) 3\n" % (i, i) for i in range(20)),
)
"""What ports and sockets send: delimited text, objects, lists, and bottles of YARP."""

_TRIANGLES = "icub-display"  # holds the triangles of an iCub alone, as its example has them


@dataclass(frozen=True)
class Subject:
    """A format, and files of it that are whole; the file to read comes first in each.

    kind: A key of the checks in `workers`.
    """

    name: str
    kind: str
    seeds: Sequence[Tree]


def subjects() -> list[Subject]:
    """Make whole files of every format, of meshes, and of all else that is read."""
    seeds: dict[str, list[Tree]] = {known.name: [] for known in io.FORMATS}
    with tempfile.TemporaryDirectory(prefix="anisomap-fuzz-") as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        folder = Path(name)
        for make in (_written, _exemplary, _folders):
            for known, path in make(folder):
                seeds[known].append(_tree(path))
                _remove(path)
        found = [Subject(name, "file", trees) for name, trees in seeds.items() if trees]
        found += [*_meshes(folder), _maps(folder)]
    found.append(Subject("live source", "source", [{"lines": text} for text in _LINES]))
    return found


def map_suffixes() -> list[str]:
    """List the suffixes in which maps are written."""
    return [suffix for known in io.FORMATS if known.write_map for suffix in known.suffixes]


def recording_suffixes() -> list[str]:
    """List the suffixes in which recordings are written."""
    return [suffix for known in io.FORMATS if known.write_recording for suffix in known.suffixes]


def _written(folder: Path) -> Iterator[tuple[str, Path]]:
    """Write every format that has a writer."""
    for known in io.FORMATS:
        for suffix in known.suffixes:
            path = folder / f"file{suffix}"
            if known.write_map and known.name != _TRIANGLES:
                io.write(examples.example_map(in_metres=known.in_metres), path)
                yield known.name, path
            if known.write_recording:
                io.write(examples.example_recording(), path)
                yield known.name, path


def _exemplary(folder: Path) -> Iterator[tuple[str, Path]]:
    """Write the examples of the tests, which follow the programs that write each format."""
    for name, (known, make) in {**examples.RECORDINGS, **examples.MAPS}.items():
        if make not in (examples.own_recording, examples.own_map):
            path = folder / name
            make(path)
            yield known, path


def _folders(folder: Path) -> Iterator[tuple[str, Path]]:
    """Write formats that are folders of files."""
    values = examples.example_recording().readings
    dump = folder / "port"
    dump.mkdir()
    rows = [" ".join(map(str, row)) for row in values.tolist()]
    stamped = [f"{i} {1.3e9 + i / 50:.6f} {row}\n" for i, row in enumerate(rows)]
    (dump / "data.log").write_text("".join(stamped))
    (dump / "info.log").write_text("Type: Bottle;\n[0.0] /dumper [connected]\nStamp: tx; rx;\n")
    yield "yarp", dump
    bag = import_module("bags").Bag("db3")
    for i, row in enumerate(values):
        bag.add("/skin", bag.array(row), i)
    bag.write(folder / "bag.db3")
    (folder / "bag.db3").replace(folder / "bag" / "bag.db3")
    yield "ros", folder / "bag"


def _meshes(folder: Path) -> list[Subject]:
    trimesh = import_module("trimesh")
    shapes = (
        trimesh.creation.annulus(0.5, 1.0, 1.0, sections=8),
        trimesh.creation.icosphere(subdivisions=1),
    )
    found = []
    for suffix in (".glb", ".obj", ".off", ".ply", ".stl"):
        seeds = []
        for shape in shapes:
            path = folder / f"mesh{suffix}"
            shape.export(path)
            seeds.append(_tree(path))
        found.append(Subject(f"mesh {suffix}", "mesh", seeds))
    return found


def _maps(folder: Path) -> Subject:
    """Make two maps, and a recording of a row of sensors."""
    rng, places = np.random.default_rng(22), np.arange(12)
    readings = np.maximum(0, 2 - np.abs(places - rng.uniform(0, 11, (300, 1)))).round(3)
    skin = Recording(readings, names=tuple(f"a{i}" for i in places))
    positions = np.column_stack([places, places % 3, 0 * places]) / 100
    before = SensorMap(positions, names=skin.names, units="m")
    after = replace(before, positions=positions[:, [1, 0, 2]] + rng.normal(0, 1e-3, (12, 3)))
    io.write(before, folder / "before.json")
    io.write(after, folder / "after.json")
    io.write(skin, folder / "skin.csv")
    names = ("before.json", "after.json", "skin.csv")
    return Subject("maps", "maps", [{name: (folder / name).read_bytes() for name in names}])


def _tree(path: Path) -> Tree:
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    return {str(file.relative_to(path.parent)): _undated(file.read_bytes()) for file in files}


def _undated(content: bytes) -> bytes:
    """Blank the date in the header of a MATLAB file, so that a case can be repeated."""
    dated = content.startswith(b"MATLAB 5.0 MAT-file")
    return content[:20].ljust(116) + content[116:] if dated else content


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
