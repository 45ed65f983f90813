"""How a simulated scene is drawn: body, sensors, what touches them, and what they read."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import NDArray
from PIL import Image

from anisomap.drawing.figures._panels import FAINT, INK, Axes
from anisomap.scene import Mesh, Scene

_FACES = {"ground": "#b7c7a8", "body": "#c9ced4", "stimulus": "#e69f00"}
_ALPHA = {"ground": 0.9, "body": 0.5, "stimulus": 0.35}
_READINGS = "viridis"
_LIGHT = np.array([0.3, -0.5, 0.81])  # where the light comes from
_DARKEST = 0.55
_SHARP = 0.9  # cosine between the faces at an edge that is drawn
_BESIDE = 1.8  # times the extent of all but the ground
_FLAT = 0.4  # of the longest axis: shorter ones have room for two numbers
_FRAMES_A_SECOND = 15


def scene_figure(scene: Scene, frame: int) -> Figure:
    """Draw a frame of a scene, and beside it what every sensor reads over the run."""
    with _style():
        figure = Figure(figsize=(15.0, 5.6), facecolor="white")
        cells = figure.add_gridspec(
            1,
            3,
            width_ratios=(1.15, 1.15, 1),
            left=0.01,
            right=0.94,
            bottom=0.11,
            top=0.84,
            wspace=0.3,
        )
        figure.suptitle(scene.title, x=0.015, ha="left", fontsize=13, fontweight="bold")
        norm = _norm(scene)
        when = f"frame {frame} of {scene.n_frames}, {scene.times[frame]:.2f} s"
        _draw_stage(_space(figure, cells[0], when), scene, frame, norm)
        _draw_stage(
            _space(figure, cells[1], "the body and what its sensors read then"),
            replace(scene, props=tuple(prop for prop in scene.props if prop.role == "body")),
            frame,
            norm,
        )
        _draw_readings(figure.add_subplot(cells[2]), scene, frame, norm)
        return figure


def bodies_figure(title: str, scenes: Sequence[Scene], labels: Sequence[str]) -> Figure:
    """Draw the bodies of several scenes, each sensor as if it were touched."""
    with _style():
        figure = Figure(figsize=(4.0 * len(scenes), 4.6), facecolor="white")
        figure.suptitle(title, x=0.015, ha="left", fontsize=13, fontweight="bold")
        figure.subplots_adjust(left=0.01, right=0.94, bottom=0.08, top=0.86, wspace=0.16)
        for i, (scene, label) in enumerate(zip(scenes, labels, strict=True)):
            alone = replace(
                scene,
                props=tuple(prop for prop in scene.props if prop.role == "body"),
                readings=np.ones_like(scene.readings),
            )
            axes = figure.add_subplot(1, len(scenes), i + 1, projection="3d", computed_zorder=False)
            axes.set_title(label, color=INK)
            _draw_stage(axes, alone, 0, Normalize(0, 1))
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MaxNLocator(2))
        return figure


def animate(
    scene: Scene, path: Path, frames: NDArray[np.intp], tell: Callable[[float], None]
) -> None:
    """Write an animation, as GIF or MP4 by the name of its file."""
    with _style():
        figure = Figure(figsize=(7.2, 6.2), facecolor="white", dpi=72)
        norm = _norm(scene)

        def draw(i: int) -> None:
            figure.clear()
            figure.suptitle(scene.title, x=0.02, ha="left", fontsize=13, fontweight="bold")
            when = f"{scene.times[frames[i]]:.2f} s"
            _draw_stage(_space(figure, 111, when), scene, int(frames[i]), norm)
            tell((i + 1) / len(frames))

        writer = PillowWriter if path.suffix == ".gif" else FFMpegWriter
        FuncAnimation(figure, draw, frames=len(frames), init_func=lambda: None, blit=False).save(
            os.fspath(path), writer=writer(fps=_FRAMES_A_SECOND), dpi=72
        )


def write_pixels(path: Path, images: Sequence[NDArray[np.uint8]]) -> None:
    """Write one image, or several after one another."""
    first, *others = (Image.fromarray(image) for image in images)
    if not others:
        first.save(path)
        return
    duration = 1000 // _FRAMES_A_SECOND
    first.save(path, save_all=True, append_images=others, loop=0, duration=duration)


def can_write_mp4() -> bool:
    """Tell whether there is an ffmpeg for matplotlib to call."""
    return FFMpegWriter.isAvailable()


@contextmanager
def _style() -> Iterator[None]:
    with mpl.rc_context({"font.size": 10, "axes.titlesize": 11, "text.color": INK}):
        yield


def _norm(scene: Scene) -> Normalize:
    return Normalize(0, float(np.nanmax(scene.readings, initial=0)) or 1.0)


def _space(figure: Figure, cell: SubplotSpec | int, title: str) -> Axes:
    axes: Axes = figure.add_subplot(cell, projection="3d", computed_zorder=False)
    axes.set_title(title, color=FAINT)
    return axes


def _draw_readings(axes: Axes, scene: Scene, frame: int, norm: Normalize) -> None:
    shown = axes.imshow(
        scene.readings.T,
        aspect="auto",
        cmap=_READINGS,
        norm=norm,
        interpolation="nearest",
        extent=(0, max(float(scene.times[-1]), 1e-9), scene.readings.shape[1] - 0.5, -0.5),
    )
    axes.axvline(scene.times[frame], color="#d55e00", linewidth=1)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("sensor")
    axes.set_title("what all sensors read over the run", color=FAINT)
    axes.figure.colorbar(shown, ax=axes, label="reading" + _in(scene.units), fraction=0.05)


def _draw_stage(axes: Axes, scene: Scene, frame: int, norm: Normalize) -> None:
    sensors = scene.sensors[frame % len(scene.sensors)]
    shown = np.vstack(
        [
            corners
            for prop in scene.props
            if prop.role != "ground"
            for corners in prop.surfaces(frame)
        ]
    )
    lowest, highest = shown.min(axis=0), shown.max(axis=0)
    for prop in scene.props:
        for corners in prop.surfaces(frame) if prop.role == "room" else ():
            axes.add_collection3d(_edges(prop.mesh, corners))
    for role in _FACES:
        triangles = [
            corners[prop.mesh.faces]
            for prop in scene.props
            if prop.role == role
            for corners in prop.surfaces(frame)
        ]
        if triangles:
            drawn = _near(np.vstack(triangles), lowest, highest)
            axes.add_collection3d(_solid(drawn, role), autolim=False)
    readings = scene.readings[frame]
    axes.scatter(
        *sensors.T,
        c=readings,
        cmap=_READINGS,
        norm=norm,
        s=26,
        edgecolors=INK,
        linewidths=0.4,
        depthshade=False,
        zorder=10,
    )
    axes.set(
        xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), zlim=(lowest[2], highest[2])
    )
    axes.set_box_aspect(np.maximum(highest - lowest, 1e-12), zoom=0.98)
    for name, share in zip("xyz", (highest - lowest) / (highest - lowest).max(), strict=True):
        getattr(axes, f"set_{name}label")(name + _in(scene.units))
        getattr(axes, f"{name}axis").set_pane_color((1.0, 1.0, 1.0))
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4 if share > _FLAT else 2))
    axes.grid(visible=False)


def _near(
    triangles: NDArray[np.float64], lowest: NDArray[np.float64], highest: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Leave out what lies far beside the body: most of a wide ground."""
    middle, half = (lowest + highest)[:2] / 2, (highest - lowest)[:2].max() / 2
    beside = np.abs(triangles[:, :, :2] - middle).max(axis=(1, 2))
    return np.asarray(triangles[beside <= _BESIDE * half])


def _solid(triangles: NDArray[np.float64], role: str) -> Poly3DCollection:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = (1 + normals @ _LIGHT) / 2
    colours = np.empty((len(triangles), 4))
    colours[:, :3] = np.array(to_rgb(_FACES[role])) * (_DARKEST + (1 - _DARKEST) * light[:, None])
    colours[:, 3] = _ALPHA[role]
    layer = list(_FACES).index(role) + 2
    return Poly3DCollection(triangles, facecolors=colours, edgecolors="none", zorder=layer)


def _edges(mesh: Mesh, corners: NDArray[np.float64]) -> Line3DCollection:
    """Give the edges where faces meet at an angle: all that is drawn of a room."""
    faces = corners[mesh.faces]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    whose = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort(sides.T)
    sides, whose = sides[order], whose[order]
    pairs = np.flatnonzero((sides[1:] == sides[:-1]).all(axis=1))
    bent = np.einsum("ed,ed->e", normals[whose[pairs]], normals[whose[pairs + 1]]) < _SHARP
    return Line3DCollection(corners[sides[pairs[bent]]], colors=FAINT, linewidths=0.8, zorder=2)


def _in(units: str) -> str:
    return f" ({units})" if units else ""
