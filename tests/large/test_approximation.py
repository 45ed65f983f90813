"""Approximate maps: agreement with exact maps, and each step against a direct computation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.distance import cdist, pdist

import anisomap
from anisomap import Recording, mantel, reconstruct
from anisomap.errors import AnisomapWarning, InputError
from anisomap.large import reconstruct_approximately
from anisomap.large.approximation import (
    Targets,
    build_similarity_graph,
    paths_from,
    place_component,
    refine,
    stress_of,
    triangulate,
)
from anisomap.large.sensor_graph import (
    ApproximateOptions,
    SensorPairs,
    adjacency_matrix,
    bridge_components,
    build_graph,
    component_labels,
    compute_sketch,
    correlations,
    edge_lengths,
    pairs_of,
)
from anisomap.numerics.compiled import stress as loops
from anisomap.numerics.compiled.parallel import MIN_PARALLEL_ROWS
from anisomap.numerics.graph import neighbour_graphs as search
from anisomap.numerics.graph.neighbour_graphs import NO_SENSOR, all_products, most_similar
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from skins import lattice, rubbed

PLACES = lattice(15, 16)
READINGS = np.round(rubbed(PLACES, 3000) * 40).astype(np.uint8)
FEW = ApproximateOptions(n_candidates=30, n_landmarks=60)

pytestmark = pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")


def made(readings=READINGS, dimensions=2, **options):
    return reconstruct_approximately(readings, dimensions, **{"approximate": FEW, **options})


@pytest.fixture(scope="module")
def found():
    with pytest.warns(AnisomapWarning, match=r"this map is approximate.* 60 landmarks"):
        return made()


def agreement(found, other):
    return mantel(found, other, permutations=0).r


@pytest.mark.parametrize("dimensions", [2, 3])
def test_approximate_maps_resemble_exact_maps(dimensions):
    exact = reconstruct(Recording(READINGS), "r-anisomap", dimensions)
    approximate = made(dimensions=dimensions)
    assert agreement(approximate, exact) > 0.99
    assert agreement(approximate, PLACES) > agreement(exact, PLACES) - 0.01


def test_the_seed_determines_the_map_and_is_recorded(found):
    np.testing.assert_array_equal(made().positions, found.positions)
    facts = dict(found.provenance)
    assert (found.method, found.approximate) == ("r-anisomap", True)
    assert (facts["approximate_n_landmarks"], facts["approximate_seed"]) == (60, 0)
    assert facts["frames"] == len(READINGS)
    other = made(approximate=ApproximateOptions(n_candidates=30, n_landmarks=60, seed=1))
    assert not np.allclose(other.positions, found.positions)
    assert agreement(other, found) > 0.99


def test_chunk_boundaries_and_the_order_of_sensors_do_not_matter(found):
    parts = made(lambda: np.array_split(READINGS, [5, 700, 701, 2000]))
    assert agreement(parts, found) > 1 - 1e-6
    order = np.random.default_rng(0).permutation(len(PLACES))
    shuffled = made(READINGS[:, order])
    assert agreement(shuffled.positions, found.positions[order]) > 0.99


def test_skins_touched_independently_are_components():
    pause = np.zeros_like(READINGS)
    both = np.vstack([np.hstack([READINGS, pause]), np.hstack([pause, READINGS])])
    with pytest.warns(AnisomapWarning, match="2 separate components"):
        pair = made(both)
    np.testing.assert_array_equal(pair.component, np.repeat([0, 1], len(PLACES)))
    for piece in pair.split():
        assert agreement(piece, PLACES) > 0.98


def test_dead_and_dropped_sensors_are_unplaced_and_broken_wires_separate(monkeypatch):
    monkeypatch.setattr("anisomap.large.approximation.EXCERPT_READINGS", 1)
    readings = READINGS.copy()
    readings[:, 7] = 3
    rng = np.random.default_rng(0)
    readings[:, 50] = np.repeat(rng.integers(0, 60, len(readings) // 60), 60)
    names = [f"pad {i}" for i in range(len(PLACES))]
    skin = made(readings, names=names, drop=["pad 9"])
    np.testing.assert_array_equal(np.flatnonzero(~skin.placed), [7, 9])
    assert skin.health[7] == "silent"
    assert skin.health[50] == "isolated"
    assert skin.component[50] == 1
    assert len(skin.component_sizes) == 2
    assert skin.names == tuple(names)


def test_missing_readings_follow_the_policy():
    readings = READINGS.astype(np.float32)
    readings[100, 3] = np.nan
    with pytest.raises(InputError, match="sensor 3 in frame 100"):
        made(readings)
    expected = made(np.delete(readings, 100, axis=0)).positions
    np.testing.assert_array_equal(made(readings, missing="drop-frames").positions, expected)


@pytest.mark.parametrize(
    ("readings", "options", "message"),
    [
        (np.zeros((50, 9), np.uint8), {}, "got 0 of 9"),
        (list, {}, "no frames"),
        (np.random.default_rng(0).integers(0, 9, (300, 9)), {}, "at least 3 sensors with statist"),
        (READINGS[0], {}, "frames x sensors"),
        (READINGS, {"dimensions": 0}, "dimensions must be a whole number of at least 1"),
    ],
)
def test_what_gives_no_map_is_refused(readings, options, message):
    with pytest.raises(InputError, match=message):
        made(readings, **options)


def test_health_of_many_sensors_is_assessed_from_an_excerpt(monkeypatch):
    monkeypatch.setattr("anisomap.large.approximation.EXCERPT_READINGS", 1)
    found = build_similarity_graph(lambda: np.array_split(READINGS, 40), options=FEW)
    whole = anisomap.assess(Recording(READINGS))
    assert 500 <= found.excerpt.n_frames < len(READINGS)
    assert {sensor.status for sensor in found.health} == {"ok"}
    contacts = [[sensor.contacts for sensor in health] for health in (found.health, whole)]
    at_rest = READINGS[0] == 0
    np.testing.assert_array_equal(*np.array(contacts)[:, at_rest])


def test_mantel_r_of_very_many_sensors_uses_a_sample(found, monkeypatch):
    everyone = anisomap.score(found, PLACES, permutations=0)
    monkeypatch.setattr("anisomap.evaluation.scoring.MAX_ALL_PAIRS", 100)
    monkeypatch.setattr("anisomap.evaluation.scoring.SAMPLED", 90)
    sample = anisomap.score(found, PLACES, permutations=0)
    assert sample.mantel.n_sensors == 90
    assert sample.mantel.r == pytest.approx(everyone.mantel.r, abs=0.01)
    assert sample.rms == everyone.rms
    assert any("90 of the 240 sensors" in note for note in sample.notes)
    assert anisomap.score(found, PLACES, permutations=0).mantel.r == sample.mantel.r


RNG = np.random.default_rng
SKIN = np.round(rubbed(lattice(), 600) * 40)


SEEDS = st.integers(0, 2**32 - 1)


def all_pairs(n_sensors):
    """Indices of all pairs."""
    return np.triu_indices(n_sensors, 1)


def in_chunks(readings, cuts):
    return [part for part in np.split(readings, sorted(cuts)) if len(part)]


def sketched(readings, size=256, seed=0, cuts=()):
    return compute_sketch(in_chunks(readings, cuts), size, RNG(seed))


def linked(readings):
    """Return r of all pairs, and the sketch."""
    known = sketched(readings)
    return correlations([readings], known, all_pairs(readings.shape[1])), known


@settings(max_examples=40)
@given(SEEDS, st.lists(st.integers(1, 59), max_size=4))
def test_a_sketch_does_not_depend_on_the_chunks(seed, cuts):
    rng = RNG(seed)
    readings = rng.integers(-3, 4, (60, 5)).astype(float) + rng.normal(0, 100, 5)
    whole = sketched(readings, 16, seed)
    parts = sketched(readings, 16, seed, cuts)
    np.testing.assert_allclose(whole.mean, readings.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(whole.deviation, readings.std(axis=0), rtol=1e-9)
    np.testing.assert_array_equal(whole.varying, np.ptp(readings, axis=0) > 0)
    np.testing.assert_array_equal(parts.contacts, whole.contacts)
    np.testing.assert_array_equal(parts.active_frames, whole.active_frames)
    np.testing.assert_allclose(parts.projections, whole.projections, atol=1e-5)


def test_contacts_are_counted_on_both_sides_of_rest():
    touched = np.tile([0, 0, 5, 7, 0, 0, 3, 0, 0, 0], 4)[:, None]
    for side in (1, -1):
        known = sketched(100 + side * touched)
        assert known.contacts == 8
        assert known.active_frames == 12


@pytest.mark.parametrize(
    ("n_sensors", "queries", "count"),
    [
        (30, range(30), 1),
        (30, [3, 11, 29], 5),
        (30, range(30), 30),
        (search.COLUMNS + 500, range(0, search.COLUMNS, 7), 3),  # several blocks
    ],
)
@pytest.mark.parametrize("group_size", [1, 7])
def test_the_most_similar_have_the_greatest_products(n_sensors, queries, count, group_size):
    rows = RNG(0).normal(size=(n_sensors, 8)).astype(np.float32)
    groups = np.arange(n_sensors) // group_size
    products = rows[queries] @ rows.T
    products[groups[queries][:, None] == groups] = -np.inf
    expected = np.sort(products, axis=1)[:, ::-1][:, :count]
    found, values = most_similar(rows, count, groups=groups, sensors=np.array(queries))
    known = all_products(rows)
    again = most_similar(rows, count, groups=groups, sensors=np.array(queries), whole=known)
    np.testing.assert_allclose(again[1], values, atol=1e-5)
    np.testing.assert_allclose(values, expected, atol=1e-5)
    there = found != NO_SENSOR
    np.testing.assert_array_equal(there, np.isfinite(expected))
    mine = np.take_along_axis(products, np.maximum(found, 0), axis=1)
    np.testing.assert_allclose(mine[there], expected[there], atol=1e-5)


@settings(max_examples=40)
@given(SEEDS, st.lists(st.integers(1, 599), max_size=3))
def test_r_of_pairs_is_pearsons(seed, cuts):
    rng = RNG(seed)
    readings = SKIN[:, :12] + 1000 * rng.integers(0, 2, 12)
    readings[:, 3] = 7
    found = correlations(in_chunks(readings, cuts), sketched(readings), all_pairs(12))
    with np.errstate(invalid="ignore"):
        expected = np.nan_to_num(np.corrcoef(readings.T))
    np.testing.assert_allclose(found.r, expected[all_pairs(12)], atol=2e-6)


def test_rigid_plates_are_linked():
    rng = RNG(0)
    plates = rubbed(np.arange(6.0)[:, None] * [1, 0], 4000)
    readings = np.repeat(plates, 30, axis=1) + 0.02 * rng.normal(size=(4000, 180))
    known = sketched(readings, 512)
    found, _ = most_similar(known.projections, 20)
    apart = build_graph(correlations([readings], known, pairs_of(found)), known, 10)
    assert component_labels(apart, 180).max() == 5
    _, component, _ = bridge_components(apart, known, lambda: [readings])
    assert component.max() == 0


@settings(max_examples=40)
@given(SEEDS, st.integers(1, 9))
def test_paths_are_dijkstras(seed, degree):
    rng = RNG(seed)
    n_nodes = 60
    ends = rng.integers(0, n_nodes, (2, degree * n_nodes // 2))
    firsts, seconds = pairs_of(ends[1][:, None], ends[0])
    apart = firsts < seconds
    edges = SensorPairs(firsts[apart], seconds[apart], np.ones(apart.sum()))
    graph = adjacency_matrix(edges, rng.uniform(0.1, 3, len(edges.r)), n_nodes)
    sources = rng.choice(n_nodes, 7, replace=False)
    expected = dijkstra(graph, directed=False, indices=sources).T
    np.testing.assert_allclose(paths_from(sources, graph), expected, rtol=1e-5)


@settings(max_examples=40)
@given(SEEDS, st.integers(1, 4))
def test_triangulation_of_euclidean_distances_is_exact(seed, dimensions):
    points = RNG(seed).normal(size=(40, dimensions))
    landmarks = points[:12] + 3  # their own frame
    rows = cdist(points, points[:12]).astype(np.float32)
    np.testing.assert_allclose(triangulate(rows, landmarks), points + 3, atol=1e-3)


def test_the_stress_of_landmark_pairs_and_its_gradient():
    rng = RNG(0)
    points, anchors = rng.normal(size=(2, 20)), rng.normal(size=(2, 7))
    points[:, 5] = anchors[:, 3]  # they coincide
    targets = rng.uniform(0.5, 2, (20, 7))
    slope, pulled = np.zeros((2, 20)), np.zeros((2, 7))
    single = [array.astype(np.float32) for array in (points, anchors, targets)]
    raw = loops.add_rows_stress(*single, (0, 20), (slope, pulled))
    distances = cdist(points.T, anchors.T)
    assert raw == pytest.approx(((distances - targets) ** 2).sum(), rel=1e-5)
    share = (distances - targets) / np.maximum(distances, 1e-9)
    assert (share < -1e8).sum() == 1
    away = points[:, :, None] - anchors[:, None]
    np.testing.assert_allclose(slope, (share * away).sum(axis=2), atol=1e-5)
    np.testing.assert_allclose(pulled, -(share * away).sum(axis=1), atol=1e-5)


def exact_targets(n_landmarks, noise=0.0):
    rng = RNG(1)
    points = rng.uniform(0, 10, (300, 2))
    apart = cdist(points, points)
    landmarks = np.arange(n_landmarks)
    pairs = np.argsort(apart, axis=1)[:, 1:7]
    firsts, seconds = pairs_of(pairs)
    edges = SensorPairs(firsts, seconds, np.ones(len(firsts)))
    graph = adjacency_matrix(edges, apart[firsts, seconds], 300)
    rows = apart[:, :n_landmarks] * rng.uniform(1 - noise, 1 + noise, (300, n_landmarks))
    return points, Targets(landmarks, rows.astype(np.float32), graph)


def test_refinement_decreases_the_stress_and_recovers_points_from_their_distances():
    points, targets = exact_targets(40, noise=0.2)
    start = points + RNG(0).normal(0, 2, points.shape)
    found = refine(targets, start, 1e-7, 300)
    assert (np.diff(found.trace) <= 0).all()
    assert found.converged
    assert stress_of(targets, found.positions)[0] < stress_of(targets, start)[0] / 5
    points, targets = exact_targets(40)
    found = refine(targets, points + 0.3 * np.sin(9 * points), 1e-12, 1000)
    np.testing.assert_allclose(pdist(found.positions), pdist(points), atol=2e-3)


def test_with_all_sensors_as_landmarks_the_map_is_exact():
    links, known = linked(SKIN)
    edges = build_graph(links, known, 20)
    graph = adjacency_matrix(edges, edge_lengths(links, edges, 1.0), 42)
    assert connected_components(graph)[0] == 1
    options = {"n_landmarks": 1000, "options": SmacofOptions(), "rng": RNG(0)}
    found = place_component(graph, 2, **options)
    expected = smacof(dijkstra(graph, directed=False), dimensions=2)
    r = np.corrcoef(pdist(found.positions), pdist(expected.positions))[0, 1]
    assert r > 0.99999
    stress = np.sqrt(found.raw_stress / found.spread)
    assert stress == pytest.approx(expected.stress, rel=0.01)
    single = place_component(graph[:1, :1], 3, **options)
    np.testing.assert_array_equal(single.positions, np.zeros((1, 3)))


def test_the_number_of_threads_does_not_change_a_bit(monkeypatch):
    readings = np.round(rubbed(lattice(30, 50), 100) * 40)
    assert readings.shape[1] >= MIN_PARALLEL_ROWS

    def positions(n_threads):
        monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", n_threads)
        sketch = sketched(readings)
        found, _ = most_similar(sketch.projections, 20)
        pairs = correlations([readings], sketch, pairs_of(found))
        edges = build_graph(pairs, sketch, 12)
        n_sensors = readings.shape[1]
        graph = adjacency_matrix(edges, edge_lengths(pairs, edges, 1.0), n_sensors)
        members = np.flatnonzero(component_labels(edges, n_sensors) == 0)
        options = SmacofOptions(max_iterations=20)
        return place_component(
            graph[members][:, members], 3, n_landmarks=20, options=options, rng=RNG(0)
        ).positions

    np.testing.assert_array_equal(positions(3), positions(1))


TOO_SMALL = {"n_neighbours": 2, "n_candidates": 10, "sketch_size": 4, "n_landmarks": 3, "seed": -1}


@pytest.mark.parametrize(("name", "value"), TOO_SMALL.items())
def test_options_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name} must be an integer of at least"):
        ApproximateOptions(**{name: value})
