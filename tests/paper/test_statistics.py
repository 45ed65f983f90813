"""Scores, responses and shapes in the experiments."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap import Recording, reconstruct
from anisomap.paper import Settings
from anisomap.paper.cases import METHODS
from anisomap.paper.map_scores import SCORE_COLUMNS, SMACOF, map_and_score, null_box, score_rows
from anisomap.paper.reach import reach_of, touch
from anisomap.paper.shapes import cylinder_shape, isolation, sphericity
from anisomap.paper.similarities import PAIR_COLUMNS, pair_rows, radial_basis
from anisomap.simulation import find_body
from skins import flat_skin

pytest.importorskip("matplotlib")

CYLINDER = find_body("cylinder").positions
PAIRS_AXIAL = [*PAIR_COLUMNS].index("axial")


def simulated(body, readings):
    return Recording(readings, positions=body.positions)


def rows_of(recording):
    return list(pair_rows("a run", recording, 1, 3, 1.0))


def test_box_plots_keep_every_value_beyond_the_whiskers():
    recording = flat_skin(n_frames=300)
    row = next(score_rows(str, recording, 1, [2], Settings()))
    box = null_box(dict(zip(SCORE_COLUMNS, row, strict=True)))
    null = map_and_score(recording, METHODS[0], 2, permutations=10_000).score.mantel.null
    first, third = np.quantile(null, (0.25, 0.75))
    beyond = np.abs(null - (first + third) / 2) > 2 * (third - first)  # 1.5 from either quartile
    assert beyond.sum() > 10
    np.testing.assert_allclose(box["fliers"], np.sort(null[beyond]), atol=1e-4)
    assert (box["whislo"], box["whishi"]) == (null[~beyond].min(), null[~beyond].max())


@pytest.mark.parametrize("method", METHODS)
def test_maps_of_the_reproduction_are_those_of_the_methods(method):
    recording = flat_skin(n_frames=300)
    for dimensions in (2, 3):
        ours = reconstruct(recording, method, dimensions)
        theirs = map_and_score(recording, method, dimensions).sensor_map
        assert ours.provenance["solver"] == theirs.provenance["solver"] == SMACOF.solver
        np.testing.assert_allclose(ours.positions, theirs.positions, atol=1e-9)


@pytest.mark.parametrize("quantile", [0.25, 0.5, 1.0])
def test_radial_basis_sensors_respond_most_at_their_optimum(quantile):
    depth = np.concatenate([np.zeros(50), np.linspace(0.01, 1, 100)])[:, None]
    response = radial_basis(depth, quantile)[:, 0]
    assert abs(depth[response.argmax(), 0] - np.quantile(depth[depth > 0], quantile)) < 0.01
    assert response[0] == pytest.approx(np.exp(-2))
    assert (np.diff(response) >= 0).all() == (quantile == 1)


def test_pairs_near_and_far_lines_and_few_frames():
    cylinder = find_body("cylinder")
    rng = np.random.default_rng(0)
    contacts = cylinder.positions[rng.integers(60, size=1600)]
    apart = np.linalg.norm(cylinder.positions - contacts[:, None], axis=-1)
    local = replace(simulated(cylinder, np.maximum(0.7 - apart, 0)), metadata={"body": "cylinder"})
    r, information = (dict(zip(PAIR_COLUMNS, row, strict=True)) for row in rows_of(local))
    assert min(r["shorter"], information["shorter"]) > 0
    unrelated = rows_of(simulated(cylinder, rng.random((1600, 60))))[1]
    assert information["unrelated"] < unrelated[[*PAIR_COLUMNS].index("unrelated")] < 1
    assert 0 < r["few_frames"] < 1
    pressed = np.repeat(rng.random((400, 10)), 6, axis=1) + 0.01 * rng.random((400, 60))
    rolled = replace(simulated(cylinder, pressed), metadata={"body": "cylinder"})
    assert [row[PAIRS_AXIAL] for row in rows_of(rolled)] == [1, 1]


@pytest.mark.parametrize("body", ["sphere", "cylinder", "plane"])
@pytest.mark.parametrize("reach", [0.9, 1.3, 2.0])
def test_the_reach_of_contacts_is_found_whatever_their_number(body, reach):
    body = find_body(body)
    for contacts in (100, 400):
        readings = touch(body, reach, contacts, np.random.default_rng(contacts))
        assert reach_of(readings > 0, body.positions) == pytest.approx(reach, rel=0.12)
        at_a_time = readings[: len(readings) // 2 * 2].reshape(-1, 2, body.n_sensors) > 0
        assert reach_of(at_a_time.any(axis=1), body.positions) == pytest.approx(reach, rel=0.15)
        assert np.median((readings > 0).sum(axis=0)) == pytest.approx(contacts, rel=0.15)
        assert readings.max() <= reach * body.spacing


@given(st.floats(0.05, 3), st.integers(0, 100))
def test_compression_of_a_cylinder_is_measured_and_changes_nothing_else(factor, seed):
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    squeezed = 7 * CYLINDER * [1, 1, factor] @ rotation + 3
    found = cylinder_shape(squeezed, CYLINDER)
    assert found.local_axial_scale == pytest.approx(factor, rel=1e-6)
    if factor > 0.5:  # the axis of a much flatter cylinder is not aligned with the true axis
        assert found.axial_scale == pytest.approx(factor, rel=1e-3)
    assert (found.order_around, found.order_along) == (1, pytest.approx(1))


@given(st.integers(0, 50), st.floats(0.3, 3.0))
def test_sphericity_is_1_on_spheres_and_0_on_planes(seed, scale):
    rng = np.random.default_rng(seed)
    ball = rng.normal(size=(300, 3))
    ball = scale * ball / np.linalg.norm(ball, axis=1, keepdims=True) + rng.normal(size=3)
    assert sphericity(ball) == pytest.approx(1, abs=0.15)  # by chance no direction is even
    assert sphericity(ball * [1, 1, 0]) == pytest.approx(0, abs=1e-6)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    assert sphericity(7 * ball @ rotation) == pytest.approx(sphericity(ball), abs=1e-6)


def test_a_bulge_is_the_more_spherical_the_higher_it_is():
    flat = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2), -1).reshape(-1, 2)
    heights = [np.sqrt(radius**2 - (flat**2).sum(axis=1)) for radius in (10.0, 3.0, 1.5)]
    found = [sphericity(np.column_stack([flat, height])) for height in heights]
    assert 0 < found[0] < found[1] < found[2] < 1


def test_a_shuffled_cylinder_has_the_order_of_chance():
    rng = np.random.default_rng(0)
    shuffled = [cylinder_shape(rng.permutation(CYLINDER), CYLINDER) for _ in range(100)]
    assert np.mean([order.order_around for order in shuffled]) == pytest.approx(2 / 9, abs=0.05)
    assert np.mean([order.order_along for order in shuffled]) == pytest.approx(0, abs=0.05)
    columns = CYLINDER.reshape(10, 6, 3)
    wrong_lines = columns[rng.permutation(10)].reshape(60, 3)
    assert cylinder_shape(wrong_lines, CYLINDER).order_along == pytest.approx(1)
    wrong_places = columns[:, rng.permutation(6)].reshape(60, 3)
    found = cylinder_shape(wrong_places, CYLINDER)
    assert found.order_around == 1
    assert found.order_along < 0.5
    assert cylinder_shape(CYLINDER * [1, 1, 0], CYLINDER).order_along == 0


def test_isolation_inside_and_outside_a_lattice():
    grid = np.stack(np.meshgrid(range(5), range(5)), -1).reshape(-1, 2).astype(float)
    assert isolation(grid, 7) == pytest.approx(1)
    grid[0] -= [3, 4]
    assert isolation(grid, 0) == pytest.approx(np.hypot(4, 4))
