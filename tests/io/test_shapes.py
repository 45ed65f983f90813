"""Shapes of recordings that people have: columns that are no sensors, axes, sessions, folders."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.io import ReadOptions
from anisomap.names import match_sensors
from anisomap.recording import Recording, join_runs

N_SENSORS, N_FRAMES = 12, 600
RNG = np.random.default_rng(8)
PRESSED = np.where(
    RNG.random((N_FRAMES, N_SENSORS)) < 0.2, RNG.integers(20, 900, (N_FRAMES, N_SENSORS)), 0
)
NAMES = [f"c{k}" for k in range(N_SENSORS)]
VECTORS = RNG.normal(size=(N_FRAMES, N_SENSORS, 3)).round(3)


def text(names: list[str], rows: Any) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in [names, *np.asarray(rows).tolist()])


SPELLINGS = {
    "c0_x": [f"c{k}_{a}" for k in range(N_SENSORS) for a in "xyz"],
    "c0.Bx": [f"c{k}.B{a}" for k in range(N_SENSORS) for a in "xyz"],
    "T00 X": [f"T{k:02d} {a}" for k in range(N_SENSORS) for a in "XYZ"],
    "c0x": [f"c{k}{a}" for k in range(N_SENSORS) for a in "xyz"],
    "c0[x]": [f"c{k}[{a}]" for k in range(N_SENSORS) for a in "xyz"],
    "taxel 0/Fx [N]": [f"taxel {k}/F{a} [N]" for k in range(N_SENSORS) for a in "xyz"],
    "x_c0": [f"{a}_c{k}" for k in range(N_SENSORS) for a in "xyz"],
    "Fx_c0": [f"F{a}_c{k}" for k in range(N_SENSORS) for a in "xyz"],
    "x0": [f"{a}{k}" for k in range(N_SENSORS) for a in "xyz"],
    "mag0_x": [f"mag{k}_{a}" for k in range(N_SENSORS) for a in "xyz"],
}


@pytest.mark.parametrize("spelling", SPELLINGS)
@pytest.mark.parametrize("in_blocks", [False, True])
def test_taxels_with_three_axes(put, spelling: str, in_blocks: bool) -> None:
    names, order = SPELLINGS[spelling], np.arange(3 * N_SENSORS)
    if in_blocks:  # all x before all y
        order = order.reshape(N_SENSORS, 3).T.ravel()
    rows = VECTORS.reshape(N_FRAMES, -1)[:, order]
    path = put("axes.csv", text([names[i] for i in order], rows))
    for axis, expected in (("z", VECTORS[:, :, 2]), ("x", VECTORS[:, :, 0])):
        with pytest.warns(AnisomapWarning, match=f"12 taxels with three axes: {axis} is read"):
            found = io.read(path, options=ReadOptions(axis=axis))
        np.testing.assert_array_equal(found.readings, expected)
    assert io.read(path, options=ReadOptions(axis="all")).n_sensors == 3 * N_SENSORS


@pytest.mark.parametrize("part", ["acc", "gyro", "imu"])
def test_inertial_units_are_no_taxels(put, part: str) -> None:
    names = [f"{part}{k}_{a}" for k in range(5) for a in "xyz"]
    rows = np.column_stack([PRESSED, RNG.normal(size=(N_FRAMES, 15))])
    path = put("imu.csv", text([*(f"s{k}" for k in range(N_SENSORS)), *names], rows))
    found = io.read(path, options=ReadOptions(keep=("s0-s11", f"{part}*")))
    assert found.n_sensors == N_SENSORS + 15


BESIDE = {
    "label": (RNG.integers(0, 3, N_FRAMES), "a label"),
    "Class": (np.arange(N_FRAMES) // 100, "a label"),
    "subject_id": (np.arange(N_FRAMES) // 200, "a label"),
    "acc_x": (RNG.normal(size=N_FRAMES), "an inertial unit"),
    "temperature": (24 + RNG.normal(size=N_FRAMES), "a temperature"),
    "seq": (np.arange(N_FRAMES) % 256, "a counter"),
    "n": (np.arange(N_FRAMES) % 256, "a counter"),
    "phase": (np.arange(N_FRAMES) // 150, "a label"),
    "\u00b0C": (24 + RNG.normal(size=N_FRAMES), "a quantity in \u00b0C"),
    "Event": (np.full(N_FRAMES, ""), "mostly empty"),
    "F": (PRESSED.sum(axis=1), "the sum of all others"),
}


@pytest.mark.filterwarnings("ignore:.*is taken as a frame counter")
@pytest.mark.parametrize("name", BESIDE)
@pytest.mark.parametrize("last", [False, True])
def test_columns_that_are_no_sensors(put, name: str, last: bool) -> None:
    values, what = BESIDE[name]
    names = [*NAMES, name] if last else [name, *NAMES]
    columns = (PRESSED, values) if last else (values, PRESSED)
    path = put("run.csv", text(names, np.column_stack(columns).astype(object)))
    if name in ("seq", "n"):  # frames are counted, with or without a warning
        np.testing.assert_array_equal(io.read(path).readings, PRESSED)
        return
    with pytest.warns(AnisomapWarning, match=rf"{name}: {what}.*--keep"):
        found = io.read(path)
    np.testing.assert_array_equal(found.readings, PRESSED)
    assert found.names == tuple(NAMES)
    kept = io.read(path, options=ReadOptions(keep=("c0-c5", "c1?", name)))
    assert kept.names == tuple(n for n in names if n in (*NAMES[:6], "c10", "c11", name))


COUNT = np.arange(N_FRAMES)
UNLIKE = {
    "only 2 values": COUNT % 100 < 50,
    "apart from all others": RNG.integers(5000, 5040, N_FRAMES),
    "constant": 7 * COUNT**0 + 7000,
    "it never falls": 9000 + (RNG.random(N_FRAMES) < 0.1).cumsum(),
    "it never rises": 3921 - COUNT // 37,
    "with decimals": 24 + RNG.normal(size=N_FRAMES),
}
"""Columns without a name; all but the last are read nevertheless."""


@pytest.mark.parametrize("what", UNLIKE)
@pytest.mark.parametrize("last", [False, True])
def test_columns_unlike_the_others(put, what: str, last: bool) -> None:
    values, names = 1 * UNLIKE[what], [*UNLIKE][:-1]
    rows = np.column_stack([PRESSED, values] if last else [values, PRESSED]).astype(object)
    with pytest.warns(AnisomapWarning, match=rf"column {13 if last else 1}: {what}\); give --keep"):
        found = io.read(put("run.csv", text([], rows).lstrip()))
    kept = np.delete(found.readings, -1 if last else 0, axis=1) if what in names else found.readings
    np.testing.assert_array_equal(kept, PRESSED)


def test_two_numbers_of_each_sensor_are_told(put) -> None:
    names = [f"{name}{end}" for name in NAMES for end in ("", "_q")]
    rows = np.repeat(PRESSED, 2, axis=1)
    with pytest.warns(AnisomapWarning, match="two numbers of each, '' and '_q'"):
        assert io.read(put("run.csv", text(names, rows))).names == tuple(names)
    with pytest.warns(AnisomapWarning, match="x, y and z of a taxel"):
        io.read(put("xyz.csv", text([], (VECTORS * [1, 1, 9]).reshape(N_FRAMES, -1)).lstrip()))


def test_columns_beside_pressures_of_insoles(put) -> None:
    """Inertial units, sums and centres of pressure, which are empty without load."""
    others = ["acceleration X[g]", "angular Y[dps]", "total force[N]", "mass[kg]"]
    others.append("center of pressure X[-1...1]")
    names = [f"{s} pressure {k}[N/cm\u00b2]" for s in ("left", "right") for k in range(6)]
    rows = np.column_stack([PRESSED, RNG.normal(size=(N_FRAMES, 5))]).round(2).astype(object)
    rows[100:130, -1] = ""
    path = put("insole.csv", text([*names, *(f"left {name}" for name in others)], rows))
    with pytest.warns(AnisomapWarning, match="are left out") as said:
        found = io.read(path)
    assert len(said) == 1
    np.testing.assert_array_equal(found.readings, PRESSED)


def test_quantities_beside_the_forces_of_taxels(put) -> None:
    quantities = ["fx", "fy", "fz", "dx", "dy", "dz", "contact"]
    names = ["gfx", "gfy", "gfz", "gtz"]
    names += [f"pil{k} {quantity}" for k in range(9) for quantity in quantities]
    values = RNG.normal(size=(N_FRAMES, len(names) + 1)).round(3)
    path = put("pillars.csv", text([*names, "angle"], values))
    said = [
        pytest.warns(AnisomapWarning, match=m)
        for m in ("9 taxels with th", "left out .pil0 contact")
    ]
    with said[0], said[1]:
        found = io.read(path)
    assert found.names == tuple(f"pil{k}" for k in range(9))
    np.testing.assert_array_equal(found.readings, values[:, [6 + 7 * k for k in range(9)]])
    with pytest.warns(AnisomapWarning, match="a flag"):
        assert io.read(path, options=ReadOptions(axis="all")).n_sensors == 6 * 9 + 5


@pytest.mark.parametrize(
    "names", [["thumb", "index", "middle", "ring"], ["state0", "state1", "state2", "palm"]]
)
def test_sensors_stay_sensors(put, names: list[str]) -> None:
    assert io.read(put("hand.csv", text(names, PRESSED[:, :4]))).names == tuple(names)


@pytest.mark.parametrize("unit", ["[kPa]", "(N)", "[mV]", "(counts)", "[a.u.]"])
def test_units_leave_names(put, unit: str) -> None:
    path = put("run.csv", text([f"{name} {unit}" for name in NAMES], PRESSED))
    layout = put("layout.csv", "name,x,y\n" + "".join(f"c{k},{k},0\n" for k in range(12)))
    found = io.read(path, options=ReadOptions(positions=layout))
    assert found.names == tuple(NAMES)
    np.testing.assert_array_equal(found.positions[:, 0], np.arange(12))


def test_names_are_matched_by_order_only_where_a_side_has_none() -> None:
    rows, notes = match_sensors(("s0", "s1", "s2"), ("a", "b", "c"), "layout and recording")
    assert rows.tolist() == [0, 1, 2]
    assert "by order" in notes[0]
    with pytest.raises(InputError, match=r"share no sensor name \(u \.\.\. w and a \.\.\. c\)"):
        match_sensors(("u", "v", "w"), ("a", "b", "c"), "layout and recording")


def test_rows_of_a_grid(put) -> None:
    frames = RNG.integers(0, 99, (50, 6, 4))
    lines = (" ".join(map(str, row)) for row in frames.reshape(-1, 4).tolist())
    path = put("mat.txt", "\n".join(lines))
    found = io.read(path, options=ReadOptions(grid=(6, 4)))
    np.testing.assert_array_equal(found.readings, frames.reshape(50, -1))
    assert found.names[5] == "r1c1"
    with pytest.raises(FileError, match="not a multiple of the 7 rows"):
        io.read(path, options=ReadOptions(grid=(7, 4)))


def test_frames_that_are_numbered_by_row(put) -> None:
    rows = [[k // 3, *row] for k, row in enumerate(PRESSED.reshape(-1, 4).tolist())]
    path = put("mat.csv", "".join(",".join(map(str, row)) + "\n" for row in rows))
    with pytest.raises(FileError, match=r"frames of 3 rows and 4 columns: .* give --grid 3x4"):
        io.read(path)
    found = io.read(path, options=ReadOptions(grid=(3, 4)))
    np.testing.assert_array_equal(found.readings, PRESSED)


def test_lists_of_readings_are_no_lists_of_contacts(put) -> None:
    lines = (f'{{"sensors": {row}, "ts": {20 * i}}}\n' for i, row in enumerate(PRESSED.tolist()))
    with pytest.warns(AnisomapWarning, match="taken as ms"):
        found = io.read(put("log.jsonl", "".join(lines)))
    np.testing.assert_array_equal(found.readings, PRESSED)
    assert found.rate_hz == pytest.approx(50)


@pytest.mark.filterwarnings("ignore:.*divide frames of")
def test_blocks_that_may_be_recordings_ask_for_a_grid(put) -> None:
    """Presses that were recorded one after the other, with an empty line in between."""
    profile = np.sin(np.linspace(0.1, 3, 20))[:, None]
    presses = [np.round(profile * RNG.uniform(0, 900, 8)).astype(int) for _ in range(30)]
    blocks = ("".join(",".join(map(str, row)) + "\n" for row in p.tolist()) for p in presses)
    path = put("presses.csv", "\n".join(blocks))
    with pytest.raises(FileError, match="give --grid 20x8 if each block is a frame, or remove"):
        io.read(path)
    assert io.read(path, options=ReadOptions(grid=(20, 8))).n_frames == 30


def test_folders(tmp_path: Path) -> None:
    for k in range(12):
        np.savetxt(tmp_path / f"frame_{k}.csv", PRESSED[k].reshape(3, 4), "%d", ",")
    with pytest.raises(FileError, match=r"tables of 3 x 4 without names: .*--grid 3x4"):
        io.read(tmp_path)
    found = io.read(tmp_path, options=ReadOptions(grid=(3, 4)))
    np.testing.assert_array_equal(found.readings, PRESSED[:12])
    assert io.contents(tmp_path) == ()
    for k in range(12):
        (tmp_path / f"frame_{k}.csv").write_text(text(NAMES, PRESSED[20 * k : 20 * k + 20]))
    np.testing.assert_array_equal(io.read(tmp_path).readings, PRESSED[:240])


def sessions(n: int) -> tuple[np.ndarray, list[Recording]]:
    noisy = PRESSED + RNG.normal(0, 3, PRESSED.shape)
    zeros = np.vstack([np.zeros(N_SENSORS), RNG.uniform(-400, 400, (n - 1, N_SENSORS))])
    parts = np.split(noisy, n)
    return noisy, [
        Recording(part + zero, names=NAMES, source=f"run {k}")
        for k, (part, zero) in enumerate(zip(parts, zeros, strict=True))
    ]


@pytest.mark.parametrize("n", [2, 3])
def test_sessions_with_zeros_of_their_own(n: int) -> None:
    noisy, runs = sessions(n)
    with pytest.warns(AnisomapWarning, match="level at rest differs between recordings"):
        joined = join_runs(runs)
    np.testing.assert_allclose(joined.readings, noisy, atol=3)
    with pytest.warns(AnisomapWarning, match="most sensors jumps"):
        whole = join_runs(np.vstack([run.readings for run in runs]))
    np.testing.assert_allclose(whole.readings, noisy, atol=3)


def test_one_zero_stays_as_it_is() -> None:
    noisy, _ = sessions(2)
    runs = [Recording(part, names=NAMES) for part in np.split(noisy, 3)]
    np.testing.assert_array_equal(join_runs(runs).readings, noisy)
    np.testing.assert_array_equal(join_runs(noisy).readings, noisy)
    many = [Recording(part, names=NAMES) for part in np.split(noisy, 120)]
    np.testing.assert_array_equal(join_runs(many).readings, noisy)


def test_a_hold_is_no_step_of_the_rest() -> None:
    noisy, _ = sessions(2)
    noisy[200:400, :8] += 300
    np.testing.assert_array_equal(join_runs(noisy).readings, noisy)


TIMES = np.arange(N_FRAMES) / 50
DATES = np.datetime64("2026-03-01T10:00", "ns") + (1e9 * TIMES).astype("timedelta64[ns]")


@pytest.mark.parametrize(
    "times", [TIMES, DATES, list(map(str, DATES.astype("M8[ms]"))), DATES.astype("M8[ms]").tolist()]
)
def test_times_of_objects(times: Any) -> None:
    found = Recording(PRESSED, times=times)
    np.testing.assert_allclose(found.times, TIMES, atol=2e-3)
    assert found.rate_hz == pytest.approx(50)


@pytest.mark.filterwarnings("ignore:.*taken as ms")
@pytest.mark.parametrize("kind", ["time", "timestamp", "t [ms]", "dates", "index"])
def test_data_frames(kind: str) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(PRESSED, columns=[f"{name} [kPa]" for name in NAMES])
    if kind == "index":
        frame.index = pandas.DatetimeIndex(DATES)
    else:
        clock = {"dates": DATES, "time": TIMES}.get(kind, 1000 * TIMES)
        frame.insert(0, "time" if kind == "dates" else kind, clock)
    found = Recording(frame)
    np.testing.assert_array_equal(found.readings, PRESSED)
    assert found.names == tuple(NAMES)
    assert found.rate_hz == pytest.approx(50)


def test_columns_of_a_frame_are_numbers_of_any_kind() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(PRESSED, columns=NAMES)
    mixed = frame.assign(c3=PRESSED[:, 3] > 0, c5=frame.c5.astype("Float64"))
    expected = PRESSED.copy()
    expected[:, 3] = PRESSED[:, 3] > 0
    np.testing.assert_array_equal(Recording(mixed).readings, expected)
    with pytest.raises(InputError, match=r"no numbers: hand; use .drop\(columns=\['hand'\]\)"):
        Recording(frame.assign(hand="left"))
    axes = frame.assign(**{f"p{k}_{a}": PRESSED[:, k] for k in range(4) for a in "xyz"})
    with pytest.warns(AnisomapWarning, match="4 taxels with three axes"):
        assert Recording(axes).names == ("p0", "p1", "p2", "p3", *NAMES)


def test_labelled_arrays() -> None:
    xarray = pytest.importorskip("xarray")
    labels = {"time": DATES, "sensor": NAMES}
    array = xarray.DataArray(PRESSED, dims=("time", "sensor"), coords=labels)
    found = Recording(array)
    np.testing.assert_array_equal(found.readings, PRESSED)
    assert (found.names, found.rate_hz) == (tuple(NAMES), pytest.approx(50))
    with pytest.raises(InputError, match=r"transpose\('time', 'sensor'\)"):
        Recording(array.transpose("sensor", "time"))
    cells = xarray.DataArray(
        PRESSED.reshape(-1, 3, 4), dims=("time", "row", "column"), coords={"time": TIMES}
    )
    np.testing.assert_array_equal(Recording(cells).readings, PRESSED)
    assert Recording(cells).names[5] == "r1c1"


def test_raw_recordings_of_mne() -> None:
    mne = pytest.importorskip("mne")
    kinds = ["eeg"] * N_SENSORS + ["stim"]
    info = mne.create_info([*NAMES, "STI"], 250.0, kinds)
    raw = mne.io.RawArray(np.vstack([PRESSED.T, np.zeros(N_FRAMES)]), info, verbose="ERROR")
    raw.info["bads"] = ["c3", "STI"]
    with pytest.warns(AnisomapWarning, match="marked as bad are left out: c3$"):
        found = Recording(raw)
    np.testing.assert_array_equal(found.readings, np.delete(PRESSED, 3, axis=1))
    assert (found.names[3], found.rate_hz) == ("c4", 250)
    assert not found.touched
    raw.info["bads"] = list(NAMES)
    with pytest.raises(InputError, match="all channels of type eeg are marked as bad"):
        Recording(raw)
