"""How the time to read a file grows with what is in it (`python -m fuzzing.growth`).

Each kind of file is read at a size and at four times that size, in processor time. Linear growth
gives a ratio of 4, quadratic growth 16; above `MAX_RATIO`, the run fails. Small times are ignored.
"""

from __future__ import annotations

import gzip
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from anisomap import io
from anisomap.errors import AnisomapError, AnisomapWarning
from anisomap.files.meshes import read_mesh
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from fuzzing.checks import processor_time

MAX_RATIO = 9.0
"""Largest ratio of times, far from those of linear and of quadratic growth."""

LEAST_S = 0.3
"""Processor time at the larger size below which growth does not matter."""

_FACTOR, _REPEATS = 4, 3
_WIDE = 1500

Make: TypeAlias = Callable[[Path, int], None]


def _table(path: Path, shape: tuple[int, int]) -> None:
    io.write(Recording(np.random.default_rng(0).random(shape).round(3)), path)


def _arrow(path: Path, shape: tuple[int, int]) -> None:
    arrow, values = import_module("pyarrow"), np.random.default_rng(0).random(shape)
    table = arrow.table({f"c{i}": column for i, column in enumerate(values.T)})
    import_module("pyarrow.parquet").write_table(table, path)


def _hdf5(path: Path, n: int) -> None:
    with import_module("h5py").File(path, "w") as file:
        for i in range(n):
            file[f"a{i}/b"] = np.zeros(3)
        file["readings"] = np.zeros((9, 5))


def _mat(path: Path, n: int) -> None:
    cells = np.empty(n, dtype=object)
    cells[:] = [np.arange(3.0)] * n
    import_module("scipy.io").savemat(path, {"trains": cells})


def _mesh(path: Path, n: int) -> None:
    trimesh: Any = import_module("trimesh")
    trimesh.creation.uv_sphere(count=[round(n**0.5)] * 2).export(path)


def _nodes(path: Path, n: int) -> None:
    trimesh: Any = import_module("trimesh")
    scene = trimesh.Scene()
    for i in range(n):
        shift = trimesh.transformations.translation_matrix([3 * i, 0, 0])
        scene.add_geometry(trimesh.creation.box(), transform=shift, geom_name="box")
    path.write_bytes(scene.export(file_type="glb"))


def _map(path: Path, n: int) -> None:
    io.write(SensorMap(np.random.default_rng(0).random((n, 3)), units="m"), path)


def _text(path: Path, text: str) -> None:
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())


def _log(path: Path, n_rows: int, n_columns: int) -> None:
    row = " ".join(str(i % 7) for i in range(n_columns))
    _text(path, "".join(f"{i} {1.3e9 + i / 50:.6f} ({row})\n" for i in range(n_rows)))


GROWTHS: Mapping[str, tuple[str, int, Make]] = MappingProxyType(
    {
        "npz, frames": ("a.npz", 100_000, lambda path, n: _table(path, (n, 5))),
        "npz, sensors": ("a.npz", 30_000, lambda path, n: _table(path, (5, n))),
        "csv, frames": ("a.csv", 20_000, lambda path, n: _table(path, (n, 5))),
        "csv, sensors": ("a.csv", 20_000, lambda path, n: _table(path, (5, n))),
        "csv.gz, frames": ("a.csv.gz", 30_000, lambda path, n: _text(path, "1,2,3\n" * n)),
        "yarp, frames": ("data.log", 20_000, lambda path, n: _log(path, n, 5)),
        "yarp, sensors": ("data.log", 100_000, lambda path, n: _log(path, 3, n)),
        "parquet, columns": ("a.parquet", _WIDE, lambda path, n: _arrow(path, (9, n))),
        "parquet, rows": ("a.parquet", 100_000, lambda path, n: _arrow(path, (n, 9))),
        "hdf5, datasets": ("a.h5", 200, _hdf5),
        "mat, cells": ("a.mat", 5_000, _mat),
        "json, sensors": ("map.json", 5_000, _map),
        "urdf, frames": ("map.urdf", 2_000, _map),
        "mjcf, sites": ("map.mjcf", 5_000, _map),
        "ply, points": ("map.ply", 20_000, _map),
        "pcd, points": ("map.pcd", 20_000, _map),
        "mesh .stl, triangles": ("mesh.stl", 2_000, _mesh),
        "mesh .obj, triangles": ("mesh.obj", 2_000, _mesh),
        "mesh .glb, nodes": ("mesh.glb", 300, _nodes),
    }
)
"""File, its smaller size, and its writer, by what grows."""


def main() -> int:
    """Print the times and their ratios; return 1 if one of them is too large."""
    print("| file | s at n | s at 4 n | ratio |\n|---|---:|---:|---:|")
    failed = False
    with tempfile.TemporaryDirectory(prefix="anisomap-growth-") as folder:
        for name, kind in GROWTHS.items():
            # The first reading imports libraries.
            _, small, large = (_seconds(Path(folder), *kind, factor) for factor in (1, 1, _FACTOR))
            ratio = large / max(small, 1e-3)
            failed |= large > LEAST_S and ratio > MAX_RATIO
            print(f"| {name} | {small:.2f} | {large:.2f} | {ratio:.1f} |", flush=True)
    return int(failed)


def _seconds(folder: Path, name: str, size: int, make: Make, factor: int) -> float:
    path = folder / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # of a map with many frames
        make(path, factor * size)
    read: Callable[[Path], Any] = io.read
    if name.startswith("mesh"):
        read = read_mesh
    elif name.startswith("map"):
        read = io.read_map
    times = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        for _ in range(_REPEATS):
            started = processor_time()
            with suppress(AnisomapError):  # of what is limited by its size
                read(path)
            times.append(processor_time() - started)
    return min(times)


if __name__ == "__main__":
    sys.exit(main())
