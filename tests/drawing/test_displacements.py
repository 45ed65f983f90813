"""Figures of differences between maps and of placed maps."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from anisomap.drawing.figures import (
    difference_figure,
    figure_bytes,
    placement_figure,
    plot_difference,
    plot_placement,
)
from anisomap.errors import InputError
from anisomap.evaluation import compare_maps
from anisomap.placement import Anchors, place
from anisomap.scene import Mesh
from anisomap.sensor_map import SensorMap

mpl.use("agg")

POINTS = np.random.default_rng(0).normal(size=(30, 3))
NAMES = ("$\\frac{$", "日本", "line\nbreak", *(f"s{i}" for i in range(3, 30)))


def difference(k):
    after = POINTS[:, :k] + np.random.default_rng(1).normal(0, 0.01, (30, k))
    after[:2] += 5
    after[4] = np.nan
    before = np.where(np.arange(30)[:, None] == 5, np.nan, POINTS[:, :k])
    return compare_maps(SensorMap(before, names=NAMES), SensorMap(after, names=NAMES))


@pytest.mark.parametrize("k", [2, 3])
def test_moved_sensors_have_arrows_to_where_they_are_now(k):
    found = difference(k)
    figure = Figure()
    axes = plot_difference(found, ax=figure.add_subplot(projection="3d" if k == 3 else None))
    labels = axes.get_legend_handles_labels()[1]
    assert labels == ["unchanged (26)", "moved (2)", "lost (1)", "appeared (1)"]
    assert axes.get_aspect() in (1.0, "equal")
    for limits, values in zip(
        [axes.get_xlim(), axes.get_ylim()], found.after[found.moved].T, strict=False
    ):
        assert limits[0] <= values.min() <= values.max() <= limits[1]
    assert figure_bytes(difference_figure(found)) == figure_bytes(difference_figure(found))


@pytest.mark.parametrize("k", [2, 3])
def test_a_placement_shows_its_anchors(k):
    rows = [0, 1, 2, 9, 17, 20]
    anchors = Anchors(tuple(NAMES[i] for i in rows), POINTS[rows, :k])
    placement = place(SensorMap(3 * POINTS[:, :k], names=NAMES), anchors)
    mesh = Mesh(POINTS[:3], [[0, 1, 2]]) if k == 3 else None
    axes = plot_placement(placement, anchors, mesh)
    assert axes.get_legend_handles_labels()[1] == ["placed (24)", "anchors (6)"]
    assert figure_bytes(placement_figure(placement, anchors, mesh))
    with pytest.raises(InputError, match="axes"):
        plot_placement(placement, ax=Figure().add_subplot(projection="3d" if k == 2 else None))
