"""Maps that are kept up to date: pooled evidence, new and moved sensors, and the frame."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, SensorMap
from anisomap.errors import InputError
from anisomap.evaluation import compare_maps, score
from anisomap.method.evidence import SIMILARITIES
from anisomap.numerics.similarity.correlation import pearson, spearman
from anisomap.placement import Anchors, place
from anisomap.tracking import PairSums, gather_evidence, map_evidence, update_map
from skins import flat_skin, lattice, quietly, rubbed

seeds = st.integers(0, 10_000)
SENSORS = 42


def named(readings, names=None):
    return Recording(readings, names=tuple(names or (f"s{i}" for i in range(readings.shape[1]))))


@cache
def day(seed, *without):
    """Return a recording of the flat skin, without some sensors."""
    recording = named(flat_skin(seed=seed).readings)
    return recording.select([i for i, name in enumerate(recording.names) if name not in without])


def mapped(recording, method="r-anisomap"):
    return (
        anisomap.reconstruct(recording, method, 2),
        gather_evidence(recording, method, 2),
    )


@cache
def first_day(*without):
    """Return a map of the first day, and the evidence that it was made of."""
    return mapped(day(11, *without))


def rows_of(sensor_map):
    """Return the rows of s0, s1 ..., in that order."""
    return [sensor_map.names.index(f"s{i}") for i in range(SENSORS)]


def same_evidence(first, second):
    order = [second.names.index(name) for name in first.names]
    assert sorted(first.names) == sorted(second.names)
    assert first.recordings == second.recordings
    for key, sums in first.sums.items():
        for field, values in vars(sums).items():
            other = getattr(second.sums[key], field)[np.ix_(order, order)]
            np.testing.assert_allclose(values, other, rtol=1e-10, atol=1e-10)


@given(seeds, st.integers(2, 12), st.integers(2, 12))
@settings(max_examples=8)
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
    np.testing.assert_allclose(found.noise, chosen.with_variance(readings, 4)[1], rtol=1e-12)
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
    sums = [PairSums.of(readings, "pearson", bins=6) for readings in (first, second + 100)]
    pooled = sums[0].merged(sums[1])
    others = ~np.eye(6, dtype=bool)
    assert np.abs(pooled.statistics("pearson").similarity[others]).max() < 0.1
    assert np.abs(pearson(np.concatenate([first, second + 100]))[others]).min() > 0.9


@pytest.mark.parametrize("method", ["covariogram", "i-anisomap", "spearman-anisomap"])
def test_new_sensors_are_placed_as_well_as_by_a_map_of_everything(method):
    fresh = ("s3", "s17", "s25", "s40")
    first, second = day(11, *fresh), day(61)
    found = quietly(update_map, *quietly(mapped, first, method), second)
    whole = quietly(anisomap.reconstruct, [first, second], method, 2)
    assert set(found.added) == set(fresh)
    assert found.map.method == method
    assert not found.moved
    assert not found.unplaced
    errors = []
    for made in (found.map, whole):
        result = score(made.select(rows_of(made)), lattice(), permutations=0)
        errors.append(np.sqrt(np.mean(result.alignment.errors[[3, 17, 25, 40]] ** 2)))
    assert errors[0] < 1.5 * errors[1] + 0.1
    assert not compare_maps(whole, found.map).moved.any()


def test_an_update_equals_a_map_of_both_recordings_and_the_order_does_not_matter():
    first, second = day(11), day(22)
    forth = quietly(update_map, *first_day(), second)
    back = quietly(update_map, *quietly(mapped, second), first)
    same_evidence(forth.evidence, back.evidence)
    whole = quietly(anisomap.reconstruct, [first, second], "r-anisomap", 2)
    for one, other in ((forth.map, back.map), (forth.map, whole)):
        found = compare_maps(one, other)
        off = np.linalg.norm(found.after - found.before, axis=1) / found.spacing
        assert np.median(off) < 0.15
        assert not found.moved.any()


def test_the_frame_the_units_and_the_hand_of_a_placed_map_are_kept():
    truth = 0.006 * lattice() @ [[0.0, 1.0], [1.0, 0.0]] + [0.1, -0.3]  # mirrored
    sensor_map, evidence = first_day("s20")
    anchors = [0, 6, 21, 38, 15]
    placed = place(sensor_map, Anchors(tuple(f"s{i}" for i in anchors), truth[anchors])).map
    found = quietly(update_map, placed, evidence, day(32)).map
    assert (found.units, found.anchored, found.handed) == ("m", True, True)
    assert found.names == (*placed.names, "s20")
    off = np.linalg.norm(found.positions - truth[[int(name[1:]) for name in found.names]], axis=1)
    assert np.median(off) < 0.5 * 0.006
    assert (off <= found.errors + 1e-12).mean() > 0.8
    assert off[-1] <= found.errors[-1]
    measured = [found.names.index(f"s{i}") for i in anchors]
    assert off[measured].max() < 1e-12  # what was measured stays


def test_corrections_of_an_old_map_are_kept():
    """A map that was bent smoothly after it was made stays bent."""
    sensor_map, evidence = first_day("s20")
    points = sensor_map.positions - sensor_map.positions.mean(axis=0)
    size = np.abs(points).max()

    def bent(x):
        return x + 0.15 * x[:, ::-1] ** 2 / size

    old, straight = (SensorMap(p, names=sensor_map.names) for p in (bent(points), points))
    found, plain = (quietly(update_map, made, evidence, day(32)).map for made in (old, straight))
    spacing = compare_maps(old, old).spacing
    off = np.linalg.norm(found.positions - bent(plain.positions), axis=1)
    assert np.median(off) < 0.05 * spacing
    assert off[-1] < 0.3 * spacing  # the new sensor takes the corrections of its neighbours


def test_sensors_that_the_recording_lacks_stay():
    sensor_map, evidence = first_day()
    dead = named(np.where(np.arange(41) == 7, 0, day(32, "s41").readings), day(32, "s41").names)
    found = quietly(update_map, sensor_map, evidence, dead)
    assert set(found.silent) == {"s7", "s41"}
    assert found.map.placed.all()
    rows = found.map.indices(found.silent)
    assert found.difference.distance[rows].max() < found.difference.spacing
    assert not found.moved
    assert found.map.health[7] == "silent"  # in the new recording


@pytest.mark.parametrize("seed", [61, 62])
def test_sensors_that_were_rewired_are_named_and_not_averaged(seed):
    sensor_map, evidence = first_day()
    readings = day(seed).readings.copy()
    readings[:, [8, 33]] = readings[:, [33, 8]]
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
    once = quietly(update_map, *first_day("s20"), day(32, "s9"))
    twice = quietly(update_map, once.map, once.evidence, day(22))
    assert twice.map.placed.all()
    assert len(twice.evidence.recordings) == 3
    assert twice.evidence.n_frames == 4500
    assert score(twice.map.select(rows_of(twice.map)), lattice()).rms_in_spacings < 0.3


def scrambled(recording):
    order = np.random.default_rng(0).permutation(recording.n_sensors)
    return named(recording.readings[:, order])


def holed(recording):
    readings = recording.readings.copy()
    readings[3, 5] = np.nan
    return named(readings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: named(np.zeros((50, SENSORS))), "no evidence of distances"),
        (lambda r: day(11), "part of the evidence already"),
        (scrambled, "contradicts the map"),
        (lambda r: named(r.readings, [f"t{i}" for i in range(SENSORS)]), "shares 0"),
        (lambda r: r.select([0, 1]), "shares 2 varying sensors"),
        (holed, "NaN or infinite"),
    ],
)
def test_recordings_that_say_nothing_or_contradict_the_map_are_refused(change, message):
    with pytest.raises(InputError, match=message) as refused:
        quietly(update_map, *first_day(), change(day(32)))
    assert len(str(refused.value)) < 300


def test_statistics_of_another_map_are_refused():
    sensor_map, evidence = first_day()
    order = np.random.default_rng(0).permutation(SENSORS)
    other = SensorMap(sensor_map.positions[order], names=sensor_map.names)
    strange = SensorMap(sensor_map.positions, names=[f"t{i}" for i in range(SENSORS)])
    for wrong in (other, strange):
        with pytest.raises(InputError, match=r"statistics belong to|contradicts the map"):
            quietly(update_map, wrong, evidence, day(32))
    with pytest.raises(InputError, match="level"):
        update_map(sensor_map, evidence, day(32), level=0)
    with pytest.raises(InputError, match="even spacing"):
        gather_evidence(day(32), options=anisomap.MethodOptions(even_spacing=True))


def test_few_shared_sensors_tell_no_moves():
    with pytest.warns(anisomap.AnisomapWarning, match="too few sensors"):
        found = update_map(*first_day(), day(32).select([0, 1, 2, 7, 8, 9]))
    assert not found.moved
    assert found.map.placed.all()
    assert np.isfinite(found.agreement)


def test_evidence_without_a_sensor_places_the_others():
    made = quietly(map_evidence, first_day()[1].without(["s4"]))
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
    found = quietly(
        update_map, *quietly(mapped, first, "covariogram"), named(readings, whole.names)
    )
    assert set(found.moved) == {whole.names[i] for i in wires}
    assert set(found.added) == {whole.names[i] for i in fresh}
    made = found.map.select([found.map.names.index(name) for name in whole.names])
    truth = np.array(whole.positions)
    truth[wires] = truth[wires[::-1]]
    result = score(made, truth, permutations=0)
    assert np.sqrt(np.mean(result.alignment.errors[fresh] ** 2)) < 0.7 * result.spacing
    assert result.rms_in_spacings < 0.6
