"""Recordings in chunks: equality with one array, for similarities, workers and interruptions."""

import functools
import importlib

import joblib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

import anisomap
from anisomap import Recording, diagnose, reconstruct
from anisomap.errors import AnisomapWarning, InputError
from anisomap.large import chunks
from anisomap.large.map_reduce import Checkpoint, WorkerPool, map_reduce
from anisomap.large.streaming import CHUNKED, computed_similarity, reconstruct_chunks
from anisomap.method.evidence import SIMILARITIES
from anisomap.method.named import METHODS
from anisomap.method.options import MethodOptions
from anisomap.numerics.similarity import binning as value_counts
from anisomap.numerics.similarity import co_occurrence
from anisomap.numerics.similarity.binning import ValueCounts
from anisomap.numerics.similarity.correlation import Moments, StoredCodes
from dying import Dying, ThreadLimits
from skins import flat_skin, lattice

# Readings of so many levels as a sensor of 5 bits has.
READINGS = np.round(flat_skin().readings * 10).astype(np.uint8)
SKIN = Recording(READINGS)

# In chunks, the covariogram is of r alone.
EXACT = [name for name, method in METHODS.items() if not method.refinements]
REFINED = sorted(set(METHODS) - set(EXACT))

LOKY = {"backend": "loky", "inner_max_num_threads": 3}


def rounding(method):
    """Return by how much positions may differ: the stress of information distance is flat.

    A relative change of its distances by 1e-15 moves its positions by 4e-8, others by 1e-13.
    """
    return 1e-3 if method == "information-distance" else 1e-8


def cut_at(*cuts):
    return lambda: iter(np.split(READINGS, cuts))


@functools.cache
def whole(method):
    return reconstruct(SKIN, method, 2)


def assert_whole(found, method="r-anisomap"):
    np.testing.assert_allclose(found.positions, whole(method).positions, atol=rounding(method))


@pytest.mark.parametrize("method", EXACT)
def test_chunks_give_the_map_of_one_array(method):
    found = reconstruct_chunks(cut_at(7, 400, 401, *range(500, 1500, 250)), method, 2)
    assert_whole(found, method)
    expected = diagnose(whole(method), SKIN)
    assert found.health == expected.health
    assert found.notes == expected.notes
    assert found.provenance["frames"] == 1500


@pytest.mark.parametrize("method", REFINED)
@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_refined_maps_do_not_depend_on_chunks(method):
    one, several = (reconstruct_chunks(cut_at(*cuts), method, 2) for cuts in ((), (7, 400, 1100)))
    np.testing.assert_allclose(one.positions, several.positions, atol=1e-6)
    assert one.provenance["similarity"] == "pearson"
    assert anisomap.mantel(one, lattice(), permutations=0).r > 0.99


def test_what_the_default_method_cannot_do_with_chunks_is_noted():
    with pytest.warns(AnisomapWarning, match="read in blocks.* Pearson's r alone") as told:
        found = reconstruct_chunks(cut_at(), dimensions=2)
    assert str(told[0].message) in found.notes
    doubled = np.hstack([READINGS, READINGS + np.arange(42, dtype=np.uint8) % 2])
    with pytest.warns(AnisomapWarning) as told:
        reconstruct_chunks(lambda: iter(np.split(doubled, 5)), dimensions=2)
    assert any("heights of contacts" in str(one.message) for one in told)


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(chunks, "CHUNK_READINGS", 300 * 42)
    monkeypatch.setattr(chunks, "CHUNK_FRAMES", 1)


@pytest.mark.parametrize(
    "stored",
    [READINGS, READINGS.astype("f4"), READINGS.astype(np.longdouble), np.asfortranarray(READINGS)],
)
@pytest.mark.usefixtures("small_chunks")
def test_memory_mapped_arrays_are_read_in_chunks(tmp_path, stored):
    np.save(tmp_path / "skin.npy", stored)
    mapped = np.load(tmp_path / "skin.npy", mmap_mode="r")
    assert_whole(reconstruct_chunks(mapped, "r-anisomap", 2))
    part = slice(100, 1400)
    expected = reconstruct(Recording(READINGS[part]), "r-anisomap", 2)
    found = reconstruct_chunks(mapped[part], "r-anisomap", 2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-8)
    private = np.load(tmp_path / "skin.npy", mmap_mode="c")
    private[:, 3] = 0  # in memory only
    with pytest.warns(AnisomapWarning, match="1 of 42 sensors never varied"):
        assert not reconstruct_chunks(private, "r-anisomap", 2).placed[3]


