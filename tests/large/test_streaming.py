"""Recordings in chunks: equality with the map of one array, for all workers and interruptions."""

import importlib

import joblib
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import anisomap
from anisomap import Recording, SensorMapper, diagnose, reconstruct
from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.large import chunks
from anisomap.large.checkpoints import Checkpoint
from anisomap.large.map_reduce import WorkerPool, map_reduce
from anisomap.large.streaming import reconstruct_chunks
from anisomap.methods import METHODS
from anisomap.options import MethodOptions
from anisomap.numerics.similarity.accumulators import Moments
from anisomap.numerics.similarity.joint_values import JointValues
from dying import Dying, ThreadLimits
from skins import flat_skin

# Readings of so many levels as a sensor of 6 bits has.
READINGS = np.round(flat_skin(n_frames=2500).readings * 20).astype(np.uint8)
SKIN = Recording(READINGS)


# In chunks, the covariogram is of r alone.
EXACT = [name for name, method in METHODS.items() if method.refine is None]


def rounding(method):
    """Return by how much positions may differ: the stress of information distance is flat.

    A relative change of the distances by 1e-15 moves its positions by 1e-5.
    """
    return 1e-3 if method == "information-distance" else 1e-10


def cut_at(*cuts):
    return lambda: iter(np.split(READINGS, cuts))


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize("cuts", [(), (7, 400, 401, 1100), range(50, 2500, 50)])
def test_chunks_give_the_map_of_one_array(method, cuts):
    expected = diagnose(reconstruct(SKIN, method, 2), SKIN)
    found = reconstruct_chunks(cut_at(*cuts), method, 2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=rounding(method))
    assert found.health == expected.health
    assert found.notes == expected.notes
    assert found.provenance["frames"] == 2500


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize(
    "cuts",
    [
        pytest.param([3, 900, 901], id="few"),
        pytest.param([2, *range(3, 23)], id="frame by frame", marks=pytest.mark.slow),
    ],
)
@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_partial_fit_gives_the_map_of_one_array(method, cuts):
    parts, whole = (SensorMapper(n_components=2, method=method) for _ in range(2))
    for part in np.split(READINGS, cuts):
        parts.partial_fit(part)
    whole.fit(READINGS)
    np.testing.assert_allclose(parts.positions_, whole.positions_, atol=rounding(method))
    if isinstance(parts._pairs, JointValues):
        counted = JointValues.of(READINGS)
        np.testing.assert_array_equal(parts._pairs.counts, counted.counts)
        assert parts._pairs.single.n_frames == len(READINGS)


@pytest.mark.parametrize("method", sorted(set(METHODS) - set(EXACT)))
@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_partial_fit_of_refined_maps_does_not_depend_on_parts(method):
    made = []
    for cuts in ([3, 900, 901], [2000]):
        parts = SensorMapper(n_components=2, method=method)
        for part in np.split(READINGS, cuts):
            parts.partial_fit(part)
        made.append(parts.positions_)
    np.testing.assert_allclose(made[0], made[1], atol=1e-6)
    whole = reconstruct_chunks(cut_at(), method, 2)
    assert anisomap.mantel(made[0], whole.positions, permutations=0).r > 0.999


def test_what_the_default_method_cannot_do_with_chunks_is_noted():
    with pytest.warns(AnisomapWarning, match="read in blocks.* Pearson's r alone") as told:
        found = reconstruct_chunks(cut_at(), dimensions=2)
    assert str(told[0].message) in found.notes


@pytest.mark.filterwarnings("ignore:the recording was read in blocks")
def test_the_covariogram_does_not_depend_on_chunk_boundaries():
    whole = reconstruct(SKIN, "covariogram", 2)
    found = [reconstruct_chunks(cut_at(*cuts), "covariogram", 2) for cuts in ((), (7, 400, 1100))]
    np.testing.assert_allclose(found[0].positions, found[1].positions, atol=1e-6)
    assert anisomap.mantel(found[0], whole, permutations=0).r > 0.999
    assert found[0].provenance["similarity"] == "pearson"


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_memory_mapped_arrays_are_read_in_chunks(tmp_path, monkeypatch, dtype):
    np.save(tmp_path / "skin.npy", READINGS.astype(dtype))
    monkeypatch.setattr(chunks, "CHUNK_READINGS", 300 * 42)
    monkeypatch.setattr(chunks, "CHUNK_FRAMES", 1)
    mapped = np.load(tmp_path / "skin.npy", mmap_mode="r")
    for part in (slice(None), slice(100, 2400)):
        found = reconstruct_chunks(mapped[part] if part.start else mapped, "i-anisomap", 2)
        expected = reconstruct(Recording(READINGS[part]), "i-anisomap", 2)
        np.testing.assert_allclose(found.positions, expected.positions, atol=1e-10)


