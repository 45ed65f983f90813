"""The paper in plain numpy, as on its page, gives the metrics and the maps of the package."""

import re
from pathlib import Path

import numpy as np
import pytest

from anisomap import reconstruct
from anisomap.numerics.graph.dissimilarity import information_distance, regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.neighbour_graphs import smallest_connected_neighbour_graph
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from anisomap.paper.cases import METHODS

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "paper-in-numpy.md"
CODE, EXAMPLE = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)


def test_the_example_prints_the_same_scores_twice(capsys):
    exec(CODE + EXAMPLE, {})  # noqa: S102
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [method for method, _, _ in printed] == list(METHODS)
    for _, page, package in printed:
        assert float(page) == pytest.approx(float(package), abs=0.002)


@pytest.mark.parametrize("seed", [0, 1])
def test_metrics_and_maps_are_equal(seed):
    page = {}
    exec(CODE, page)  # noqa: S102
    rng = np.random.default_rng(seed)
    places, contacts = rng.random((24, 2)), rng.random((500, 2))
    distances = np.linalg.norm(contacts[:, None] - places, axis=2)
    touched = (distances < 0.35).astype(int)
    mutual = page["information"](touched)
    of_pairs = np.diag(mutual)[:, None] + np.diag(mutual) - 2 * mutual
    found = (
        page["metricise"](page["reciprocal"](np.corrcoef(touched.T))),
        page["metricise"](page["reciprocal"](mutual)),
        of_pairs,
        page["isomap"](mutual, of_pairs),
    )
    information = mutual_information(touched)
    joined, _ = smallest_connected_neighbour_graph(information)
    apart = information_distance(information)
    expected = (
        metricise(regularised_reciprocal(pearson(touched))),
        metricise(regularised_reciprocal(information)),
        apart,
        metricise(np.where(joined | np.eye(len(apart), dtype=bool), apart, np.inf)),
    )
    for method, ours, theirs in zip(METHODS, found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12, err_msg=method)
        scaled = page["distances"](page["smacof"](ours, 2, iterations=3000))
        mapped = page["distances"](reconstruct(touched, method, 2).positions)
        np.testing.assert_allclose(scaled, mapped, atol=0.01 * mapped.mean(), err_msg=method)