@pytest.fixture
def ray():
    found = pytest.importorskip("ray")
    importlib.import_module("ray.util.joblib").register_ray()
    found.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    found.shutdown()


@pytest.mark.parametrize(
    "backend",
    [
        "threading",
        "loky",
        *(pytest.param(b, marks=pytest.mark.slow) for b in ("multiprocessing", "ray")),
    ],
)
def test_joblib_backends_give_bitwise_the_same_total(backend, request):
    if backend == "ray":
        request.getfixturevalue("ray")
    parts = cut_at(*range(100, 1500, 100))
    with joblib.parallel_config(**LOKY if backend == "loky" else {"backend": backend}):
        found = map_reduce(parts, Moments.of, pool=WorkerPool(2))
    np.testing.assert_array_equal(found.comoment, map_reduce(parts, Moments.of).comoment)


@pytest.mark.parametrize("options", [{"backend": "threading"}, LOKY], ids=["threads", "processes"])
def test_workers_use_single_threaded_blas(options):
    with threadpool_limits(3), joblib.parallel_config(**options):
        before = ThreadLimits.of(None).limits
        found = map_reduce(cut_at(*range(100, 1500, 100)), ThreadLimits.of, pool=WorkerPool(2))
        assert found.limits <= {1}
        assert ThreadLimits.of(None).limits == before


def test_after_a_worker_process_died_the_next_run_resumes(tmp_path):
    parts, file = cut_at(700, 1100, 1300), tmp_path / "counts.npz"
    options = {"pool": WorkerPool(2), "checkpoint": Checkpoint(file, "moments")}
    with joblib.parallel_config(**LOKY):
        with pytest.raises(InputError, match="worker process died"):
            map_reduce(parts, Dying(tmp_path), **options)
        found = map_reduce(parts, Dying(tmp_path), **options)
    np.testing.assert_array_equal(found.comoment, map_reduce(parts, Moments.of).comoment)


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_map(tmp_path):
    distributed = pytest.importorskip("distributed")
    parts = cut_at(*range(150, 1500, 150))
    expected = map_reduce(parts, Moments.of)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        pool = WorkerPool(scheduler=cluster.scheduler_address)
        for mapper in (Moments.of, Dying(tmp_path)):
            found = map_reduce(parts, mapper, pool=pool)
            np.testing.assert_array_equal(found.comoment, expected.comoment)
    assert (tmp_path / "dead").exists()


def test_missing_readings():
    readings = READINGS.astype(np.float32)
    readings[1200, 3] = np.nan
    parts = np.split(readings, [1000])
    with pytest.raises(InputError, match="sensor 3 in frame 1200"):
        reconstruct_chunks(lambda: parts)
    found = reconstruct_chunks(lambda: parts, "r-anisomap", 2, missing="drop-frames")
    expected = reconstruct(Recording(np.delete(READINGS, 1200, axis=0)), "r-anisomap", 2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-8)


def scaled(unit):
    return READINGS * np.where(np.arange(42) == 3, unit, 1.0)


@pytest.mark.parametrize(
    ("parts", "options", "message"),
    [
        ([], {}, "no frame"),
        ([READINGS, READINGS[:, :30]], {}, "from frame 1500 on there are 30 sensors, but 42"),
        ([np.array([["a", "b"]])], {}, "real numbers"),
        ([READINGS[0]], {}, r"\(frames, sensors\)"),
        ([scaled(1e200)], {}, r"sensor 3 reads .* use another unit"),
        ([scaled(1e-200)], {}, r"sensor 3 reads .* use another unit"),
        ([READINGS], {"entropy_bins": 70_000}, "at most 1024, got 70000"),
    ],
)
def test_invalid_input_is_refused(parts, options, message):
    with pytest.raises(InputError, match=message):
        reconstruct_chunks(lambda: parts, "i-anisomap", options=MethodOptions(**options))


