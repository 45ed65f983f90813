"""The verdict on a map: the rule, its evidence, and the maps that are not judged."""

import itertools
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.skins.independent import Case, make
from benchmarks.skins.readout import NOISES, noise
from hypothesis import given
from hypothesis import strategies as st
from tests.golden.cases import FOLDER

import anisomap
from anisomap import Recording, diagnose, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation import align
from anisomap.health import Finding
from anisomap.map_verdict import RANGES
from anisomap.method.pipeline import reconstruct_with_stages
from anisomap.verdict import LEVELS, UNKNOWN, Measurements, Verdict, judge
from anisomap.verdict.chance import regional_difference, rms_in_spacings
from anisomap.verdict.judge import neighbours_kept, region_error
from anisomap.verdict.second_map import differences_from_second_map, sensors_pair_off
from skins import flat_map, flat_skin, lattice

quiet = pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")

ERRORS = st.floats(0, 10)


def evidence(repeatability=0.1, difference=0.3, **others):
    known = {"metric": difference / 2, "regional": 0.7 * difference, "placed": 40, "largest": 40}
    return Measurements(repeatability, difference, **known | others)


def rank(verdict):
    return list(LEVELS).index(verdict.level)


@given(st.tuples(ERRORS, ERRORS), st.tuples(ERRORS, ERRORS), st.integers(0, 40), st.booleans())
def test_worse_evidence_never_improves_a_verdict(chances, differences, apart, faulty):
    chance, difference = sorted(chances), sorted(differences)
    faults = ("channels leak",) if faulty else ()
    better = judge(evidence(chance[0], difference[0], metric=chance[0]))
    others = {"metric": chance[1], "largest": 40 - apart, "faults": faults}
    worse = judge(evidence(chance[1], difference[1], **others))
    assert rank(worse) <= rank(better)
    assert worse.expected_error >= better.expected_error
    assert worse.region_error >= better.region_error
    assert worse.neighbours_kept <= better.neighbours_kept
    assert rank(judge(evidence(chance[0], difference[0], fatal=("no skin",)))) == 0


@given(ERRORS, ERRORS, ERRORS, st.booleans(), st.floats(-10, 100))
def test_an_error_if_the_skin_is_flat_is_expected(chance, difference, apart, spatial, gain):
    clear = judge(evidence(chance, difference, spatial=spatial))
    maps = {
        "between": apart,
        "regions_between": apart / 2,
        "spatial": spatial,
        "unclear": spatial,
        "extent": 9,
    }
    found = judge(evidence(chance, difference, **maps, gain=gain, chosen=True))
    error = clear.expected_error
    doubted = not 2.3 * error < apart < 0.35 * 9
    share = doubted if spatial else 1 if gain > 15 else 0.23
    assert found.expected_error == pytest.approx(math.hypot(error, math.sqrt(share) * apart))
    assert any(one.kind in ("if-flat", "if-bent") for one in found.reasons) == (apart > 0)
    assert rank(found) <= rank(clear)


@given(ERRORS, ERRORS)
def test_uneven_sensors_are_usable_only_if_they_and_compact_contacts_are_stated(chance, difference):
    uneven = evidence(chance, difference, uneven=True, contacts="compact")
    known = replace(uneven, known_uneven=True)
    unstated, compact, elongated = (
        judge(replace(known, contacts=contacts)) for contacts in ("", "compact", "elongated")
    )
    assert max(rank(unstated), rank(elongated), rank(judge(uneven))) < 2
    assert compact.expected_error == unstated.expected_error <= elongated.expected_error
    assert (
        judge(replace(known, contacts="compact", extent=1e3)).expected_error
        == unstated.expected_error
    )
    kinds = [next(iter(one.reasons)).kind for one in (unstated, compact, elongated)]
    assert kinds == ["if-compact", "compact", "if-compact"]
    assert rank(compact) == 2 or compact.expected_error >= 0.5
    even = evidence(chance, difference)
    assert rank(judge(replace(even, contacts="elongated"))) <= rank(judge(even))


@quiet
def test_a_map_of_random_places_needs_a_statement_of_contacts():
    recording = make(Case("random-sphere:n=45", "poke", "linear", "", 2500, 31034))
    made, stages = reconstruct_with_stages(recording, dimensions=3)
    found = {
        (stated, told): diagnose(
            made,
            replace(recording, metadata={"contacts": told} if told else {}),
            contacts=stated,
            uneven=True,
            stages=stages,
        )
        for stated, told in (("", ""), ("compact", ""), ("", "compact"), ("elongated", "compact"))
    }
    levels = {key: one.verdict.level for key, one in found.items()}
    assert levels["", ""] == levels["elongated", "compact"] == "usable for neighbours"
    assert levels["compact", ""] == levels["", "compact"] == "usable"
    assert [one.provenance.get("contacts") for one in found.values()] == [
        *(None, "compact", "compact", "elongated")
    ]
    with pytest.raises(InputError, match="compact or elongated"):
        diagnose(made, recording, contacts="round", stages=stages)


