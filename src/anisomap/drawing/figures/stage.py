"""Pictures and animations of simulated scenes: the paper's Figures 5 and 6, for any body."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures import load_drawing
from anisomap.errors import FileError, InputError
from anisomap.files import atomic_write, check_target
from anisomap.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANIMATIONS = ("gif", "mp4")
"""What an animation can be saved as; MP4 needs the program ffmpeg."""

LONGEST_ANIMATION = 150
"""Frames drawn unless asked for more: ten seconds."""


def scene_figure(scene: Scene, frame: int | None = None) -> Figure:
    """Draw a scene: the body with its sensors, what touches them, and all readings.

    Parameters
    ----------
    scene : Scene
    frame : int, optional
        Which frame; that in which most sensors read something unless given.

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
        frame = busiest_frame(scene)
    if not 0 <= frame < scene.n_frames:
        raise InputError(f"there is no frame {frame}; the scene has {scene.n_frames}, from 0")
    figure: Figure = load_drawing("_stage").scene_figure(scene, frame)
    return figure


def bodies_figure(title: str, scenes: Sequence[Scene], labels: Sequence[str]) -> Figure:
    """Draw the bodies of several scenes side by side, with their sensors.

    Parameters
    ----------
    title : str
    scenes : sequence of Scene
        Of each the first frame; what touches the body is left out.
    labels : sequence of str
        One a scene.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there is not one label a scene.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not scenes or len(scenes) != len(labels):
        raise InputError(f"{len(labels)} labels for {len(scenes)} scenes; give one a scene")
    figure: Figure = load_drawing("_stage").bodies_figure(title, scenes, labels)
    return figure


def busiest_frame(scene: Scene) -> int:
    """Find the frame in which most sensors read something."""
    return int(np.argmax((scene.readings > 0).sum(axis=1)))


def save_animation(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    n_frames: int = LONGEST_ANIMATION,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Save the beginning of a scene as a moving picture.

    Parameters
    ----------
    scene : Scene
    path : path-like
        A name that ends in .gif, or in .mp4 where ffmpeg is installed.
    n_frames : int
        How many frames to draw, from the first, at 15 a second.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Raises
    ------
    FileError
        If the name ends otherwise, ffmpeg is wanted and not there, or the file cannot be written.
    MissingExtraError
        If matplotlib is not installed.
    """
    check_animation(path)
    frames = np.arange(min(max(n_frames, 1), scene.n_frames))
    with atomic_write(path) as aside:
        load_drawing("_stage").animate(scene, aside, frames, progress or (lambda _: None))


def save_pixels(path: str | os.PathLike[str], images: Sequence[NDArray[np.uint8]]) -> None:
    """Save rendered images: one as a picture (.png), several as an animation (.gif).

    Parameters
    ----------
    path : path-like
    images : sequence of ndarray of uint8, shape (height, width, 3)

    Raises
    ------
    FileError
        If the name ends otherwise, or the file cannot be written.
    MissingExtraError
        If Pillow, which comes with matplotlib, is not installed.
    """
    kind = "png" if len(images) == 1 else "gif"
    if Path(path).suffix.lower() != f".{kind}":
        raise FileError(f"{path} cannot hold what was rendered; end it with .{kind}")
    with atomic_write(path) as aside:
        load_drawing("_stage").write_pixels(aside, images)


def check_animation(path: str | os.PathLike[str]) -> None:
    """Find out before the work whether an animation could be saved to a file.

    Raises
    ------
    FileError
        See `save_animation`.
    MissingExtraError
        If matplotlib is not installed.
    """
    kind = Path(check_target(path)).suffix.lower().removeprefix(".")
    if kind not in ANIMATIONS:
        raise FileError(f"{path} is no name for an animation; end it with .gif or .mp4")
    if kind == "mp4" and not load_drawing("_stage").can_write_mp4():
        raise FileError(
            f"{path} needs the program ffmpeg, which is not installed; .gif needs nothing"
        )