def test_even_spacing_is_refused_before_all_frames_are_read():
    def unread():
        raise AssertionError

    with pytest.raises(InputError, match="even spacing"):
        reconstruct_chunks(unread, options=MethodOptions(even_spacing=True))


def test_health_is_assessed_from_an_excerpt_of_bounded_size(monkeypatch):
    monkeypatch.setattr(chunks, "EXCERPT_READINGS", 42 * 800)
    monkeypatch.setattr(chunks, "SEGMENT_FRAMES", 50)
    late = READINGS.copy()
    late[:, 7] = 0
    late[-40:, 7] = READINGS[-40:].max(axis=1)
    with pytest.warns(AnisomapWarning, match=r"assessed from \d+ of 1500 frames"):
        found = reconstruct_chunks(lambda: np.split(late, 10), "r-anisomap", 2)
    assert found.placed[7]
    assert found.health[7] != "silent"


BINS = 4
rows = st.lists(st.integers(1, 299), max_size=4, unique=True).map(sorted)


def readings_of(seed, n_values=9):
    rng = np.random.default_rng(seed)
    touch = np.cumsum(rng.normal(0, 0.5, 300))[:, None] % 6
    depth = np.maximum(0, 1.5 - abs(touch - np.arange(6))) * rng.uniform(0.5, 2, 6)
    levels = np.round(depth / depth.max() * (n_values - 1)) * rng.choice([-3.0, 0.25, 1.0], 6) + 7
    levels[:, 5] = 7
    return levels


def merged(mapper, parts):
    return functools.reduce(lambda total, part: total.merged(part), map(mapper, parts))


def in_chunks(name, parts):
    recipe = CHUNKED[name]
    mapper = Moments.of
    if recipe.prepare:
        mapper = recipe.prepare(merged(ValueCounts.of, parts), BINS)
    return recipe.finish(merged(mapper, parts))


def test_every_similarity_can_be_computed_in_chunks():
    # Distinct contacts are those of the whole recording.
    assert set(CHUNKED) == set(SIMILARITIES) - {"contact-agreement"}


@pytest.mark.parametrize("many", [1, 10**6], ids=["compiled", "numpy"])
@pytest.mark.parametrize("name", CHUNKED)
@given(seed=st.integers(0, 20), cuts=rows, data=st.data())
@settings(max_examples=8)
def test_chunks_give_the_similarity_of_the_whole(name, many, seed, cuts, data):
    readings = readings_of(seed)
    expected = SIMILARITIES[computed_similarity(name)].compute(readings, BINS)
    parts = data.draw(st.permutations(np.split(readings, cuts)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(co_occurrence, "MIN_COMPILED_SENSORS", many)
        found = in_chunks(name, parts)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        np.testing.assert_array_equal(found, found.T)
        if name in ("co-activation", "mutual-information"):
            np.testing.assert_array_equal(found, in_chunks(name, [readings]))


def test_codes_of_few_frames_of_many_sensors_are_stored_instead_of_counts():
    readings = np.random.default_rng(0).integers(0, 8, (64, 700)).astype(np.uint8)
    recipe = CHUNKED["mutual-information"]
    mapper = recipe.prepare(ValueCounts.of(readings), 8)
    total = mapper(readings[:20]).merged(mapper(readings[20:]))
    assert isinstance(total, StoredCodes)
    found = recipe.finish(total)
    expected = SIMILARITIES["mutual-information"].compute(readings, 8)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("name", ["spearman", "mutual-information"])
def test_rounding_of_continuous_readings_changes_little(name, monkeypatch):
    rng = np.random.default_rng(0)
    common = rng.normal(size=(4000, 1))
    readings = common + rng.normal(0, 0.7, size=(4000, 6))
    monkeypatch.setattr(value_counts, "MAX_VALUES", 6 * 500)
    expected = SIMILARITIES[name].compute(readings, BINS)
    parts = np.array_split(readings, 7)
    np.testing.assert_allclose(in_chunks(name, parts), expected, atol=0.01)