def test_an_error_of_half_the_extent_leaves_no_neighbours_usable():
    assert judge(evidence(0.3, 1.5, extent=2.0)).level == "usable for neighbours"
    assert judge(evidence(0.3, 1.5, extent=1.3)).level == "not usable"


@given(ERRORS, ERRORS)
def test_every_verdict_has_reasons_and_intervals_around_its_numbers(chance, difference):
    found = judge(evidence(chance, difference))
    assert found.reasons[0] in str(found)
    if found.level == "usable":
        assert found.expected_error < 0.5
        assert not any("record longer" in text for text in found.reasons)
    for name in RANGES:
        low, value, high = (getattr(found, f"{name}{end}") for end in ("_low", "", "_high"))
        assert 0 <= low <= value <= high
    assert found.neighbours_kept_high <= 1
    error = evidence(chance, difference).error.value
    region = region_error(chance, 0.7 * difference, error).value
    assert found.region_error == region <= found.expected_error == error
    assert found.neighbours_kept == neighbours_kept(region).value


def test_regions_show_noise_as_the_whole_does_but_not_a_slow_change_of_scale():
    places = lattice(14, 14)
    stretched = places.copy()
    stretched[:, 0] += 0.03 * places[:, 0] ** 2
    noisy = places + np.random.default_rng(0).normal(0, 0.1, places.shape)
    for other, least, most in ((stretched, 0, 0.6), (noisy, 0.9, 1.05)):
        aligned = align(other, places).aligned - places
        whole, regions = rms_in_spacings(aligned, places), regional_difference(aligned, places)
        assert least * whole <= regions <= most * whole
        doubled = regional_difference(2 * aligned, 2 * places)
        assert doubled == pytest.approx(regions)


def test_a_map_that_is_stretched_slowly_has_right_neighbours():
    found = judge(evidence(0.05, 2.0, regional=0.4))
    assert found.level == "usable for neighbours"
    assert judge(evidence(0.05, 2.0, regional=1.4)).level == "not usable"


def test_only_faults_that_no_measurement_shows_exclude_usable_maps():
    assert judge(evidence()).level == "usable"
    found = judge(evidence(unseen=("channels leak",)))
    assert (found.level, found.reasons[0]) == ("usable for neighbours", "channels leak")
    told = judge(evidence(faults=("sensors hum",)))
    assert (told.level, "sensors hum" in told.reasons) == ("usable", False)
    assert judge(evidence(5.0, 5.0, faults=("sensors hum",))).reasons[0] == "sensors hum"
    apart = judge(evidence(largest=30))
    assert apart.level == "usable for neighbours"
    assert "10 of 40" in apart.reasons[0]
    assert judge(evidence(largest=37)).level == "usable"
    assert judge(evidence(5.0, 5.0)).level == "not usable"


def test_without_measurements_nothing_can_be_told():
    for unknown in (
        Measurements(unknown="too short: record longer"),
        Measurements(repeatability=0.1),
    ):
        found = judge(unknown)
        assert found.level == UNKNOWN
        assert math.isnan(found.expected_error)
    assert str(judge(Measurements(unknown="too short"))) == "cannot tell; too short"


def test_levels_are_ordered_and_checked():
    for worse, better in itertools.combinations(LEVELS, 2):
        assert Verdict(better).is_at_least(worse)
        assert not Verdict(worse).is_at_least(better)
        assert Verdict(worse).is_at_least(worse)
        assert not Verdict(UNKNOWN).is_at_least(worse)
    for wrong in (lambda: Verdict("good"), lambda: Verdict().is_at_least("good")):
        with pytest.raises(InputError, match="usable for neighbours"):
            wrong()


def test_levels_of_former_versions_are_read():
    assert Verdict("usable locally").level == "usable for neighbours"
    assert Verdict("unknown").level == UNKNOWN


@quiet
@pytest.mark.slow
def test_expected_errors_are_near_the_true_ones_and_larger_for_short_recordings():
    short, long = [], []
    for seed in range(4):
        for n_frames, found in ((120, short), (1500, long)):
            skin = flat_skin(seed=seed, n_frames=n_frames)
            made = diagnose(reconstruct(skin, dimensions=2), skin)
            true = anisomap.score(made, skin.positions, permutations=0).rms_in_spacings
            found.append((made.verdict.expected_error, true))
    assert min(e for e, _ in short) > max(e for e, _ in long)
    # These maps are of the easiest kind: errors are in the lower half of what is expected.
    assert 1 / 2 < np.median([e / true for e, true in short + long]) < 5


