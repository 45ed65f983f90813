"""Figures of maps and simulated scenes; matplotlib is imported with the first figure."""

from anisomap.drawing.figures.backend import KINDS as KINDS
from anisomap.drawing.figures.backend import check_writable as check_writable
from anisomap.drawing.figures.backend import figure_bytes as figure_bytes
from anisomap.drawing.figures.backend import save_figure as save_figure
from anisomap.drawing.figures.charts import series_figure as series_figure
from anisomap.drawing.figures.maps import map_figure as map_figure
from anisomap.drawing.figures.maps import plot as plot
from anisomap.drawing.figures.maps import plot_layout as plot_layout
from anisomap.drawing.figures.maps import plot_placement as plot_placement
