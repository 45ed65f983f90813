"""Accuracy and cost of approximate maps, compared with exact maps.

``python -m benchmarks.speed.approximate`` prints the table of ``explanation/large-recordings.md``,
``--large`` that of sizes for which only approximate maps are possible, and ``--recordings FOLDER``
that of real recordings (NPZ archives with ``readings`` and ``positions``).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap import read, reconstruct_from, score
from anisomap.large import reconstruct_approximately
from anisomap.numerics.similarity.correlation import pearson
from benchmarks.harness import files_in, keyed_table, quietly
from benchmarks.skins.inputs import directions, sphere_radius
from benchmarks.speed.measuring import measure

Matrix = NDArray[np.float64]

REACH = 4.0
"""Radius of a contact in sensor spacings; it covers 50 sensors."""

STROKE = 15
"""Frames of a stroke: straight motion of a contact before it is lifted."""

BLOCK = 500


@dataclass(frozen=True)
class Skin:
    """A kind of skin, the dimensions of its map, and whether many contacts are simultaneous."""

    name: str
    spread: Callable[[int, int, np.random.Generator], Matrix]
    dimensions: int
    many: bool = False

    def contacts(self, n_sensors: int) -> int:
        """Return the number of simultaneous contacts."""
        return max(2, n_sensors // 1000) if self.many else 1


def on_a_square(n_points: int, n_sensors: int, rng: np.random.Generator) -> Matrix:
    """Draw points on a square with one unit of area per sensor."""
    return rng.uniform(0, n_sensors**0.5, (n_points, 2))


def on_a_sphere(n_points: int, n_sensors: int, rng: np.random.Generator) -> Matrix:
    """Draw points on a sphere of the same area."""
    return sphere_radius(n_sensors) * directions(n_points, rng)


SKINS = (
    Skin("flat, one contact, in 2D", on_a_square, 2),
    Skin("flat, one contact, in 3D", on_a_square, 3),
    Skin("sphere, one contact, in 3D", on_a_sphere, 3),
    Skin("flat, N / 1000 contacts, in 2D", on_a_square, 2, many=True),
    Skin("sphere, N / 1000 contacts, in 3D", on_a_sphere, 3, many=True),
)


def touch(
    skin: Skin, sensors: Matrix, n_frames: int, rng: np.random.Generator
) -> Iterator[NDArray[np.uint8]]:
    """Yield blocks of readings of a skin rubbed in strokes."""
    n_sensors, tree = len(sensors), KDTree(sensors)
    n_contacts = skin.contacts(n_sensors)
    for begin in range(0, n_frames, BLOCK):
        count = min(BLOCK, n_frames - begin)
        frames = np.repeat(np.arange(count), n_contacts)
        strokes = frames // STROKE * n_contacts + np.tile(np.arange(n_contacts), count)
        starts = skin.spread(strokes.max() + 1, n_sensors, rng)
        headings = rng.normal(size=starts.shape)
        headings /= np.linalg.norm(headings, axis=1, keepdims=True)
        places = starts[strokes] + headings[strokes] * (frames % STROKE)[:, None]
        if sensors.shape[1] == 3:
            places *= np.linalg.norm(sensors[0]) / np.linalg.norm(places, axis=1, keepdims=True)
        forces = rng.uniform(0.6, 1, len(starts))[strokes]
        apart = KDTree(places).sparse_distance_matrix(tree, REACH, output_type="coo_matrix")
        depths = 255 * forces[apart.row] * (1 - apart.data / REACH)
        block = np.zeros((count, n_sensors), dtype=np.uint8)
        np.maximum.at(block, (frames[apart.row], apart.col), depths.astype(np.uint8))
        yield block


Row = dict[str, object]


def losses(sizes: Sequence[int], n_frames: int, seeds: int) -> Iterator[Row]:
    """Yield mean scores of exact and approximate maps of the same recordings."""
    for skin, n_sensors in product(SKINS, sizes):
        runs = []
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            sensors = skin.spread(n_sensors, n_sensors, rng)
            readings = np.concatenate(list(touch(skin, sensors, n_frames, rng)))
            runs.append(_compare(readings, sensors, skin.dimensions))
        mean = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
        worst = max(run["lost"] for run in runs)
        yield {"skin": skin.name, "sensors": n_sensors, **_formatted(mean | {"worst": worst})}


def real_losses(folder: Path) -> Iterator[Row]:
    """Yield scores of exact and approximate 2D maps of real recordings."""
    for path in files_in([folder]):
        recording = read(path)
        if recording.positions is not None:
            found = _compare(recording.readings, recording.positions, 2)
            yield {"recording": path.stem, "sensors": recording.n_sensors, **_formatted(found)}


def _compare(readings: NDArray[np.generic], sensors: Matrix, dimensions: int) -> dict[str, float]:
    slow, exact = measure(
        lambda: reconstruct_from(
            method="r-anisomap", dimensions=dimensions, similarity=pearson(readings)
        )
    )
    fast, found = measure(lambda: reconstruct_approximately(readings, dimensions))
    pairs = ((exact, sensors), (found, sensors), (found, exact.positions))
    first, second, agreement = (score(*pair, permutations=0).mantel.r for pair in pairs)
    return {
        "exact": first,
        "approximate": second,
        "lost": first - second,
        "agreement": agreement,
        "exact (s)": slow.cpu,
        "approximate (s)": fast.cpu,
    }


def _formatted(found: dict[str, float]) -> Row:
    return {
        name: f"{value:.1f}" if name.endswith("(s)") else f"{value:.4f}"
        for name, value in found.items()
    }


def costs(sizes: Sequence[int], n_frames: int) -> Iterator[Row]:
    """Yield time, memory and scores of approximate maps of recordings on disk."""
    for n_sensors, skin in product(sizes, SKINS[3:]):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "readings.npy"
            sensors = _written(path, skin, n_sensors, n_frames)
            mapped = np.load(path, mmap_mode="r")
            cost, found = measure(partial(reconstruct_approximately, mapped, skin.dimensions))
        result = score(found, sensors, permutations=0)
        yield {
            "skin": skin.name,
            "sensors x frames": f"{n_sensors} x {n_frames}",
            "CPU (s)": f"{cost.cpu:.0f}",
            "memory (GB)": f"{cost.memory / 1e3:.1f}",
            "Mantel r": f"{result.mantel.r:.4f}",
            "neighbours kept": f"{result.neighbours_kept:.0%}",
        }


def _written(path: Path, skin: Skin, n_sensors: int, n_frames: int) -> Matrix:
    rng = np.random.default_rng(0)
    sensors = skin.spread(n_sensors, n_sensors, rng)
    file = np.lib.format.open_memmap(path, "w+", np.uint8, (n_frames, n_sensors))
    done = 0
    for block in touch(skin, sensors, n_frames, rng):
        file[done : done + len(block)] = block
        done += len(block)
    file.flush()
    return sensors


def main() -> None:
    """Print the tables, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensors", type=int, nargs="+", default=[1000, 4000, 8000])
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--recordings", type=Path)
    arguments = parser.parse_args()
    if arguments.large:
        rows = costs([20_000, 100_000], arguments.frames)
    elif arguments.recordings:
        rows = real_losses(arguments.recordings)
    else:
        rows = losses(arguments.sensors, arguments.frames, arguments.seeds)
    with quietly():
        for line in keyed_table(rows):
            print(line, flush=True)


if __name__ == "__main__":
    main()