@quiet
@pytest.mark.parametrize("name", ["leak", "one-period", "holed-plate-pulses"])
def test_expected_errors_do_not_depend_on_the_order_of_sensors(name):
    # Another order rounds otherwise, as another processor does.
    plain = anisomap.read(FOLDER / "readings" / f"{name}.npz")
    found = []
    for seed in (None, 0, 1):
        order = np.random.default_rng(seed).permutation(plain.n_sensors)
        recording = plain if seed is None else plain.select(order)
        made, stages = reconstruct_with_stages(recording, dimensions=2)
        inside = made.component == 0
        evidence_of_part = stages.evidence.select(stages.configuration.component == 0)
        differences = differences_from_second_map(evidence_of_part, made.positions[inside])
        found.append(rms_in_spacings(differences, made.positions[inside]))
    assert np.ptp(found) < 1e-3


def test_long_contacts_are_worse_than_a_plain_skin():
    """They are wrong in ways that maps of the same recording share."""

    def judged(readings):
        made = reconstruct(readings, dimensions=2)
        return diagnose(made, readings).verdict

    plain = judged(flat_skin(n_frames=1000).readings)
    long = judged(make(Case("plate:n=72", "rolling", "exact")).readings)
    assert plain.level == "usable"
    assert long.level != "usable"
    assert long.expected_error > 2 * plain.expected_error


@quiet
def test_faults_that_the_error_does_not_show_limit_the_verdict():
    skin, made = flat_skin(n_frames=800), flat_map(n_frames=800)
    assert verdict(made, skin).level == "usable"
    limits = {
        "spikes": ("usable", {"height": 1.0}),
        "copies": ("usable for neighbours", {"noise": 0.0, "kept": None}),
        "changed": ("not usable", {"frame": 9, "n_frames": 99}),
    }
    for kind, (level, values) in limits.items():
        fault = Finding(kind, (), 1.0, values)
        assert diagnose(made, skin, findings=[fault]).verdict.level == level


@quiet
def test_insufficient_evidence_says_what_to_record():
    rng = np.random.default_rng(0)
    noisy = flat_skin(n_frames=400).readings + rng.normal(0, 2.5, (400, 42))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = diagnose(reconstruct(noisy, dimensions=2), noisy)
    assert made.notes == tuple(str(w.message) for w in told if w.category is AnisomapWarning)
    assert made.verdict.level == "not usable"
    assert any("record longer" in reason for reason in made.verdict.reasons)


def verdict(made, recording):
    return diagnose(made, recording).verdict


@quiet
def test_a_map_of_unclear_dimensions_is_not_usable_if_a_flat_one_differs():
    """A flat skin with readings on and off, of which the map has three dimensions."""
    with np.load(FOLDER / "readings" / "binary.npz") as stored:
        readings = stored["readings"]
    made = reconstruct(readings)
    assert made.dimensions == 3
    found = diagnose(made, readings).verdict
    flat = reconstruct(readings, dimensions=2)
    assert found.level != "usable"
    assert any(reason.kind == "if-flat" for reason in found.reasons)
    assert diagnose(flat, readings).verdict.level == "usable"


@quiet
def test_the_verdict_is_unknown_for_few_sensors():
    few = Recording(flat_skin().readings[:, :8])
    assert "a verdict needs 12" in str(verdict(reconstruct(few, dimensions=2), few))


@quiet
def test_runs_that_lack_sensors_are_judged_by_those_that_all_have():
    skin = flat_skin()
    runs = [skin.select(range(30)), skin.select(range(12, 42))]
    found = diagnose(reconstruct(runs, dimensions=2), runs)
    assert found.verdict.level != UNKNOWN
    assert np.isfinite(found.covariances[12:30]).all()
    assert np.isnan(found.covariances[:12]).all()
    apart = [skin.select(range(24)), skin.select(range(18, 42))]
    assert "sensors in common" in str(verdict(reconstruct(apart, dimensions=2), apart))


@quiet
def test_the_verdict_is_unknown_without_readings_or_refinement():
    skin, made = flat_skin(n_frames=300), flat_map(n_frames=300)
    assert made.verdict.level == UNKNOWN
    assert "r-anisomap" in str(verdict(flat_map("r-anisomap", n_frames=300), skin))
    similarity = np.corrcoef(skin.readings.T)
    assert reconstruct_from(similarity=similarity).verdict.level == UNKNOWN
    assert diagnose(made, skin, with_verdict=False).verdict == Verdict()


