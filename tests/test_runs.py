"""Several recordings of one skin: matching of sensors, pairs and positions."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from anisomap import Recording, join_runs, reconstruct, reconstruct_from, score
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import assess
from anisomap.methods import METHODS
from anisomap.options import MethodOptions
from anisomap.numerics.contacts import ContactOptions
from skins import flat_skin

SKIN = flat_skin(n_frames=3000)
NAMED = Recording(
    SKIN.readings, names=[f"pad{i}" for i in range(42)], positions=SKIN.positions, units="mm"
)


def frames(start: int, stop: int, sensors=slice(None), recording: Recording = NAMED) -> Recording:
    kept = recording.select(np.arange(42)[sensors])
    return replace(kept, readings=kept.readings[start:stop], rate_hz=50)


@pytest.mark.parametrize("method", METHODS)
def test_a_recording_split_into_runs_gives_the_same_map(method: str) -> None:
    order = np.random.default_rng(0).permutation(42)
    runs = [frames(0, 700), frames(700, 1900, order), frames(1900, 3000)]
    quick = MethodOptions(contacts=ContactOptions(max_readings=6000))
    whole = reconstruct(frames(0, 3000), method, 2, options=quick)
    parts = reconstruct(runs, method, 2, options=quick)
    assert parts.names == whole.names
    np.testing.assert_allclose(parts.positions, whole.positions, atol=1e-9)
    assert join_runs(runs).rate_hz == 50


@pytest.mark.parametrize("method", ["r-anisomap", "i-anisomap", "co-activation-anisomap"])
def test_sensors_may_be_missing_in_a_run(method: str) -> None:
    """The left two thirds of a skin in one run, the right two thirds in the other."""
    x = NAMED.positions[:, 0]
    runs = [frames(0, 1500, x < 4.4), frames(1500, 3000, x > 1.8)]
    with pytest.warns(AnisomapWarning, match="pairs of sensors were never recorded together"):
        found = reconstruct(runs, method, 2)
    joined = join_runs(runs)
    assert joined.n_frames == 3000
    assert found.placed.all()
    assert score(found, joined.positions, permutations=0).mantel.r > 0.9
    assert found.provenance["runs"] == 2


def test_pairs_are_compared_over_the_runs_that_contain_both() -> None:
    """Dropping what was missing anywhere leaves the map of the sensors that never were."""
    runs = [frames(0, 1500, slice(0, 36)), frames(1500, 3000, slice(6, 42))]
    found = reconstruct(runs, "r-anisomap", 2, drop=[*range(6), *range(36, 42)])
    expected = reconstruct(frames(0, 3000, slice(6, 36)), "r-anisomap", 2)
    placed = found.select(found.placed)
    assert placed.names == expected.names
    np.testing.assert_allclose(placed.positions, expected.positions, atol=1e-6)


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_pairs_are_correlated_as_pandas_does_where_readings_are_missing() -> None:
    rng = np.random.default_rng(1)
    runs = [frames(900 * i, 900 * (i + 1), rng.permutation(42)[: 42 - 4 * i]) for i in range(3)]
    joined = join_runs(runs)
    similarity = pd.DataFrame(joined.readings).corr().to_numpy()
    assert np.isfinite(similarity).all(), "all met, though not in all runs"
    found = reconstruct(runs, "r-anisomap", 2)
    expected = reconstruct_from(similarity=similarity, method="r-anisomap", dimensions=2)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-6)


def test_runs_without_common_sensors_are_refused() -> None:
    with pytest.raises(InputError, match="shares no sensor name"):
        join_runs([frames(0, 900, slice(0, 20)), frames(0, 900, slice(20, 42))])


def test_unnamed_runs_must_have_the_same_size() -> None:
    same = [Recording(SKIN.readings[:900]), Recording(SKIN.readings[900:])]
    np.testing.assert_array_equal(join_runs(same).readings, SKIN.readings)
    with pytest.raises(InputError, match=r"a\.csv has 42, b\.csv has 30; give names"):
        join_runs(
            [
                Recording(SKIN.readings, source="a.csv"),
                Recording(SKIN.readings[:, :30], source="b.csv"),
            ]
        )


def test_missing_readings_of_a_run_are_refused() -> None:
    readings = NAMED.readings[:900].copy()
    readings[7, 3] = np.nan
    runs = [Recording(readings, names=NAMED.names), frames(0, 900, slice(0, 40))]
    with pytest.raises(InputError, match="sensor pad3, frame 7"):
        reconstruct(runs, "r-anisomap", 2)


def test_contradictory_positions_are_discarded() -> None:
    moved = Recording(NAMED.readings[:900], names=NAMED.names, positions=SKIN.positions + 1)
    assert join_runs([frames(0, 900), moved]).positions is None
    assert join_runs([frames(0, 900), frames(0, 900)]).units == "mm"


def test_sensors_are_assessed_in_the_run_with_most_contacts() -> None:
    silent = np.array(NAMED.readings[:1500])
    silent[:, 5] = 0
    runs = [
        Recording(silent[:, :40], names=NAMED.names[:40]),
        frames(1500, 3000),
    ]
    assert assess(runs[0])[5].status == "dead"
    health = assess(runs)
    assert [sensor.name for sensor in health] == list(NAMED.names)
    assert health[5].status == "ok"
