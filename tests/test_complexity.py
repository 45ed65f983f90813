"""How the work grows, in operations, not in seconds: these do not depend on the machine."""

import numpy as np
import pytest
from benchmarks.inputs import flat_skin, stroked_skin
from benchmarks.tables import growth_exponent
from scipy.sparse.linalg import LinearOperator, eigsh

from anisomap.numerics.graph import shortest_paths
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling import classical
from anisomap.numerics.scaling.classical import torgerson
from anisomap.numerics.scaling.stress_minimisation import smacof
from anisomap.numerics.similarity import co_occurrence
from anisomap.numerics.similarity.binning import maximum_entropy_codes

SIZES = (400, 700, 1000)


@pytest.fixture(scope="module")
def skins():
    return {size: flat_skin(size) for size in SIZES}


@pytest.fixture(scope="module")
def metrics(skins):
    return {size: metricise(lengths) for size, lengths in skins.items()}


def test_of_a_skin_a_few_edges_a_sensor_are_followed(skins, monkeypatch):
    followed = []
    relax = shortest_paths._relax

    def counted(paths, order, edges, *more):
        followed.append(len(edges.ends))
        relax(paths, order, edges, *more)

    monkeypatch.setattr(shortest_paths, "_relax", counted)
    monkeypatch.setattr(shortest_paths, "through_all_nodes", None)  # would be N^3
    for lengths in skins.values():
        shortest_paths.shortest_paths(lengths)
    essential = followed[1::2]
    assert max(essential) / SIZES[-1] < 50
    assert growth_exponent(SIZES, essential) < 1.3


def test_few_steps_of_lbfgs_lead_near_the_best(metrics):
    flat, bent = [], []
    for metric in metrics.values():
        for needed, dimensions in ((flat, 2), (bent, 3)):
            found = smacof(metric, start=torgerson(metric, dimensions))
            needed.append(int(np.flatnonzero(found.trace <= 1.001 * found.raw_stress)[0]))
    assert max(flat) <= 10
    # A step goes over all pairs: the whole stays below N^3, where shortest paths in general are.
    assert growth_exponent(SIZES, bent) < 1


def test_torgerson_takes_a_number_of_products_that_hardly_grows(metrics, monkeypatch):
    products = []

    def counted(operator, **options):
        def multiply(vector):
            products[-1] += 1
            return operator.matvec(vector)

        return eigsh(LinearOperator(operator.shape, multiply, dtype=operator.dtype), **options)

    monkeypatch.setattr(classical, "eigsh", counted)
    for metric in metrics.values():
        products.append(0)
        torgerson(metric, 3)
    assert min(products) > 0
    assert max(products) < 100


def laid_out(n_sensors, bins):
    codes = maximum_entropy_codes(stroked_skin(n_sensors, 2000)[0], bins)
    counts = co_occurrence.code_counts(codes, int(codes.max()) + 1)
    return codes, co_occurrence.Layout.of(counts)


def meetings(n_sensors, bins):
    """Steps from entry to entry: pairs of sensors that are on in the same frame."""
    codes, layout = laid_out(n_sensors, bins)
    on = np.count_nonzero(codes != layout.reference, axis=1)
    listed = co_occurrence._entries(codes, layout)
    assert len(listed[0]) == on.sum()
    return float((on.astype(np.float64) ** 2).sum())


def words(n_sensors, bins):
    """Words of bits that are counted if every series meets every other."""
    codes, layout = laid_out(n_sensors, bins)
    bits = co_occurrence._bits(codes, layout)
    return float(len(bits)) ** 2 / 2 * bits.shape[1]


def test_where_few_sensors_are_on_bins_cost_nothing():
    assert meetings(200, 2) == meetings(200, 4) == meetings(200, 8)
    sizes = (100, 200, 400)
    assert growth_exponent(sizes, [meetings(n, 4) for n in sizes]) == pytest.approx(2, abs=0.2)


def test_words_of_bits_grow_as_pairs_of_series():
    assert [words(100, bins) / words(100, 2) for bins in (2, 4, 8)] == [1, 9, 49]
    sizes = (100, 200, 400)
    assert growth_exponent(sizes, [words(n, 4) for n in sizes]) == pytest.approx(2)