def test_memory_mapped_arrays_may_be_in_fortran_order(tmp_path, monkeypatch):
    np.save(tmp_path / "skin.npy", np.asfortranarray(READINGS))
    monkeypatch.setattr(chunks, "CHUNK_READINGS", 300 * 42)
    monkeypatch.setattr(chunks, "CHUNK_FRAMES", 1)
    found = reconstruct_chunks(np.load(tmp_path / "skin.npy", mmap_mode="r"), "r-anisomap", 2)
    expected = reconstruct(SKIN, "r-anisomap", 2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-10)


class PowerCutError(Exception):
    """The power is gone."""


def failing_at(n_chunks, passes):
    """Open chunks of which some are never read, in the pass that is the last."""
    opened = []

    def chunks():
        opened.append(True)
        for i, chunk in enumerate(np.split(READINGS, 10)):
            if len(opened) == passes and i == n_chunks:
                raise PowerCutError
            yield chunk

    return chunks


@pytest.mark.parametrize("passes", [1, 2])
def test_interrupted_reconstructions_resume(tmp_path, passes):
    expected = reconstruct(SKIN, "i-anisomap", 2)
    file = tmp_path / "counts.npz"
    options = {"method": "i-anisomap", "dimensions": 2, "checkpoint": file}
    with pytest.raises(PowerCutError):
        reconstruct_chunks(failing_at(6, passes), **options)
    read = []

    def counted():
        for chunk in np.split(READINGS, 10):
            read.append(1)
            yield chunk

    for _ in range(2):
        found = reconstruct_chunks(counted, **options)
        np.testing.assert_allclose(found.positions, expected.positions, atol=1e-10)
    assert [f.name for f in tmp_path.iterdir()] == ["counts.npz"]
    with pytest.raises(FileError, match="another computation"):
        reconstruct_chunks(counted, "r-anisomap", 2, checkpoint=file)
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(FileError, match="damaged"):
        reconstruct_chunks(counted, **options)


@pytest.mark.parametrize("method", ["r-anisomap", "i-anisomap"])
def test_threads_give_bitwise_the_same_map(method):
    alone = reconstruct_chunks(cut_at(700, 1500), method, 2)
    many = reconstruct_chunks(cut_at(700, 1500), method, 2, pool=WorkerPool(2))
    np.testing.assert_array_equal(many.positions, alone.positions)


@pytest.mark.parametrize("backend", ["threading", "loky", "multiprocessing"])
def test_joblib_backends_give_bitwise_the_same_map(backend):
    alone = reconstruct_chunks(cut_at(700, 1500), "i-anisomap", 2)
    with joblib.parallel_config(backend):
        many = reconstruct_chunks(cut_at(700, 1500), "i-anisomap", 2, pool=WorkerPool(2))
    np.testing.assert_array_equal(many.positions, alone.positions)


def test_ray_gives_bitwise_the_same_map():
    ray = pytest.importorskip("ray")
    importlib.import_module("ray.util.joblib").register_ray()
    alone = reconstruct_chunks(cut_at(700, 1500), "i-anisomap", 2)
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        with joblib.parallel_config("ray"):
            many = reconstruct_chunks(cut_at(700, 1500), "i-anisomap", 2, pool=WorkerPool(2))
    finally:
        ray.shutdown()
    np.testing.assert_array_equal(many.positions, alone.positions)


@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_workers_use_single_threaded_blas(backend):
    with threadpool_limits(3), joblib.parallel_config(backend):
        found = map_reduce(cut_at(*range(100, 2500, 100)), ThreadLimits.of, pool=WorkerPool(2))
        assert found.limits == {1}
        assert ThreadLimits.of(None).limits == {3}


