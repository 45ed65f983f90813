"""The steps of approximate maps: each by what holds of it, or against the plain way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.distance import cdist, pdist

from anisomap.errors import InputError
from anisomap.large.landmarks import landmark_kernels
from anisomap.large.landmarks.correlations import SensorPairs, correlations, pairs_of
from anisomap.large.landmarks.landmark_mds import paths_from, place_component, triangulate
from anisomap.large.landmarks.landmark_stress import Targets, refine, stress_of
from anisomap.large.landmarks.options import ApproximateOptions
from anisomap.large.landmarks.sensor_graph import (
    adjacency_matrix,
    bridge_components,
    build_graph,
    edge_lengths,
)
from anisomap.large.landmarks.sketch import compute_sketch
from anisomap.numerics.compiled import parallel
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions, smacof
from anisomap.numerics.similarity.search import NO_SENSOR, most_similar
from skins import lattice, rubbed

RNG = np.random.default_rng
SKIN = np.round(rubbed(lattice(), 600) * 40)


def everyone(n_sensors):
    """List all pairs."""
    return np.triu_indices(n_sensors, 1)


def sketched(readings, size=256, seed=0):
    return compute_sketch([readings], size, np.random.default_rng(seed))


def linked(readings):
    """Give r of all pairs, and what else one pass tells."""
    known = sketched(readings)
    return correlations([readings], known, everyone(readings.shape[1])), known


@settings(deadline=None)  # the first call may compile
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 59), max_size=4))
def test_a_sketch_does_not_depend_on_how_frames_are_cut(seed, cuts):
    rng = np.random.default_rng(seed)
    readings = rng.integers(-3, 4, (60, 5)).astype(float) + rng.normal(0, 100, 5)
    whole = sketched(readings, 16, seed)
    parts = compute_sketch(
        [part for part in np.split(readings, sorted(cuts)) if len(part)],
        16,
        np.random.default_rng(seed),
    )
    np.testing.assert_allclose(whole.mean, readings.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(whole.deviation, readings.std(axis=0), rtol=1e-9)
    np.testing.assert_array_equal(whole.varying, np.ptp(readings, axis=0) > 0)
    np.testing.assert_array_equal(parts.contacts, whole.contacts)
    np.testing.assert_array_equal(parts.active_frames, whole.active_frames)
    np.testing.assert_allclose(parts.projections, whole.projections, atol=1e-5)


def test_products_of_sketches_are_r_on_average_and_err_as_little_as_they_should():
    size, expected = 64, np.corrcoef(SKIN.T)
    found = np.array([sketched(SKIN, size, seed).projections for seed in range(300)])
    products = found @ found.transpose(0, 2, 1)
    bound = np.sqrt((1 + expected**2) / size)
    np.testing.assert_allclose(products.mean(axis=0), expected, atol=5 * bound.max() / 300**0.5)
    pairs = everyone(len(expected))
    assert (products.std(axis=0)[pairs] < 1.2 * bound[pairs]).all()


def test_contacts_are_counted_on_either_side_of_rest():
    touched = np.tile([0, 0, 5, 7, 0, 0, 3, 0, 0, 0], 4)[:, None]
    for side in (1, -1):
        known = sketched(100 + side * touched)
        assert known.contacts == 8
        assert known.active_frames == 12


@pytest.mark.parametrize("count", [1, 5, 30])
@pytest.mark.parametrize("grouped", [False, True])
def test_the_most_alike_are_those_with_the_greatest_products(monkeypatch, count, grouped):
    rows = np.random.default_rng(0).normal(size=(30, 8)).astype(np.float32)
    groups = np.arange(30) // 7 if grouped else np.arange(30)
    products = rows @ rows.T
    products[groups[:, None] == groups] = -np.inf
    expected = np.sort(products, axis=1)[:, ::-1][:, :count]
    monkeypatch.setattr("anisomap.numerics.similarity.search.ROWS", 4)
    monkeypatch.setattr("anisomap.numerics.similarity.search.COLUMNS", 9)
    found, values = most_similar(rows, count, groups=groups)
    np.testing.assert_allclose(values, expected, atol=1e-5)
    there = found != NO_SENSOR
    np.testing.assert_array_equal(there, np.isfinite(expected))
    mine = np.take_along_axis(products, np.maximum(found, 0), axis=1)
    np.testing.assert_allclose(mine[there], expected[there], atol=1e-5)
    some = np.array([3, 11, 29])
    np.testing.assert_array_equal(
        most_similar(rows, count, groups=groups, sensors=some)[0], found[some]
    )


@settings(deadline=None)  # the first call may compile
@given(st.integers(0, 2**32 - 1))
def test_pairs_are_listed_once(seed):
    found = np.random.default_rng(seed).integers(-1, 9, (9, 4))
    firsts, seconds = pairs_of(found)
    expected = {tuple(sorted((i, j))) for i in range(9) for j in found[i] if j != NO_SENSOR}
    assert list(zip(firsts.tolist(), seconds.tolist(), strict=True)) == sorted(expected)


@settings(deadline=None)  # the first call may compile
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 599), max_size=3))
def test_r_of_pairs_is_pearsons(seed, cuts):
    rng = np.random.default_rng(seed)
    readings = SKIN[:, :12] + 1000 * rng.integers(0, 2, 12)
    readings[:, 3] = 7
    chunks = [part for part in np.split(readings, sorted(cuts)) if len(part)]
    found = correlations(chunks, sketched(readings), everyone(12))
    with np.errstate(invalid="ignore"):
        expected = np.nan_to_num(np.corrcoef(readings.T))
    np.testing.assert_allclose(found.r, expected[everyone(12)], atol=2e-6)


def test_a_skin_hangs_together_and_a_broken_wire_does_not_bind_it():
    rng = np.random.default_rng(0)
    broken = rng.integers(0, 5, (len(SKIN), 3))
    readings = np.hstack([SKIN, broken, np.zeros((len(SKIN), 1))])
    graph = build_graph(*linked(readings), n_neighbours=8)
    np.testing.assert_array_equal(graph.component[:42], 0)
    assert set(graph.component[42:]) == {1, 2, 3, 4}


def test_skins_that_were_touched_apart_are_pieces():
    pause = np.zeros_like(SKIN)
    readings = np.vstack([np.hstack([SKIN, pause]), np.hstack([pause, SKIN])])
    links, known = linked(readings)
    graph, further = bridge_components(build_graph(links, known, 8), known, lambda: [readings])
    np.testing.assert_array_equal(graph.component, np.repeat([0, 1], 42))
    assert further.r.size
    assert (further.r < 0.1).all()


def test_rigid_plates_are_joined_by_what_they_have_in_common():
    rng = np.random.default_rng(0)
    plates = rubbed(np.arange(6.0)[:, None] * [1, 0], 4000)
    readings = np.repeat(plates, 30, axis=1) + 0.02 * rng.normal(size=(4000, 180))
    known = sketched(readings, 512)
    found, _ = most_similar(known.projections, 20)
    apart = build_graph(correlations([readings], known, pairs_of(found)), known, 10)
    assert apart.component.max() == 5
    together, _ = bridge_components(apart, known, lambda: [readings])
    assert together.component.max() == 0


def test_rows_of_paths_are_those_of_the_exact_metric_if_all_pairs_are_edges():
    links, _ = linked(SKIN)
    positive = links.select(links.r > 0)
    graph = adjacency_matrix(positive, edge_lengths(links, positive, mu=0.0), 42)
    similarity = np.zeros((42, 42))
    similarity[links.firsts, links.seconds] = links.r
    expected = metricise(regularised_reciprocal(similarity + similarity.T, mu=0.0))
    landmarks = np.array([30, 2, 17])
    found = paths_from(landmarks, graph)
    np.testing.assert_allclose(found, expected[:, landmarks], rtol=1e-5)


@settings(deadline=None)  # the first call may compile
@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_paths_are_dijkstras(seed, degree):
    rng = np.random.default_rng(seed)
    n_nodes = 60
    ends = rng.integers(0, n_nodes, (2, degree * n_nodes // 2))
    firsts, seconds = pairs_of(ends[1][:, None], ends[0])
    apart = firsts < seconds
    edges = SensorPairs(firsts[apart], seconds[apart], np.ones(apart.sum()))
    graph = adjacency_matrix(edges, rng.uniform(0.1, 3, len(edges.r)), n_nodes)
    sources = rng.choice(n_nodes, 7, replace=False)
    expected = dijkstra(graph, directed=False, indices=sources).T
    np.testing.assert_allclose(paths_from(sources, graph), expected, rtol=1e-5)


@settings(deadline=None)  # the first call may compile
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_triangulation_is_exact_of_distances_between_points(seed, dimensions):
    points = np.random.default_rng(seed).normal(size=(40, dimensions))
    landmarks = points[:12] + 3  # their own frame
    rows = cdist(points, points[:12]).astype(np.float32)
    np.testing.assert_allclose(triangulate(rows, landmarks), points + 3, atol=1e-3)


def test_the_stress_of_rows_and_its_gradient():
    rng = np.random.default_rng(0)
    points, anchors = rng.normal(size=(2, 20)), rng.normal(size=(2, 7))
    points[:, 5] = anchors[:, 3]  # they coincide
    targets = rng.uniform(0.5, 2, (20, 7))
    slope, pulled = np.zeros((2, 20)), np.zeros((2, 7))
    single = [array.astype(np.float32) for array in (points, anchors, targets)]
    raw = landmark_kernels.add_rows_stress(*single, (0, 20), (slope, pulled))
    distances = cdist(points.T, anchors.T)
    assert raw == pytest.approx(((distances - targets) ** 2).sum(), rel=1e-5)
    share = (distances - targets) / np.maximum(distances, 1e-9)
    assert (share < -1e8).sum() == 1
    away = points[:, :, None] - anchors[:, None]
    np.testing.assert_allclose(slope, (share * away).sum(axis=2), atol=1e-5)
    np.testing.assert_allclose(pulled, -(share * away).sum(axis=1), atol=1e-5)


def exact_targets(n_landmarks, noise=0.0):
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 10, (300, 2))
    apart = cdist(points, points)
    landmarks = np.arange(n_landmarks)
    pairs = np.argsort(apart, axis=1)[:, 1:7]
    firsts, seconds = pairs_of(pairs)
    edges = SensorPairs(firsts, seconds, np.ones(len(firsts)))
    graph = adjacency_matrix(edges, apart[firsts, seconds], 300)
    rows = apart[:, :n_landmarks] * rng.uniform(1 - noise, 1 + noise, (300, n_landmarks))
    return points, Targets(landmarks, rows.astype(np.float32), graph)


def test_refining_never_raises_the_stress():
    points, targets = exact_targets(40, noise=0.2)
    start = points + np.random.default_rng(0).normal(0, 2, points.shape)
    found = refine(targets, start, 1e-7, 300)
    assert (np.diff(found.trace) <= 0).all()
    assert found.converged
    assert stress_of(targets, found.positions)[0] < stress_of(targets, start)[0] / 5


def test_refining_finds_points_by_their_distances():
    points, targets = exact_targets(40)
    found = refine(targets, points + 0.3 * np.sin(9 * points), 1e-12, 1000)
    np.testing.assert_allclose(pdist(found.positions), pdist(points), atol=2e-3)


def test_if_all_sensors_are_landmarks_the_map_is_that_of_the_exact_metric():
    links, known = linked(SKIN)
    edges = build_graph(links, known, 20).edges
    graph = adjacency_matrix(edges, edge_lengths(links, edges, 1.0), 42)
    assert connected_components(graph)[0] == 1
    found = place_component(
        graph, 2, n_landmarks=1000, options=SmacofOptions(), rng=np.random.default_rng(0)
    )
    expected = smacof(dijkstra(graph, directed=False), dimensions=2)
    r = np.corrcoef(pdist(found.positions), pdist(expected.positions))[0, 1]
    assert r > 0.99999
    stress = np.sqrt(found.raw_stress / found.spread)
    assert stress == pytest.approx(expected.stress, rel=0.01)


def test_a_single_sensor_has_a_place():
    nothing = SensorPairs(*everyone(1), np.empty(0))
    graph = adjacency_matrix(nothing, np.empty(0), 1)
    found = place_component(
        graph, 3, n_landmarks=10, options=SmacofOptions(), rng=np.random.default_rng(0)
    )
    np.testing.assert_array_equal(found.positions, np.zeros((1, 3)))


def test_threads_share_the_work_without_changing_a_bit(monkeypatch):
    def everything():
        known = sketched(SKIN)
        found, _ = most_similar(known.projections, 20)
        links = correlations([SKIN], known, pairs_of(found))
        edges = build_graph(links, known, 12).edges
        graph = adjacency_matrix(edges, edge_lengths(links, edges, 1.0), 42)
        rng = np.random.default_rng(0)
        return place_component(graph, 3, n_landmarks=20, options=SmacofOptions(), rng=rng).positions

    alone = everything()
    monkeypatch.setattr(parallel, "MIN_PARALLEL_ROWS", 1)
    monkeypatch.setattr(parallel, "thread_count", lambda: 3)
    np.testing.assert_array_equal(everything(), alone)


@pytest.mark.parametrize(
    "options",
    [
        {"n_neighbours": 2},
        {"n_candidates": 10},
        {"sketch_size": 4},
        {"n_landmarks": 3},
        {"seed": -1},
    ],
)
def test_options_out_of_range_are_refused(options):
    with pytest.raises(InputError, match=f"{next(iter(options))} must be at least"):
        ApproximateOptions(**options)


def test_no_frame_is_no_map():
    with pytest.raises(InputError, match="no frames"):
        compute_sketch([], 16, np.random.default_rng(0))
