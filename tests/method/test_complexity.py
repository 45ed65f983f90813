"""Growth of the work, counted in operations: unlike seconds, independent of the machine."""

from functools import cache

import numpy as np
import pytest
from benchmarks.harness import growth_exponent
from benchmarks.skins.inputs import flat_skin, rubbed_skin

from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import smacof, torgerson
from anisomap.numerics.similarity import co_occurrence
from anisomap.numerics.similarity.binning import maximum_entropy_codes

SIZES = (200, 400, 700)


@pytest.fixture(scope="module")
def skins():
    return {size: flat_skin(size) for size in SIZES}


@pytest.fixture(scope="module")
def metrics(skins):
    return {size: metricise(lengths) for size, lengths in skins.items()}


def test_few_steps_of_lbfgs_reach_the_minimum(metrics):
    flat, bent = [], []
    for metric in metrics.values():
        for needed, dimensions in ((flat, 2), (bent, 3)):
            found = smacof(metric, start=torgerson(metric, dimensions))
            needed.append(int(np.flatnonzero(found.trace <= 1.001 * found.raw_stress)[0]))
    assert max(flat) <= 10
    # A step takes N^2 operations, so that all steps take less than N^3.
    assert growth_exponent(SIZES, bent) < 1


@cache
def meetings(n_sensors, bins):
    """Count pairs of sensors that are on in the same frame."""
    codes = maximum_entropy_codes(rubbed_skin(n_sensors, 2000)[0], bins)
    layout = co_occurrence.Layout.of(co_occurrence.code_counts(codes, int(codes.max()) + 1))
    on = np.count_nonzero(codes != layout.reference, axis=1)
    return float((on.astype(np.float64) ** 2).sum())


def test_where_few_sensors_are_on_bins_cost_nothing():
    assert meetings(100, 2) == meetings(100, 4) == meetings(100, 8)
    sizes = (100, 200, 400)
    assert growth_exponent(sizes, [meetings(n, 4) for n in sizes]) == pytest.approx(2, abs=0.2)
