"""Charts that compare methods: scores with their nulls, and curves over a parameter.

A method has one colour and one marker wherever it is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.figures import load_drawing
from anisomap.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class MethodLook:
    """How a method is drawn and called in pictures."""

    label: str
    colour: str
    marker: str


# Okabe & Ito's colours, which differ for every kind of colour vision; and markers, for none.
METHOD_LOOKS: Mapping[str, MethodLook] = MappingProxyType(
    {
        "r-anisomap": MethodLook("r-ANISOMAP", "#0072b2", "o"),
        "i-anisomap": MethodLook("I-ANISOMAP", "#e69f00", "s"),
        "information-distance": MethodLook("information distance", "#009e73", "^"),
        "isomap": MethodLook("ISOMAP", "#cc79a7", "D"),
    }
)


@dataclass(frozen=True)
class NullBox:
    """A null distribution as a box plot shows it.

    Parameters
    ----------
    whisker_low, quartile_1, median, quartile_3, whisker_high : float
        Whiskers reach to the furthest values within 1.5 times the distance between the quartiles.
    outliers : tuple of float
        Values to draw beyond the whiskers.
    """

    whisker_low: float
    quartile_1: float
    median: float
    quartile_3: float
    whisker_high: float
    outliers: tuple[float, ...] = ()


@dataclass(frozen=True)
class ScoreGroup:
    """Scores of several methods on one kind of run.

    Parameters
    ----------
    label : str
    scores : mapping of str to sequence of float
        By method, one value a run.
    nulls : mapping of str to NullBox
        By method.
    """

    label: str
    scores: Mapping[str, Sequence[float]]
    nulls: Mapping[str, NullBox]


@dataclass(frozen=True, eq=False)
class CurvePanel:
    """Curves of several methods over a parameter.

    Parameters
    ----------
    title : str
    x : ndarray of shape (L,)
    curves : mapping of str to ndarray of shape (L, S)
        By method, one value a run; NaN where there is none.
    default : float, optional
        The value of the parameter that is used elsewhere.
    """

    title: str
    x: NDArray[np.float64]
    curves: Mapping[str, NDArray[np.float64]]
    default: float | None = None


def scores_figure(title: str, rows: Sequence[Sequence[ScoreGroup]]) -> Figure:
    """Draw scores as dots with their mean, above box plots of their nulls.

    Parameters
    ----------
    title : str
    rows : sequence of sequence of ScoreGroup
        Groups side by side, row by row.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there is nothing to draw.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not any(rows):
        raise InputError("there are no scores to draw")
    figure: Figure = load_drawing("_charts").scores_figure(title, rows)
    return figure


def curves_figure(
    title: str,
    panels: Sequence[CurvePanel],
    *,
    x_label: str,
    y_label: str = "Mantel r",
    logarithmic: bool = False,
    columns: int = 3,
) -> Figure:
    """Draw how scores change with a parameter: means over the runs, and every run.

    Parameters
    ----------
    title : str
    panels : sequence of CurvePanel
    x_label, y_label : str
    logarithmic : bool
        Whether equal ratios of the parameter are equally far apart.
    columns : int
        Panels a row.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there is nothing to draw.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not panels:
        raise InputError("there are no curves to draw")
    figure: Figure = load_drawing("_charts").curves_figure(
        title,
        panels,
        x_label=x_label,
        y_label=y_label,
        logarithmic=logarithmic,
        columns=columns,
    )
    return figure
