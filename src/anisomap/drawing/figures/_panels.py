"""One panel of a picture: a configuration of sensors, or two sets of distances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import matplotlib.colors
import matplotlib.patheffects
import matplotlib.ticker
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.drawing.view import View, axis_title, view_axes

Axes: TypeAlias = Any
"""A matplotlib Axes; Any, for the three-dimensional kind comes without types."""

INK = "#22262b"
FAINT = "#6a737d"
_LAYERS = 6
_MOST_PAIRS_DRAWN = 3_000
_MOST_SENSORS_PAIRED = 1_500
_DENSITY_CELLS = 90
_STEEP = 50
_FEW_PAIRS = 200
_SIZE = 75.0
_CROWD = 300
_FAR_TOO_MANY = 5_000  # dots for a drawing program: they are drawn as pixels in SVG and PDF, too


@dataclass(frozen=True, eq=False)
class Look:
    """How sensors are drawn, alike in every panel that shows them.

    Attributes
    ----------
    colours : ndarray of shape (N, 3)
        sRGB in [0, 1].
    pairs : ndarray of int, shape (E, 2)
        Which sensors a line joins.
    ailing, unscored : ndarray of bool, shape (N,)
        Which sensors bear a mark.
    labels : dict of int to str
        Names to write beside some sensors.
    """

    colours: NDArray[np.float64]
    pairs: NDArray[np.intp]
    ailing: NDArray[np.bool_]
    unscored: NDArray[np.bool_]
    labels: dict[int, str]

    def first(self, count: int) -> Look:
        """Keep the first sensors only, and the lines that join those."""
        return Look(
            colours=self.colours[:count],
            pairs=self.pairs[(self.pairs < count).all(axis=1)],
            ailing=self.ailing[:count],
            unscored=self.unscored[:count],
            labels={i: name for i, name in self.labels.items() if i < count},
        )


def draw_body(
    axes: Axes,
    points: NDArray[np.float64],
    look: Look,
    *,
    limits: NDArray[np.float64],
    view: View,
    units: str,
) -> None:
    """Draw a configuration, its neighbours joined, near sensors before far ones.

    Parameters
    ----------
    axes : matplotlib Axes
        Three-dimensional if `points` are.
    points : ndarray of shape (n, k)
        Positions, k = 2 or 3.
    look : Look
        Of the same n sensors.
    limits : ndarray of shape (k, 2)
        What the axes span.
    view : tuple of float
        Elevation and azimuth in degrees; of no effect in the plane.
    units : str
        Of the axes.
    """
    for name, span in zip("xyz", limits, strict=False):
        axes.set(**{f"{name}lim": span})
        title = axis_title(name, units)
        getattr(axes, f"set_{name}label")(title, parse_math=False, color=INK)
        getattr(axes, f"{name}axis").set_major_locator(matplotlib.ticker.MaxNLocator(4))
    axes.set_aspect("equal")
    if points.shape[1] == 3:
        _set_up_space(axes, limits, view)
        depth = points @ view_axes(view)[2]
        nearness = 1 - (depth.max() - depth) / np.ptp(limits, axis=1).max()
    else:
        axes.grid(color="#e6e8eb", linewidth=0.6)
        axes.set_axisbelow(True)
        nearness = np.ones(len(points))
    _draw_layers(axes, points, look, np.clip(nearness, 0, 1))
    rightwards = view_axes(view)[0] if points.shape[1] == 3 else np.array([1.0, 0.0])
    for i, name in look.labels.items():
        right_half = bool((points[i] - limits.mean(axis=1)) @ rightwards > 0)
        _write_label(axes, points[i], f"{name} " if right_half else f" {name}", right_half)


def draw_distances(
    axes: Axes, truth: NDArray[np.float64], found: NDArray[np.float64], units: str
) -> str:
    """Draw the distance of every pair of sensors on the map against the true one.

    Few pairs are drawn as dots, many as their density. Of more than 1500 sensors, 1500 evenly
    spaced ones stand for all.

    Parameters
    ----------
    axes : matplotlib Axes
    truth, found : ndarray of shape (n, k), (n, l)
        The same sensors, both in units of the truth.
    units : str
        Of the truth.

    Returns
    -------
    str
        What a dot or a shade stands for.
    """
    n_sensors = len(truth)
    kept = np.unique(
        np.linspace(0, n_sensors - 1, min(n_sensors, _MOST_SENSORS_PAIRED)).astype(int)
    )
    true_distances, found_distances = pdist(truth[kept]), pdist(found[kept])
    longest = 1.04 * max(float(true_distances.max()), float(found_distances.max()))
    axes.plot([0, longest], [0, longest], color=INK, linewidth=1, linestyle="--", zorder=3)
    if true_distances.size <= _MOST_PAIRS_DRAWN:
        axes.plot(
            true_distances,
            found_distances,
            ".",
            markersize=4 if true_distances.size > _FEW_PAIRS else 8,
            alpha=0.5,
            markeredgewidth=0,
            color="#0072b2",
            rasterized=True,
        )
        label = f"{true_distances.size} pairs of sensors"
    else:
        cells, edges, _ = np.histogram2d(
            true_distances, found_distances, bins=_DENSITY_CELLS, range=[[0, longest]] * 2
        )
        axes.pcolormesh(
            edges,
            edges,
            np.ma.masked_equal(cells.T, 0),
            norm=matplotlib.colors.LogNorm(vmin=1),
            cmap=matplotlib.colors.LinearSegmentedColormap.from_list(
                "pairs", ["#cfe3f1", "#0072b2", "#001b2e"]
            ),
            rasterized=True,
        )
        label = f"{true_distances.size} pairs of sensors, as a density"
    if len(kept) < n_sensors:
        label = f"{true_distances.size} pairs among {len(kept)} of the sensors"
    axes.set(xlim=(0, longest), ylim=(0, longest))
    axes.set_aspect("equal")
    axes.set_xlabel(axis_title("true distance", units), parse_math=False, color=INK)
    axes.set_ylabel(axis_title("distance on the map", units), parse_math=False, color=INK)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(matplotlib.ticker.MaxNLocator(5))
    return label


def _set_up_space(axes: Axes, limits: NDArray[np.float64], view: View) -> None:
    axes.view_init(*view)
    axes.set_box_aspect(np.ptp(limits, axis=1), zoom=1.07)
    axes.tick_params(pad=-2)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color("#fafbfb")
        axis.labelpad = -3
    if view[0] > _STEEP:  # the z axis is so short here that its ticks would lie on one another
        axes.zaxis.set_ticklabels([])


def _draw_layers(
    axes: Axes, points: NDArray[np.float64], look: Look, nearness: NDArray[np.float64]
) -> None:
    """Paint from back to front, for 3D axes do not sort lines among points themselves."""
    first, second = look.pairs.T
    point_layer = np.minimum((nearness * _LAYERS).astype(int), _LAYERS - 1)
    # A line lies at the depth of its farther end, so that it never crosses over a nearer dot.
    line_layer = np.minimum(point_layer[first], point_layer[second])
    size = _SIZE * float(np.clip(np.sqrt(60 / len(points)), 0.02, 1))
    crowded, as_pixels = len(points) > _CROWD, len(points) > _FAR_TOO_MANY
    for layer in np.unique(point_layer):
        near = (layer + 1) / _LAYERS
        segments = _segments(points, look.pairs[line_layer == layer])
        axes.plot(
            *segments.T,
            color="#555b62",
            alpha=(0.12 + 0.5 * near**1.5) * (0.5 if crowded else 1),
            linewidth=(0.5 + 0.6 * near) * (0.6 if crowded else 1),
            rasterized=as_pixels,
            zorder=4 * layer + 1,
        )
        chosen = point_layer == layer
        axes.scatter(
            *points[chosen].T,
            s=size * (0.4 + 0.6 * near),
            c=look.colours[chosen],
            alpha=0.45 + 0.55 * near,
            edgecolors=np.where(look.unscored[chosen], FAINT, "white").tolist(),
            linewidths=0 if crowded else 0.5,
            rasterized=as_pixels,
            zorder=4 * layer + 2,
            **_flat_colours(axes),
        )
        for marked, marker, scale in ((look.ailing, "x", 1.3), (look.unscored, "s", 2.6)):
            if (marked & chosen).any():
                axes.scatter(
                    *points[marked & chosen].T,
                    s=(size if as_pixels else max(size, 16)) * scale,
                    marker=marker,
                    facecolors="black" if marker == "x" else "none",
                    **({} if marker == "x" else {"edgecolors": INK}),
                    linewidths=1.4 if marker == "x" else 0.8,
                    rasterized=as_pixels,
                    zorder=4 * layer + 3,
                    **_flat_colours(axes),
                )


def _flat_colours(axes: Axes) -> dict[str, bool]:
    return {"depthshade": False} if axes.name == "3d" else {}


def _segments(points: NDArray[np.float64], pairs: NDArray[np.intp]) -> NDArray[np.float64]:
    """One long line for many short ones, NaN between them, shape (3 E, k)."""
    segments = np.full((len(pairs), 3, points.shape[1]), np.nan)
    segments[:, :2] = points[pairs]
    return segments.reshape(-1, points.shape[1])


def _write_label(axes: Axes, point: NDArray[np.float64], name: str, leftwards: bool) -> None:
    axes.text(
        *point,
        name,
        ha="right" if leftwards else "left",
        fontsize=7.5,
        color=INK,
        parse_math=False,
        va="bottom",
        zorder=100,
        path_effects=[matplotlib.patheffects.withStroke(linewidth=2, foreground="white")],
    )
