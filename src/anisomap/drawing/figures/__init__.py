"""Figures of maps and simulated scenes; matplotlib is imported when the first one is drawn."""

from anisomap.drawing.figures.backend import KINDS, check_writable, figure_bytes, save_figure
from anisomap.drawing.figures.charts import (
    plot_null_test,
    plot_series,
    plot_shepard,
    plot_stress_per_point,
    series_figure,
    stress_figure,
)
from anisomap.drawing.figures.maps import map_figure, plot, plot_distances, plot_map
from anisomap.drawing.figures.sensors import (
    plot_difference,
    plot_layout,
    plot_placement,
    plot_touches,
)

__all__ = [
    "KINDS",
    "check_writable",
    "figure_bytes",
    "map_figure",
    "plot",
    "plot_difference",
    "plot_distances",
    "plot_layout",
    "plot_map",
    "plot_null_test",
    "plot_placement",
    "plot_series",
    "plot_shepard",
    "plot_stress_per_point",
    "plot_touches",
    "save_figure",
    "series_figure",
    "stress_figure",
]
