"""Uneven ground: a height field with MuJoCo's triangulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from anisomap.numerics.triangles import Points, TriangleSearch
from anisomap.scene import Mesh, frozen

_TRUNCATION = 4.0  # of the Gaussian, x its standard deviation


@dataclass(frozen=True, eq=False)
class Terrain:
    """Solid ground with heights on a square grid.

    Parameters
    ----------
    heights : array_like of shape (n, n)
        Rows go along y, columns along x. The middle of the grid is above the origin.
    cell : float
        Grid spacing.
    """

    heights: NDArray[np.float64]
    cell: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "heights", frozen(self.heights))

    @property
    def half_width(self) -> float:
        """Distance from the middle to each edge."""
        return self.cell * (len(self.heights) - 1) / 2

    @cached_property
    def mesh(self) -> Mesh:
        """Triangles of the ground, two per cell.

        As in MuJoCo (checked by ``mj_ray``), the diagonal of the cell at row r and column c goes
        from (r, c) to (r + 1, c + 1).
        """
        n = len(self.heights)
        across = self.cell * np.arange(n) - self.half_width
        x, y = np.meshgrid(across, across)
        index = np.arange(n * n).reshape(n, n)
        here, right, up, beyond = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        faces = [
            np.stack(part, axis=-1).reshape(-1, 3)
            for part in ((here, right, beyond), (here, beyond, up))
        ]
        vertices = np.column_stack([x.ravel(), y.ravel(), self.heights.ravel()])
        return Mesh(vertices, np.vstack(faces))

    def height(self, places: ArrayLike) -> NDArray[np.float64]:
        """Interpolate the height at places (n, 2); constant beyond the edges."""
        scaled = (np.asarray(places, dtype=np.float64)[:, :2] + self.half_width) / self.cell
        last = len(self.heights) - 1
        scaled = np.clip(scaled, 0, last)
        column, row = np.minimum(scaled.astype(np.intp), last - 1).T
        right, up = scaled[:, 0] - column, scaled[:, 1] - row
        corner, beyond = self.heights[row, column], self.heights[row + 1, column + 1]
        third = np.where(right >= up, self.heights[row, column + 1], self.heights[row + 1, column])
        most, least = np.maximum(right, up), np.minimum(right, up)
        return np.asarray(corner + most * (third - corner) + least * (beyond - third))

    def distance(self, points: ArrayLike) -> Points:
        """Compute the exact distance of points from the surface.

        Parameters
        ----------
        points : array_like of shape (n, 3)
            Above or below the grid, not beside it.

        Returns
        -------
        ndarray of shape (n,)
            Distance from the nearest triangle, negative below the ground.
        """
        return self._search.signed_distance(np.asarray(points, dtype=np.float64))

    def readings(self, points: ArrayLike, detection_radius: float) -> NDArray[np.float32]:
        """Read the ground with short-range proximity sensors.

        Parameters
        ----------
        points : array_like of shape (n, 3)
            Sensor positions.
        detection_radius : float

        Returns
        -------
        ndarray of float32, shape (n,)
            Penetration depth of the ground into the detection sphere,
            ``max(0, detection_radius - distance)``.
        """
        places = np.asarray(points, dtype=np.float64)
        found = np.zeros(len(places), dtype=np.float32)
        # The height above the highest peak is a lower bound of the distance.
        near = places[:, 2] - self.heights.max() < detection_radius
        found[near] = np.maximum(detection_radius - self.distance(places[near]), 0)
        return found

    @cached_property
    def _search(self) -> TriangleSearch:
        return TriangleSearch(self.mesh)


def bumpy_terrain(
    half_width: float, cell: float, roughness: float, correlation: float, rng: np.random.Generator
) -> Terrain:
    """Generate ground with smooth random bumps: white noise with a Gaussian filter.

    Parameters
    ----------
    half_width : float
        Minimum distance from the middle to each edge.
    cell : float
        Grid spacing.
    roughness : float
        Root mean square height; the mean height is 0.
    correlation : float
        Distance at which the correlation of heights is ``exp(-1/4)``. Bumps are about two to three
        times as wide.
    rng : numpy.random.Generator

    Returns
    -------
    Terrain
    """
    n = 2 * int(np.ceil(half_width / cell)) + 1
    noise = rng.standard_normal((n, n))
    smooth = gaussian_filter(noise, correlation / cell, mode="reflect", truncate=_TRUNCATION)
    smooth -= smooth.mean()
    spread = float(np.sqrt(np.mean(smooth**2)))
    return Terrain(roughness / spread * smooth, cell)
