"""Growth of the work, counted in operations: unlike seconds, independent of the machine."""

import numpy as np
from benchmarks.harness import growth_exponent
from benchmarks.skins.inputs import flat_skin

from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import smacof, torgerson

SIZES = (200, 400, 700)


def test_few_steps_of_lbfgs_reach_the_minimum():
    flat, bent = [], []
    for metric in map(metricise, map(flat_skin, SIZES)):
        for needed, dimensions in ((flat, 2), (bent, 3)):
            found = smacof(metric, start=torgerson(metric, dimensions))
            needed.append(int(np.flatnonzero(found.trace <= 1.001 * found.raw_stress)[0]))
    assert max(flat) <= 10
    # A step takes N^2 operations, so that all steps take less than N^3.
    assert growth_exponent(SIZES, bent) < 1
