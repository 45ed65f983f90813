"""Figures of simulated scenes, as in Figures 5 and 6 of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures.backend import (
    FAINT,
    INK,
    Axes,
    add_axes,
    load,
    new_figure,
    set_ticks,
    set_title,
)
from anisomap.drawing.view import axis_title
from anisomap.errors import InputError
from anisomap.simulation.options import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FACES = {"ground": "#b7c7a8", "body": "#c9ced4", "stimulus": "#e69f00"}
_ALPHA = {"ground": 0.9, "body": 0.5, "stimulus": 0.35}
_READINGS = "viridis"
_LIGHT = (150, 54)  # azimuth and altitude of the light
_GROUND_EXTENT = 1.8  # of the drawn ground, relative to the extent of all other objects


def scene_figure(scene: Scene, frame: int | None = None) -> Figure:
    """Draw a frame of a scene, its readings on the body, and the readings over the run.

    Parameters
    ----------
    scene : Scene
    frame : int, optional
        Index of the frame. Default: the frame with the most active sensors.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with `anisomap.drawing.figures.save_figure`.

    Raises
    ------
    InputError
        If there is no such frame.
    MissingExtraError
        If matplotlib is not installed.
    """
    if frame is None:
        frame = int(np.argmax((scene.readings > 0).sum(axis=1)))
    with new_figure(15.0, 5.6, scene.title) as figure:
        edges = {"left": 0.01, "right": 0.94, "bottom": 0.11, "top": 0.84}
        cells = figure.add_gridspec(1, 3, width_ratios=(1.15, 1.15, 1), wspace=0.3, **edges)
        axes = add_axes(figure, 3, cells[0])
        _draw_scene(axes, scene, frame)
        set_title(axes, f"Frame {frame} of {scene.n_frames}, {scene.times[frame]:.2f} s")
        axes = add_axes(figure, 3, cells[1])
        _draw_scene(axes, _body_of(scene), frame)
        set_title(axes, "Body and readings in this frame")
        _draw_readings(figure.add_subplot(cells[2]), scene, frame)
        return figure


def bodies_figure(title: str, scenes: Sequence[Scene], labels: Sequence[str]) -> Figure:
    """Draw the bodies of several scenes side by side, with their sensors."""
    if not scenes or len(scenes) != len(labels):
        raise InputError(f"{len(scenes)} scenes need as many labels, got {len(labels)}")
    with new_figure(4.0 * len(scenes), 4.6, title) as figure:
        figure.subplots_adjust(left=0.01, right=0.94, bottom=0.08, top=0.86, wspace=0.16)
        for i, (scene, label) in enumerate(zip(scenes, labels, strict=True)):
            touched = replace(_body_of(scene), readings=np.ones_like(scene.readings))
            axes = add_axes(figure, 3, 1, len(scenes), i + 1)
            _draw_scene(axes, touched, 0)
            set_title(axes, label)
            axes.locator_params(nbins=2)
            axes.patch.set_visible(False)  # it would hide labels of the panel on the left
        return figure


def _draw_scene(ax: Axes, scene: Scene, frame: int) -> None:
    """Draw a frame of a scene; sensors are coloured by their readings."""
    if not 0 <= frame < scene.n_frames:
        raise InputError(f"frame must be from 0 to {scene.n_frames - 1}, got {frame}")
    ax.computed_zorder = False
    parts = [(prop, vertices) for prop in scene.props for vertices in prop.surfaces(frame)]
    visible = np.vstack([vertices for prop, vertices in parts if prop.role != "ground"])
    lowest, highest = visible.min(axis=0), visible.max(axis=0)
    for prop, vertices in parts:
        if prop.role == "room":
            ax.add_collection3d(_edges_of_box(vertices))
    for role in _FACES:
        triangles = [vertices[prop.mesh.faces] for prop, vertices in parts if prop.role == role]
        if triangles:
            near = _within(np.vstack(triangles), lowest, highest)
            ax.add_collection3d(_surface(near, role), autolim=False)
    ax.scatter(
        *scene.sensors[frame % len(scene.sensors)].T, c=scene.readings[frame], cmap=_READINGS,
        norm=_norm(scene), s=26, edgecolors=INK, linewidths=0.4, depthshade=False, zorder=10,
    )  # fmt: skip
    ax.set(xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), zlim=(lowest[2], highest[2]))
    ax.set_box_aspect(np.maximum(highest - lowest, 1e-12), zoom=0.98)
    set_ticks(ax, highest - lowest, 4)
    for name in "xyz":
        getattr(ax, f"set_{name}label")(axis_title(name, scene.units), parse_math=False)
        getattr(ax, f"{name}axis").set_pane_color((1.0, 1.0, 1.0))
    ax.grid(visible=False)


def _body_of(scene: Scene) -> Scene:
    """Remove everything but the body."""
    return replace(scene, props=tuple(prop for prop in scene.props if prop.role == "body"))


def _norm(scene: Scene) -> Any:
    highest = float(np.nanmax(scene.readings, initial=0)) or 1.0
    return load("matplotlib.colors").Normalize(0, highest)


def _draw_readings(axes: Axes, scene: Scene, frame: int) -> None:
    raster = axes.imshow(
        scene.readings.T,
        aspect="auto",
        cmap=_READINGS,
        norm=_norm(scene),
        interpolation="nearest",
        extent=(0, max(float(scene.times[-1]), 1e-9), scene.readings.shape[1] - 0.5, -0.5),
    )
    axes.axvline(scene.times[frame], color="#d55e00", linewidth=1)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("sensor")
    set_title(axes, "Readings of all sensors over the run")
    bar = axes.figure.colorbar(raster, ax=axes, fraction=0.05)
    bar.set_label(axis_title("reading", scene.units), parse_math=False)


def _within(
    triangles: NDArray[np.float64], lowest: NDArray[np.float64], highest: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Remove triangles far from a box, i.e. most triangles of a wide ground."""
    middle, half = (lowest + highest)[:2] / 2, (highest - lowest)[:2].max() / 2
    distances = np.abs(triangles[:, :, :2] - middle).max(axis=(1, 2))
    return np.asarray(triangles[distances <= _GROUND_EXTENT * half])


def _surface(triangles: NDArray[np.float64], role: str) -> Any:
    return load("mpl_toolkits.mplot3d.art3d").Poly3DCollection(
        triangles, facecolors=_FACES[role], linewidths=0, alpha=_ALPHA[role], shade=True,
        lightsource=load("matplotlib.colors").LightSource(*_LIGHT),
        zorder=list(_FACES).index(role) + 2,
    )  # fmt: skip


def _edges_of_box(vertices: NDArray[np.float64]) -> Any:
    """Return the edges of a box; only the edges of a room are drawn.

    Edges are along the axes: the ends differ in one coordinate.
    """
    first, second = np.triu_indices(len(vertices), 1)
    edge = np.count_nonzero(vertices[first] != vertices[second], axis=1) == 1
    ends = np.stack([vertices[first[edge]], vertices[second[edge]]], axis=1)
    return load("mpl_toolkits.mplot3d.art3d").Line3DCollection(
        ends, colors=FAINT, linewidths=0.8, zorder=2
    )