def test_after_a_worker_process_died_the_next_run_resumes(tmp_path):
    chunks, file = cut_at(700, 1500, 2000), tmp_path / "counts.npz"
    options = {"pool": WorkerPool(2), "checkpoint": Checkpoint(file, "moments")}
    with joblib.parallel_config("loky"):
        with pytest.raises(InputError, match="worker process died"):
            map_reduce(chunks, Dying(tmp_path), **options)
        found = map_reduce(chunks, Dying(tmp_path), **options)
    np.testing.assert_array_equal(found.comoment, map_reduce(chunks, Moments.of).comoment)


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_map(tmp_path):
    distributed = pytest.importorskip("distributed")
    chunks = cut_at(*range(250, 2500, 250))
    expected = map_reduce(chunks, Moments.of)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        pool = WorkerPool(scheduler=cluster.scheduler_address)
        np.testing.assert_array_equal(map_reduce(chunks, Moments.of, pool=pool).mean, expected.mean)
        found = map_reduce(chunks, Dying(tmp_path), pool=pool)
    np.testing.assert_array_equal(found.comoment, expected.comoment)
    assert (tmp_path / "dead").exists()


def test_missing_readings():
    readings = READINGS.astype(np.float32)
    readings[1200, 3] = np.nan
    chunks = np.split(readings, [1000])
    with pytest.raises(InputError, match="sensor 3 in frame 1200"):
        reconstruct_chunks(lambda: chunks)
    found = reconstruct_chunks(lambda: chunks, "i-anisomap", 2, missing="drop-frames")
    kept = Recording(np.delete(READINGS, 1200, axis=0))
    expected = reconstruct(kept, "i-anisomap", 2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-10)


@pytest.mark.parametrize(
    ("chunks", "message"),
    [
        ([], "no frame"),
        ([READINGS, READINGS[:, :30]], "from frame 2500 on there are 30 sensors, but 42 before"),
        ([np.array([["a", "b"]])], "real numbers"),
        ([READINGS[0]], r"\(frames, sensors\)"),
    ],
)
def test_invalid_chunks_are_refused(chunks, message):
    with pytest.raises(InputError, match=message):
        reconstruct_chunks(lambda: chunks)


def test_health_is_assessed_from_an_excerpt_of_bounded_size(monkeypatch):
    monkeypatch.setattr(chunks, "EXCERPT_READINGS", 42 * 800)
    monkeypatch.setattr(chunks, "SEGMENT_FRAMES", 50)
    late = READINGS.copy()
    late[:-40, 7] = 0
    with pytest.warns(AnisomapWarning, match=r"assessed from \d+ of 2500 frames"):
        found = reconstruct_chunks(lambda: np.split(late, 10), "r-anisomap", 2)
    assert found.placed[7]
    assert found.health[7] != "dead"


@pytest.mark.filterwarnings("ignore:the recording was read in blocks")
def test_uneven_maps_of_chunks_carry_a_note():
    doubled = np.hstack([READINGS, READINGS + np.arange(42, dtype=np.uint8) % 2])
    with pytest.warns(AnisomapWarning, match="peak heights of contacts.* were not examined"):
        reconstruct_chunks(lambda: iter(np.split(doubled, 5)), dimensions=2)


def test_even_spacing_is_refused_before_all_frames_are_read():
    def unread():
        raise AssertionError

    with pytest.raises(InputError, match="even spacing"):
        reconstruct_chunks(unread, options=MethodOptions(even_spacing=True))


@pytest.mark.parametrize("unit", [1e200, 1e-200])
def test_readings_of_extreme_magnitude_are_refused(unit):
    readings = READINGS.astype(np.float64)
    readings[:, 3] *= unit
    with pytest.raises(InputError, match=r"sensor 3 is .* use another unit"):
        reconstruct_chunks(readings, "r-anisomap", 2)


def test_long_doubles_are_read_as_doubles():
    found = reconstruct_chunks(READINGS.astype(np.longdouble), "r-anisomap", 2)
    expected = reconstruct_chunks(READINGS, "r-anisomap", 2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-9)


def test_changes_of_copy_on_write_maps_are_used(tmp_path):
    np.save(tmp_path / "skin.npy", READINGS)
    mapped = np.load(tmp_path / "skin.npy", mmap_mode="c")
    mapped[:, 3] = 0
    with pytest.warns(AnisomapWarning, match="1 of 42 sensors never vary"):
        found = reconstruct_chunks(mapped, "r-anisomap", 2)
    assert not found.placed[3]


def test_too_many_bins_are_refused():
    with pytest.raises(InputError, match="at most 1024, got 70000"):
        reconstruct_chunks(READINGS, "i-anisomap", options=MethodOptions(bins=70_000))