def test_diagnosis_requires_the_sensors_of_the_map():
    skin = flat_skin(n_frames=300)
    made = reconstruct(skin, "r-anisomap", 2)
    with pytest.raises(InputError, match="must have the same sensors"):
        diagnose(made, skin.select(range(40)))


@quiet
def test_maps_that_do_not_follow_from_the_recording_are_not_trusted():
    skin = flat_skin()
    rng = np.random.default_rng(0)
    noise = rng.uniform(1, 2, (42, 42))
    precomputed = {"similarity": np.corrcoef(skin.readings.T), "dissimilarity": noise + noise.T}
    for stage, matrix in precomputed.items():
        np.fill_diagonal(matrix, 1 if stage == "similarity" else 0)
        made = reconstruct_from(method="r-anisomap", dimensions=2, **{stage: matrix})
        assert verdict(made, skin).level == UNKNOWN
    made = flat_map()
    assert verdict(made, skin).level == "usable"
    shuffled = replace(made, positions=made.positions[rng.permutation(42)])
    assert verdict(shuffled, skin).level == UNKNOWN


def test_a_verdict_needs_complete_readings():
    skin = flat_skin(n_frames=300)
    readings = np.array(skin.readings)
    readings[7, 3] = np.nan
    with pytest.raises(InputError, match="sensors: s3; frames: 7"):
        diagnose(flat_map(n_frames=300), readings)


@quiet
def test_diagnosis_can_be_repeated_and_knows_dropped_sensors():
    readings = np.array(flat_skin(n_frames=300).readings)
    readings[:, 8] = np.random.default_rng(0).uniform(size=300)
    made = reconstruct(readings, "r-anisomap", 2, drop=[8])
    once = diagnose(made, readings)
    assert not any("s8" in note for note in once.notes)
    assert diagnose(once, readings).notes == once.notes


def test_sensors_are_unassessed_before_a_diagnosis():
    skin = flat_skin(n_frames=600)
    made = reconstruct(skin, "r-anisomap", 2)
    assert set(made.health) == {"unassessed"}
    assert set(diagnose(made, skin).health) == {"ok"}


@quiet
def test_a_diagnosis_alone_is_that_with_the_stages_of_the_map():
    skin = flat_skin(n_frames=800)
    made, stages = reconstruct_with_stages(skin, dimensions=2, drop=["s3"])
    known = diagnose(made, skin, drop=["s3"], stages=stages)
    alone = diagnose(made, skin, drop=["s3"])
    elsewhere = diagnose(replace(made, positions=7 - 3 * made.positions), skin, drop=["s3"])
    assert alone.verdict == known.verdict
    np.testing.assert_array_equal(alone.covariances, known.covariances)
    assert elsewhere.verdict.expected_error == pytest.approx(known.verdict.expected_error, 1e-3)
    np.testing.assert_allclose(elsewhere.covariances, 9 * known.covariances, rtol=0.01, atol=1e-9)


@quiet
def test_a_map_that_was_changed_is_not_judged_by_its_stages():
    skin = flat_skin(n_frames=300)
    made, stages = reconstruct_with_stages(skin, dimensions=2)
    moved = made.positions + np.random.default_rng(0).normal(size=made.positions.shape)
    changed = diagnose(replace(made, positions=moved), skin, stages=stages)
    assert changed.verdict.level == UNKNOWN


@quiet
@pytest.mark.parametrize("kind", NOISES)
def test_noise_without_geometry_is_never_usable(kind):
    for seed in range(4):
        readings = noise(kind, n_sensors=16 + 4 * seed, seed=seed)
        try:
            made = reconstruct(readings, dimensions=2)
        except InputError:
            continue  # no two sensors are related
        assert not diagnose(made, readings).verdict.is_at_least("usable for neighbours")


def test_what_makes_neighbours_doubtful_excludes_maps_of_neighbours():
    for doubtful in ({"agreement": 0.3}, {"rarely": 21}, {"paired": True}):
        found = judge(evidence(**doubtful))
        assert found.level == "not usable"
        assert found.reasons[0] not in judge(evidence()).reasons
    assert judge(evidence(agreement=0.9, rarely=19)).level == "usable"


@quiet
def test_places_that_are_always_touched_together_are_not_usable():
    skin = make(Case("strip:n=48", "poke", n_frames=1500, seed=2))
    one = skin.readings[:, : skin.n_sensors // 2]
    both = np.column_stack([one, one + 0.02 * np.random.default_rng(0).normal(size=one.shape)])
    made = diagnose(reconstruct(both, dimensions=2), both)
    assert made.verdict.level == "not usable"
    assert not sensors_pair_off(np.corrcoef(skin.readings.T))
