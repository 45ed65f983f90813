"""Maps that are kept up to date: pooled evidence, new and moved sensors, and the frame."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, SensorMap
from anisomap.errors import InputError
from anisomap.evaluation import compare_maps, score
from anisomap.numerics.similarity.correlation import pearson, spearman
from anisomap.placement import Anchors, place
from anisomap.tracking.pair_sums import PairSums
from anisomap.evidence import SIMILARITIES
from anisomap.tracking import gather_evidence, map_evidence, update_map
from skins import flat_skin, lattice, rubbed

seeds = st.integers(0, 10_000)
few = settings(max_examples=10)
SENSORS = 42


def named(readings, names=None):
    return Recording(readings, names=tuple(names or (f"s{i}" for i in range(readings.shape[1]))))


def day(seed, *, n_frames=1500, without=()):
    """Return a recording of the flat skin, without some sensors."""
    recording = named(flat_skin(seed=seed, n_frames=n_frames).readings)
    kept = [i for i, name in enumerate(recording.names) if name not in without]
    return recording.select(kept)


def mapped(recording, **options):
    return (
        anisomap.reconstruct(recording, dimensions=2, **options),
        gather_evidence(recording, dimensions=2, **options),
    )


def quiet(function, *arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", anisomap.AnisomapWarning)
        return function(*arguments, **options)


def same_evidence(first, second):
    order = [second.names.index(name) for name in first.names]
    assert sorted(first.names) == sorted(second.names)
    assert first.recordings == second.recordings
    for key, sums in first.sums.items():
        for field, values in vars(sums).items():
            other = getattr(second.sums[key], field)[np.ix_(order, order)]
            np.testing.assert_allclose(values, other, rtol=1e-10, atol=1e-10)


@given(seeds, st.integers(2, 12), st.integers(2, 12))
@few
def test_evidence_adds_up_in_any_order_and_grouping(seed, first_size, last_size):
    rng = np.random.default_rng(seed)
    readings = rubbed(lattice(3, 4), 150, seed=seed)
    a = gather_evidence(named(readings[:50] + rng.normal(0, 0.01, (50, 12))))
    parts = [
        gather_evidence(named(values[:, :size], [f"s{i}" for i in range(size)]))
        for values, size in ((readings[50:100] + 1e-3, first_size), (readings[100:], last_size))
        if (np.ptp(values[:, :size], axis=0) > 0).sum() > 1
    ]
    if len(parts) < 2:
        return
    b, c = parts
    same_evidence(a.merged(b), b.merged(a))
    same_evidence(a.merged(b).merged(c), a.merged(b.merged(c)))


@pytest.mark.parametrize("similarity", sorted(SIMILARITIES))
def test_sums_of_one_recording_give_its_similarity_and_variance(similarity):
    readings = rubbed(lattice(4, 5), 600, seed=3)
    readings = (readings > 0.5).astype(float) if similarity == "contact-agreement" else readings
    chosen = SIMILARITIES[similarity]
    found = PairSums.of(readings, similarity, bins=6).statistics(similarity)
    np.testing.assert_allclose(found.similarity, chosen.compute(readings, 6), atol=1e-12)
    np.testing.assert_allclose(found.noise, chosen.variance(readings), rtol=1e-12)
    assert found.known.all()


@pytest.mark.parametrize(("similarity", "whole"), [("pearson", pearson), ("spearman", spearman)])
def test_pooled_correlations_of_halves_are_those_of_the_whole(similarity, whole):
    readings = rubbed(lattice(4, 5), 8000, seed=4)
    halves = [PairSums.of(half, similarity, bins=6) for half in np.array_split(readings, 2)]
    pooled = halves[0].merged(halves[1]).statistics(similarity).similarity
    assert np.abs(pooled - whole(readings)).max() < 0.03
    assert np.abs(pooled - whole(readings)).mean() < 0.5 * np.mean(
        [np.abs(half.statistics(similarity).similarity - whole(readings)).mean() for half in halves]
    )


def test_agreements_of_disjoint_contacts_add_up_exactly():
    """Contacts of the halves differ, so that none is counted twice."""
    readings = (rubbed(lattice(4, 5), 400, seed=5) > 0.7).astype(float)
    whole = np.unique(readings[readings.sum(axis=1) > 1], axis=0)
    halves = [PairSums.of(h, "contact-agreement", bins=6) for h in (whole[:40], whole[40:])]
    pooled = halves[0].merged(halves[1]).statistics("contact-agreement").similarity
    expected = SIMILARITIES["contact-agreement"].compute(whole, 6)
    np.testing.assert_allclose(pooled, expected, atol=1e-12)


def test_a_zero_that_shifts_between_recordings_relates_no_sensors():
    rng = np.random.default_rng(6)
    first, second = rng.normal(size=(2, 2000, 6))
    pooled = PairSums.of(first, "pearson", bins=6).merged(
        PairSums.of(second + 100, "pearson", bins=6)
    )
    others = ~np.eye(6, dtype=bool)
    assert np.abs(pooled.statistics("pearson").similarity[others]).max() < 0.1
    assert np.abs(pearson(np.concatenate([first, second + 100]))[others]).min() > 0.9


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_new_sensors_are_placed_as_well_as_by_a_map_of_everything(seed):
    fresh = ("s3", "s17", "s25", "s40")
    first, second = day(seed, without=fresh), day(seed + 50)
    found = quiet(update_map, *quiet(mapped, first), second)
    whole = quiet(anisomap.reconstruct, [first, second], dimensions=2)
    assert set(found.added) == set(fresh)
    assert not found.moved
    assert not found.unplaced
    truth = lattice()
    for made in (found.map, whole):
        rows = [made.names.index(f"s{i}") for i in range(SENSORS)]
        result = score(made.select(rows), truth, permutations=0)
        off = result.alignment.errors / result.spacing
        assert np.sqrt(np.mean(off[[3, 17, 25, 40]] ** 2)) < 0.35
    assert not compare_maps(whole, found.map).moved.any()


def test_an_update_equals_a_map_of_both_recordings_and_the_order_does_not_matter():
    first, second = day(21), day(22)
    forth = quiet(update_map, *quiet(mapped, first), second)
    back = quiet(update_map, *quiet(mapped, second), first)
    same_evidence(forth.evidence, back.evidence)
    whole = quiet(anisomap.reconstruct, [first, second], dimensions=2)
    for one, other in ((forth.map, back.map), (forth.map, whole)):
        found = compare_maps(one, other)
        off = np.linalg.norm(found.after - found.before, axis=1) / found.spacing
        assert np.median(off) < 0.1
        assert not found.moved.any()


def test_the_frame_the_units_and_the_hand_of_a_placed_map_are_kept():
    truth = 0.006 * lattice() @ [[0.0, 1.0], [1.0, 0.0]] + [0.1, -0.3]  # mirrored
    first, second = day(31, without=("s20",)), day(32)
    sensor_map, evidence = quiet(mapped, first)
    anchors = [0, 6, 21, 38, 15]
    placed = place(sensor_map, Anchors(tuple(f"s{i}" for i in anchors), truth[anchors])).map
    found = quiet(update_map, placed, evidence, second).map
    assert (found.units, found.anchored, found.handed) == ("m", True, True)
    assert found.names == (*placed.names, "s20")
    off = np.linalg.norm(found.positions - truth[[int(name[1:]) for name in found.names]], axis=1)
    assert np.median(off) < 0.3 * 0.006
    assert (off <= found.errors + 1e-12).mean() > 0.85
    assert off[-1] <= found.errors[-1]
    measured = [found.names.index(f"s{i}") for i in anchors]
    assert off[measured].max() < 1e-12  # what was measured stays


def test_corrections_of_an_old_map_are_kept():
    """A map that was bent smoothly after it was made stays bent."""
    first, second = day(41, without=("s16",)), day(42)
    sensor_map, evidence = quiet(mapped, first)
    points = sensor_map.positions - sensor_map.positions.mean(axis=0)
    size = np.abs(points).max()

    def bent(x):
        return x + 0.15 * x[:, ::-1] ** 2 / size

    old = SensorMap(bent(points), names=sensor_map.names)
    found = quiet(update_map, old, evidence, second).map
    plain = quiet(update_map, SensorMap(points, names=sensor_map.names), evidence, second).map
    spacing = compare_maps(old, old).spacing
    off = np.linalg.norm(found.positions - bent(plain.positions), axis=1)
    assert np.median(off) < 0.05 * spacing
    assert off[-1] < 0.3 * spacing  # the new sensor takes the corrections of its neighbours


def test_sensors_that_the_recording_lacks_stay():
    first, second = day(51), day(52, without=("s0", "s1", "s41"))
    sensor_map, evidence = quiet(mapped, first)
    found = quiet(update_map, sensor_map, evidence, second)
    assert set(found.silent) == {"s0", "s1", "s41"}
    assert found.map.placed.all()
    rows = found.map.indices(found.silent)
    assert found.difference.distance[rows].max() < found.difference.spacing
    assert not found.moved


@pytest.mark.parametrize("seed", [61, 62])
def test_sensors_that_were_rewired_are_named_and_not_averaged(seed):
    first, second = day(seed), day(seed + 10)
    readings = second.readings.copy()
    readings[:, [8, 33]] = readings[:, [33, 8]]
    sensor_map, evidence = quiet(mapped, first)
    with pytest.warns(anisomap.AnisomapWarning, match="2 sensors moved"):
        found = update_map(sensor_map, evidence, named(readings))
    assert set(found.moved) == {"s8", "s33"}
    assert found.moves.like[found.moves.names.index("s8")] == "s33"
    apart = np.linalg.norm(sensor_map.positions[8] - sensor_map.positions[33])
    for i, j in ((8, 33), (33, 8)):
        assert np.linalg.norm(found.map.positions[i] - sensor_map.positions[j]) < 0.2 * apart
    other = np.setdiff1d(np.arange(SENSORS), [8, 33])
    assert found.difference.distance[other].max() < 0.2 * apart


def test_an_update_can_be_updated():
    first, second, third = day(71, without=("s5",)), day(72, without=("s9",)), day(73)
    once = quiet(update_map, *quiet(mapped, first), second)
    twice = quiet(update_map, once.map, once.evidence, third)
    assert twice.map.placed.all()
    assert len(twice.evidence.recordings) == 3
    assert twice.evidence.n_frames == 4500
    result = score(
        twice.map.select([twice.map.names.index(f"s{i}") for i in range(SENSORS)]), lattice()
    )
    assert result.rms_in_spacings < 0.3


def test_health_comes_from_the_new_recording():
    first, second = day(81), day(82)
    readings = second.readings.copy()
    readings[:, 7] = 0
    found = quiet(update_map, *quiet(mapped, first), named(readings))
    assert found.map.health[7] == "dead"
    assert found.map.placed[7]
    assert found.silent == ("s7",)


def scrambled(seed):
    readings = day(seed).readings
    return named(readings[:, np.random.default_rng(seed).permutation(SENSORS)])


def holed(seed):
    readings = day(seed).readings.copy()
    readings[3, 5] = np.nan
    return named(readings)


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (lambda: named(np.zeros((50, SENSORS))), "no evidence of distances"),
        (lambda: day(91), "part of the evidence already"),
        (lambda: scrambled(92), "contradicts the map"),
        (lambda: named(day(93).readings, [f"t{i}" for i in range(SENSORS)]), "shares 0"),
        (lambda: day(94).select([0, 1]), "shares 2 varying sensors"),
        (lambda: holed(95), "NaN or infinite"),
    ],
)
def test_recordings_that_say_nothing_or_contradict_the_map_are_refused(recording, message):
    sensor_map, evidence = quiet(mapped, day(91))
    with pytest.raises(InputError, match=message) as refused:
        quiet(update_map, sensor_map, evidence, recording())
    assert len(str(refused.value)) < 300


def test_statistics_of_another_map_are_refused():
    sensor_map, evidence = quiet(mapped, day(95))
    order = np.random.default_rng(0).permutation(SENSORS)
    other = SensorMap(sensor_map.positions[order], names=sensor_map.names)
    strange = SensorMap(sensor_map.positions, names=[f"t{i}" for i in range(SENSORS)])
    for wrong in (other, strange):
        with pytest.raises(InputError, match=r"not those of the map|contradicts the map"):
            quiet(update_map, wrong, evidence, day(96))
    with pytest.raises(InputError, match="level"):
        update_map(sensor_map, evidence, day(96), level=0)
    with pytest.raises(InputError, match="even spacing"):
        gather_evidence(day(96), options=anisomap.MethodOptions(even_spacing=True))


def test_few_shared_sensors_tell_no_moves():
    first, second = day(97), day(98).select([0, 1, 2, 7, 8, 9])
    sensor_map, evidence = quiet(mapped, first)
    with pytest.warns(anisomap.AnisomapWarning, match="too few sensors"):
        found = update_map(sensor_map, evidence, second)
    assert not found.moved
    assert found.map.placed.all()
    assert np.isfinite(found.agreement)


@pytest.mark.parametrize("method", ["r-anisomap", "i-anisomap", "spearman-anisomap"])
def test_other_methods_are_updated_too(method):
    first, second = day(101, without=("s18",)), day(102)
    found = quiet(update_map, *quiet(mapped, first, method=method), second)
    assert found.added == ("s18",)
    assert found.map.method == method
    whole = quiet(anisomap.reconstruct, [first, second], method, 2)
    assert score(found.map, whole, permutations=0).mantel.r > 0.99


def test_evidence_without_a_sensor_places_the_others():
    evidence = gather_evidence(day(111), dimensions=2).without(["s4"])
    made = quiet(map_evidence, evidence)
    assert not made.placed[4]
    assert made.placed.sum() == SENSORS - 1


def test_a_real_patch_gets_new_sensors_and_names_exchanged_wires(recordings_folder):
    """The iCub's six triangles: the second half adds five taxels, and two wires are exchanged."""
    whole = anisomap.read(recordings_folder / "icub_hexagon.npz").complete()
    half, n_sensors = whole.n_frames // 2, whole.n_sensors
    fresh, wires = [4, 17, 33, 46, 58], [8, 40]
    old = np.setdiff1d(np.arange(n_sensors), fresh)
    first = Recording(whole.readings[:half], names=whole.names).select(old)
    readings = np.array(whole.readings[half:])
    readings[:, wires] = readings[:, wires[::-1]]
    found = quiet(update_map, *quiet(mapped, first), named(readings, whole.names))
    assert set(found.moved) == {whole.names[i] for i in wires}
    assert set(found.added) == {whole.names[i] for i in fresh}
    made = found.map.select([found.map.names.index(name) for name in whole.names])
    truth = np.array(whole.positions)
    truth[wires] = truth[wires[::-1]]
    result = score(made, truth, permutations=0)
    assert np.sqrt(np.mean(result.alignment.errors[fresh] ** 2)) < 0.4 * result.spacing
    assert result.rms_in_spacings < 0.4
