"""Simulated recordings of all bodies and scenarios."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

import anisomap
from anisomap._version import __version__
from anisomap.errors import AnisomapWarning, InputError, install_command
from anisomap.simulation import BODIES, SCENARIOS, BombardmentOptions, find_body, simulate
from anisomap.simulation.bodies import sphere

pytest.importorskip("mujoco", reason="needs the extra 'simulation'")


def same_bytes(a, b):
    return a.readings.tobytes() == b.readings.tobytes() and dict(a.metadata) == dict(b.metadata)


def short(body, scenario, **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # a short run may not touch all sensors
        return simulate(body, scenario, n_frames=40, **settings)


# Each body with the cheapest scenario; distances along its surface take most of the time.
PAIRS = [
    *(("sphere", scenario) for scenario in SCENARIOS),
    ("hexagon", "rubbing"),
    *(
        pytest.param(body, "rubbing", marks=pytest.mark.slow)
        for body in BODIES
        if body not in ("sphere", "hexagon")
    ),
]


@pytest.mark.parametrize(("body", "scenario"), PAIRS)
def test_every_scenario_of_every_body_gives_a_documented_recording(body, scenario, tmp_path):
    made = find_body(body, None if body in ("hexagon", "plane", "cylinder") else 15)
    shares: list[float] = []
    recording = short(made, scenario, seed=3, progress=shares.append)
    assert shares[-1] == 1
    assert (np.diff(shares) > 0).all()
    np.testing.assert_array_equal(recording.positions, made.positions)
    np.testing.assert_array_equal(recording.normals, made.normals)
    assert recording.names == made.names
    assert len(recording.readings) == 40
    assert recording.readings.max() > recording.readings.min() >= 0
    assert (recording.units, recording.rate_hz) == ("m", 20)
    assert recording.source == f"simulated {scenario} of {body}, seed 3"
    metadata = dict(recording.metadata)
    known = {"body": body, "scenario": scenario, "seed": 3, "anisomap": __version__}
    rolled = (body, scenario) == ("cylinder", "locomotion")
    known["contacts"] = "elongated" if rolled else "compact"
    if SCENARIOS[scenario].uses_mujoco:
        known["mujoco"] = sys.modules["mujoco"].__version__
    assert known.items() <= metadata.items()
    assert all(type(value) in (str, int, float, bool) for value in metadata.values())
    defaults = vars(SCENARIOS[scenario].options())
    assert {name for name, value in defaults.items() if value is not None} <= metadata.keys()
    # The same seed gives the same bytes, another seed other readings.
    assert same_bytes(recording, short(made, scenario, seed=3))
    assert not np.array_equal(recording.readings, short(made, scenario, seed=4).readings)
    anisomap.write(recording, tmp_path / "run.npz")
    again = anisomap.read(tmp_path / "run.npz")
    assert same_bytes(recording, again)
    for name in ("positions", "normals", "surface_distances"):
        np.testing.assert_array_equal(getattr(again, name), getattr(recording, name))
    for name in ("names", "units", "source", "rate_hz"):
        assert getattr(again, name) == getattr(recording, name)


@pytest.mark.parametrize("scenario", ["bombardment", "locomotion"])
def test_at_a_smaller_detection_radius_readings_are_less_by_the_difference(scenario):
    wide, narrow = (short("sphere", scenario, detection_radius=r).readings for r in (0.5, 0.3))
    np.testing.assert_allclose(narrow, np.maximum(wide - 0.2, 0), atol=1e-6)
    assert narrow.any()


def test_effective_parameters_are_in_the_metadata():
    given = {"n_balls": np.int64(7), "detection_radius": 0.3, "frame_interval": 0.04}
    options = BombardmentOptions(**given)
    recording = simulate(n_frames=1, n_sensors=33, **given)
    assert recording.n_sensors == 33
    assert recording.rate_hz == pytest.approx(25)
    effective = {"n_balls": 7, "detection_radius": 0.3, "timestep": options.step}
    assert effective.items() <= dict(recording.metadata).items()
    assert 0 <= float(recording.metadata["energy_drift"]) < 0.02
    assert 0 <= float(recording.metadata["deepest_overlap"]) < 0.1


def test_a_recording_from_a_generator_can_be_reproduced():
    rng = np.random.default_rng(8)
    first, second = simulate(n_frames=20, seed=rng), simulate(n_frames=20, seed=rng)
    assert not np.array_equal(first.readings, second.readings)
    assert same_bytes(first, simulate(n_frames=20, seed=np.random.default_rng(8)))
    seed = second.metadata["seed"]
    assert isinstance(seed, int)
    assert same_bytes(second, simulate(n_frames=20, seed=seed))


def test_sensors_do_not_affect_the_dynamics():
    few, many = (simulate(n_frames=60, n_sensors=n).metadata for n in (20, 300))
    assert few == many
    assert {"energy_drift", "deepest_overlap", "timestep"} <= few.keys()


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_readings_scale_with_the_body(scenario):
    # A power of two: other factors round lengths, and paths over the skin part at thresholds.
    one, small = (short(body, scenario, seed=3) for body in (sphere(), sphere().scaled(1 / 16)))
    np.testing.assert_allclose(16 * small.readings, one.readings, atol=1e-5)


@pytest.mark.parametrize(
    ("scenario", "given", "message"),
    [
        ("bombardment", {"n_sensors": 0}, "n_sensors must be an integer .*, got 0"),
        ("bombardment", {"body": sphere(), "n_sensors": 9}, "cannot be given: sphere has 60"),
        ("bombardment", {"seed": 1.5}, r"seed must be .* got 1\.5"),
        ("bombardment", {"body": "teapot"}, "there is no body 'teapot'; choose from sphere"),
        ("rain", {}, "there is no scenario 'rain'; choose from bombardment"),
        ("bombardment", {"n_bals": 3}, "no parameter 'n_bals'; choose from frame_interval"),
        ("bombardment", {"ball_radius": -0.1}, r"ball_radius must be positive, got -0\.1 m"),
        ("bombardment", {"softness": 0.1}, r"softness must be at most 0\.075 m"),
        ("bombardment", {"timestep": 0.01}, r"at most 0\.00175 s.*would not be conserved"),
        ("bombardment", {"ball_radius": 1.1}, r"do not fit .* must exceed 3\.2 m"),
        ("locomotion", {"body": "hand"}, "the body hand does not roll"),
        ("locomotion", {"half_width": 2.0}, "half_width must be at least 4, got 2"),
        ("locomotion", {"cell": 0.3}, "cell must be at most half of correlation"),
        ("locomotion", {"roughness": 0.3}, r"at most 0.35 x correlation \(0.175 m\)"),
        ("rubbing", {"press_depth": 0.2}, "at most the thickness of the palm"),
        ("rubbing", {"speed": 100.0}, r"speed must be at most .* \(24 m/s\), got 100 m/s"),
    ],
)
def test_invalid_arguments_raise_an_error(scenario, given, message):
    with pytest.raises(InputError, match=message):
        simulate(scenario=scenario, **{"n_frames": 2} | given)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("value", [np.nan, -1])
def test_every_option_of_a_scenario_has_a_range(scenario, value):
    for name in vars(SCENARIOS[scenario].options()):
        with pytest.raises(InputError, match=f"{name} must be .*, got {value}"):
            simulate(scenario=scenario, n_frames=2, **{name: value})


def test_without_mujoco_only_simulations_fail():
    code = """
import sys
sys.modules["mujoco"] = None  # simulates a missing package
import anisomap.simulation as simulation
assert simulation.BODIES["sphere"](12).positions.shape == (12, 3)
try:
    simulation.simulate(n_frames=2)
except ImportError as error:
    print(error)
"""
    said = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert install_command("simulation") in said
