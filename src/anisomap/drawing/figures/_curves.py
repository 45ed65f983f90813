"""How curves over the length of a recording are drawn."""

from __future__ import annotations

import warnings

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from anisomap.drawing.figures._panels import INK

# Okabe & Ito's colours, which differ for every kind of colour vision; and markers, for none.
_LOOKS = (("#0072b2", "o"), ("#e69f00", "s"), ("#009e73", "^"), ("#cc79a7", "D"))


def coverage_figure(
    title: str,
    n_frames: NDArray[np.intp],
    rate_hz: float,
    shares: dict[str, NDArray[np.float64]],
) -> Figure:
    """See `anisomap.drawing.figures.curves.coverage_figure`."""
    with mpl.rc_context({"font.size": 10, "text.color": INK}):
        figure = Figure(figsize=(7.2, 4.6), facecolor="white", layout="constrained")
        axes = figure.add_subplot()
        for (name, values), (colour, marker) in zip(shares.items(), _LOOKS, strict=False):
            axes.plot(n_frames, values, ".", color=colour, alpha=0.35, markersize=5)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # no seed may have a map yet
                mean = np.nanmean(values, axis=1)
            axes.plot(n_frames, mean, color=colour, marker=marker, label=name)
        axes.set_xscale("log")
        axes.set_xticks(n_frames, [f"{n}\n{n / rate_hz:.3g} s" for n in n_frames])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(-0.03, 1.03)
        axes.grid(color="#d5d9dd", linewidth=0.6)
        axes.set_xlabel("frames, and how long they take")
        axes.set_ylabel("share of all; Mantel r")
        axes.set_title(title, loc="left", fontweight="bold")
        axes.legend(loc="lower right", frameon=False)
        return figure
