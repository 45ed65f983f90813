"""Pictures of what grows with the length of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures import load_drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def coverage_figure(
    title: str,
    n_frames: NDArray[np.intp],
    rate_hz: float,
    shares: dict[str, NDArray[np.float64]],
) -> Figure:
    """Draw shares against the length of a recording: their means, and each seed.

    Parameters
    ----------
    title : str
    n_frames : ndarray of int, shape (L,)
        Lengths.
    rate_hz : float
        Frames a second.
    shares : dict of str to ndarray of shape (L, S)
        What each curve is called, and its values from 0 to 1 for S seeds; NaN where there is none.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with `anisomap.drawing.figures.save_figure`.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    figure: Figure = load_drawing("_curves").coverage_figure(title, n_frames, rate_hz, shares)
    return figure
