"""Maps made from a precomputed similarity, dissimilarity or metric."""

import warnings

import numpy as np
import pandas as pd
import pytest

import anisomap
from anisomap import reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation import mantel
from anisomap.method.named import METHODS, MethodOptions
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from skins import flat_skin, lattice, mantel_r, stages


@pytest.mark.parametrize("method", METHODS)
def test_reconstruction_can_start_from_every_stage(method):
    skin = flat_skin()
    whole = reconstruct(skin, method, 2)
    known = stages(skin.readings, method)
    refined = METHODS[method].refine is not None
    for stage in ("similarity", "dissimilarity", "metric"):
        given = {stage: getattr(known, stage)}
        if stage == "similarity" and refined:
            given["noise"] = known.evidence.variance
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            entered = reconstruct_from(method=method, dimensions=2, **given)
        assert entered.provenance["precomputed"] == stage
        only_started = refined and stage != "similarity"
        assert any("positions are not refined" in str(w.message) for w in told) == only_started
        if not only_started:
            # Paths along ranks, which have a share in refined maps, need readings.
            near = anisomap.mantel(entered, whole, permutations=0).r
            assert near > (0.9999 if refined else 1 - 1e-12)


def test_scaling_starts_from_the_given_positions():
    skin = flat_skin()
    stay = MethodOptions(smacof=SmacofOptions(max_iterations=0))
    with pytest.warns(AnisomapWarning, match="converged"):
        started = reconstruct_from(
            metric=stages(skin.readings, "r-anisomap").metric,
            method="r-anisomap",
            dimensions=2,
            start=lattice(),
            options=stay,
        )
    np.testing.assert_allclose(started.positions, lattice() - lattice().mean(axis=0))


def test_distances_with_zero_weight_are_ignored():
    skin = flat_skin()
    metric = np.array(stages(skin.readings, "r-anisomap").metric)
    how = {"method": "r-anisomap", "dimensions": 2}
    truth = reconstruct_from(metric=metric, **how)
    wrong, weights = metric.copy(), np.ones_like(metric)
    wrong[0, 30] = wrong[30, 0] = 1e3
    weights[0, 30] = weights[30, 0] = 0
    spared = reconstruct_from(metric=wrong, weights=weights, **how)
    misled = reconstruct_from(metric=wrong, **how)
    close = anisomap.mantel(spared, truth, permutations=0).r
    assert close > 0.999
    assert anisomap.mantel(misled, truth, permutations=0).r < close


@pytest.mark.parametrize("known", [0.45, 0.7])
def test_many_unknown_pairs_are_bridged(known):
    found = {"covariogram": [], "r-anisomap": []}
    for seed in range(3):
        skin = flat_skin(seed=seed)
        weights = np.random.default_rng(seed).uniform(size=(42, 42)) < 1 - np.sqrt(1 - known)
        weights = (weights | weights.T).astype(float)
        for method, scores in found.items():
            found_by = stages(skin.readings, method).evidence
            noise = {"noise": found_by.variance} if method == "covariogram" else {}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)
                made = reconstruct_from(
                    similarity=found_by.similarity,
                    method=method,
                    dimensions=2,
                    weights=weights,
                    **noise,
                )
            scores.append(mantel_r(made, skin))
    assert np.mean(found["covariogram"]) > np.mean(found["r-anisomap"]) - 0.01


SIMILARITY = np.corrcoef(flat_skin().readings.T)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give one of similarity, dissimilarity, metric"),
        ({"similarity": np.eye(5), "metric": np.eye(5)}, "got similarity, metric"),
        ({"similarity": np.full((10, 10), 2.0)}, r"in \[-1, 1\]"),
        ({"similarity": 5 * np.eye(10) + 1}, r"in \[-1, 1\]"),
        ({"similarity": [["a", "b"], ["c", "d"]]}, "must be \\(N, N\\) real numbers"),
        ({"similarity": [[1, 2], [3]]}, "must be \\(N, N\\) real numbers"),
        ({"similarity": np.eye(3) * 1j}, "must be \\(N, N\\) real numbers"),
        ({"similarity": np.zeros((3, 4))}, r"must be of shape \(N, N\), got \(3, 4\)"),
        (
            {"similarity": np.eye(9), "start": np.zeros((9, 2)), "dimensions": 3},
            r"\(9, 3\), got \(9, 2\)",
        ),
        ({"metric": 1 - np.eye(9), "weights": np.zeros((2, 2))}, r"\(9, 9\), got \(2, 2\)"),
        ({"dissimilarity": -np.ones((9, 9))}, "dissimilarity"),
        ({"metric": 1 - np.eye(9), "names": ["a"]}, "sensors: 9, names: 1"),
        *(
            ({"similarity": SIMILARITY, **companion}, message)
            for companion, message in (
                ({"noise": np.ones((3, 3))}, r"noise must be of shape \(42, 42\), got \(3, 3\)"),
                ({"noise": 0.01}, "noise must be of shape"),
                ({"noise": np.zeros((42, 42))}, "above 0"),
                ({"noise": np.full((42, 42), np.inf)}, "finite"),
                ({"weights": np.triu(np.ones((42, 42)))}, "weight matrix is not symmetric"),
                ({"weights": np.full((42, 42), -1.0)}, "weights must be"),
                ({"weights": np.full((42, 42), np.nan)}, "weights must be"),
            )
        ),
    ],
)
def test_what_is_no_stage_or_does_not_fit_it_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        reconstruct_from(**given)


@pytest.mark.parametrize("method", ["covariogram", "r-anisomap", "isomap"])
@pytest.mark.parametrize("nonsense", [1.0, np.nan])
def test_values_of_unknown_pairs_are_ignored(method, nonsense):
    skin = flat_skin()
    how = "i-anisomap" if method == "isomap" else "r-anisomap"
    similarity = np.array(stages(skin.readings, how).similarity)
    rng = np.random.default_rng(0)
    unknown = np.triu(rng.uniform(size=similarity.shape) < 0.1, 1)
    unknown |= unknown.T
    maps = []
    for value in (0.0, nonsense):
        given = np.where(unknown, value, similarity)
        made = reconstruct_from(similarity=given, method=method, dimensions=2, weights=~unknown)
        maps.append(made.positions)
    np.testing.assert_array_equal(*maps)
    assert mantel(maps[0], skin.positions, permutations=0).r > (0.6 if method == "isomap" else 0.95)


def test_columns_of_a_data_frame_name_the_sensors():
    lengths = np.abs(np.subtract.outer(np.arange(4.0), np.arange(4.0)))
    named = pd.DataFrame(lengths, columns=list("abcd"))
    assert reconstruct_from(metric=named, method="isomap", dimensions=1).names == tuple("abcd")
    given = reconstruct_from(metric=named, method="isomap", dimensions=1, names=list("wxyz"))
    assert given.names == tuple("wxyz")
