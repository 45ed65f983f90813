"""Small skins with known positions: simulated in closed form, or stored; and maps of them."""

import warnings
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ortho_group

from anisomap import Recording, SensorMap, io, mantel, reconstruct, score
from anisomap.errors import AnisomapWarning
from anisomap.method.evidence import Evidence
from anisomap.method.named import MethodOptions, find_method

FIXTURES = Path(__file__).parents[1] / "fixtures"


def lattice(rows: int = 6, columns: int = 7) -> NDArray[np.float64]:
    """Return a flat triangular lattice with spacing 1, shape (rows * columns, 2)."""
    x, y = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    x[1::2] += 0.5
    return np.column_stack([x.ravel(), y.ravel() * 3**0.5 / 2])


def rubbed(
    positions: NDArray[np.float64], n_frames: int = 1500, *, seed: int = 0, reach: float = 2.0
) -> NDArray[np.float64]:
    """Return readings under one contact that follows a random walk; zero beyond its reach."""
    rng = np.random.default_rng(seed)
    low, high = positions.min(axis=0) - reach / 2, positions.max(axis=0) + reach / 2
    # Reflect the random walk at the sides of the box, so that coverage is uniform.
    walk = np.cumsum(rng.normal(0, 0.6, (n_frames, positions.shape[1])), axis=0)
    touch = low + np.abs(
        (walk + rng.uniform(0, 50, positions.shape[1])) % (2 * (high - low)) - (high - low)
    )
    distances = np.linalg.norm(touch[:, None] - positions, axis=2)
    pressure = rng.uniform(0.6, 1.4, (n_frames, 1))
    return np.maximum(0, reach - distances) * pressure


def moved_freely(
    points: NDArray[np.float64], rng: np.random.Generator, factor: float = 3.0
) -> NDArray[np.float64]:
    """Turn, scale, shift and maybe mirror points, shape (N, k)."""
    turn = ortho_group.rvs(points.shape[1], random_state=rng)
    return factor * points @ turn.T + rng.normal(size=points.shape[1])


@cache
def flat_skin(*, seed: int = 0, n_frames: int = 1500) -> Recording:
    """Return a recording of a rubbed flat skin of 42 sensors, with positions."""
    positions = lattice()
    return Recording(
        rubbed(positions, n_frames, seed=seed), positions=positions, units="mm", rate_hz=50
    )


@cache
def flat_map(method: str = "covariogram", *, seed: int = 0, n_frames: int = 1500) -> SensorMap:
    """Return the map in 2D of `flat_skin`; made once for all tests of a process."""
    return quietly(reconstruct, flat_skin(seed=seed, n_frames=n_frames), method, 2)


@cache
def stored(name: str) -> Recording:
    """Return a recording of a physical simulation, see ``fixtures/README.md``."""
    return io.read(FIXTURES / f"{name}.npz")


def quietly(function, *arguments, **options):
    """Call a function whose warnings about a map are not those that a test is about."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        return function(*arguments, **options)


def seeing_patch(*, seed: int = 0, n_frames: int = 1500) -> Recording:
    """Return pixels that see smooth random images: dense, continuous, identically distributed."""
    positions = lattice()
    squares = ((positions[:, None] - positions) ** 2).sum(axis=2)
    smooth = np.linalg.cholesky(np.exp(-squares / 8) + 1e-6 * np.eye(len(positions)))
    images = np.random.default_rng(seed).normal(size=(n_frames, len(positions))) @ smooth.T
    return Recording(images, positions=positions, units="pixels")


def stages(readings, method="covariogram", options=None):
    """Compute the similarity of pairs, the dissimilarity and the metric of a method."""
    recipe, chosen = find_method(method), options or MethodOptions()
    recording, refined = Recording(readings), recipe.refine is not None
    evidence = Evidence.of(
        recording, recipe.similarity, bins=chosen.entropy_bins, with_variance=refined
    )
    return SimpleNamespace(
        evidence=evidence,
        similarity=evidence.similarity,
        dissimilarity=recipe.dissimilarity(evidence, chosen),
        metric=recipe.lengths_of(evidence, chosen),
    )


def mantel_r(sensor_map: SensorMap, recording: Recording) -> float:
    """Return the Mantel r of a map with the true positions in its recording."""
    return score(sensor_map, recording.positions, permutations=0).mantel.r


def likeness(found: NDArray[np.float64], places: NDArray[np.float64]) -> float:
    """Return the Mantel r of two arrays of positions."""
    return mantel(found, places, permutations=0).r


def triangles(columns: int = 4, rows: int = 2) -> NDArray[np.float64]:
    """Return triangular modules of 10 sensors that tile a plane, shape (20 * columns * rows, 2).

    Sensors are 1 apart on a module; adjacent modules are 0.3 farther apart. Sensors of a module are
    consecutive, row by row from its base; every other module is turned by 180 degrees.
    """
    height = 3**0.5 / 2
    pads = np.array([[i + j / 2, j * height] for j in range(4) for i in range(4 - j)])
    pads -= pads.mean(axis=0)
    side = 4.5
    found = []
    for row in range(rows):
        for column in range(columns):
            centre = np.array([side * column + side / 2 * row, side * height * row])
            found += [pads + centre, centre + np.array([side / 2, side * height / 3]) - pads]
    return np.vstack(found)


@cache
def bombarded_skin() -> Recording:
    """Return the readings of 60 sensors on a sphere that balls bombard: `simulate(seed=1)`, stored.

    Readings are whole numbers up to 1000.
    """
    with np.load(Path(__file__).parents[1] / "fixtures" / "bombarded.npz") as stored:
        return Recording(stored["readings"], positions=stored["positions"])
