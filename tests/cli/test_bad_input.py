"""Bad input: one sentence, exit code 2, no traceback, no partial output."""

import io
import os
import sys
import zipfile

import numpy as np
import pytest

import anisomap
from skins import flat_skin


def text(content):
    return lambda path: path.write_text(content)


def archive(**arrays):
    return lambda path: np.savez(path, **arrays)


def pickled(path):
    inner = io.BytesIO()
    np.lib.format.write_array(inner, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("readings.npy", inner.getvalue())


def npz_bytes():
    whole = io.BytesIO()
    np.savez(whole, readings=flat_skin().readings)
    return whole.getvalue()


WAVE = "\n".join(f"{np.sin(i):.3f},{np.cos(i):.3f},{np.sin(2 * i):.3f}" for i in range(9))
BAD = {
    "missing.csv": (None, "missing.csv"),
    "folder.csv": (lambda path: path.mkdir(), "folder"),
    "empty.csv": (text(""), "empty"),
    "header.csv": (text("a,b,c\n"), "header"),
    "ragged.csv": (text("a,b,c\n1,2,3\n4,5\n"), "line 3"),
    "words.csv": (text("a,b,c\n1,2,3\n4,oops,6\n"), "line 3, column 2"),
    "missing-readings.csv": (text(WAVE + "\n1,nan,3\n"), "sensor s1, frame 9"),
    "infinite.csv": (text(WAVE + "\n1,2,inf\n"), "sensor s2, frame 9"),
    "two.csv": (text("a,b\n1,2\n2,1\n3,3\n"), "got 2 of 2"),
    "constant.csv": (text("a,b,c\n1,2,3\n1,2,3\n"), "got 0 of 3"),
    "binary.csv": (lambda path: path.write_bytes(bytes(range(256)) * 9), "binary.csv"),
    "pickle.npz": (pickled, "pickle.npz"),
    "nothing.npz": (archive(other=np.eye(3)), "readings"),
    "flat.npz": (archive(readings=np.arange(5.0)), "flat.npz"),
    "complex.npz": (archive(readings=np.ones((4, 4), complex)), "complex"),
    "words.npz": (archive(readings=np.array([["a", "b"]])), "words.npz"),
    "shapes.npz": (archive(readings=np.eye(4), positions=np.zeros((3, 2))), "positions"),
    "names.npz": (archive(readings=np.eye(4), names=np.array(["a"])), "names"),
    "cut.npz": (lambda path: path.write_bytes(npz_bytes()[:3000]), "cut.npz"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("command", ["map", "info", "compare"])
def test_bad_recordings(run, tmp_path, name, command):
    make, message = BAD[name]
    path = tmp_path / name
    if make is not None:
        make(path)
    before = sorted(tmp_path.iterdir())
    found = run(command, path, *(["-o", "out.csv"] if command == "map" else []))
    if command == "info" and found.code == 0:
        # Too little for a map, but enough for a summary.
        assert name in {"missing-readings.csv", "infinite.csv", "two.csv", "constant.csv"}
        return
    assert found.code == 2
    assert found.err.startswith("error: ")
    assert found.err.count("\n") == 1
    if command == "map":
        assert message in found.err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["truth.csv", "map.csv"])
@pytest.mark.parametrize("content", ["", "x,y\n", "a,b\n1,2\n", "x,y\n1,z\n", "x,y\n1,2\n3\n"])
@pytest.mark.usefixtures("truth_csv")
def test_bad_positions(run, tmp_path, name, content):
    anisomap.write(anisomap.SensorMap(flat_skin().positions), tmp_path / "map.csv")
    (tmp_path / name).write_text(content)
    found = run("score", "map.csv", "truth.csv")
    assert found.code == 2
    assert found.err.startswith("error: ")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "map.doc"], ".csv"),
        (["-o", "map.png"], "--picture"),
        (["-o", "map.html"], "--report"),
        (["-o", "nowhere/map.csv"], "folder nowhere does not exist"),
        (["-o", "."], "folder"),
        (["--picture", "map.bmp"], ".png"),
        (["--report", "nowhere/r.html"], "folder nowhere does not exist"),
        (["-m", "pca"], "r-anisomap"),
        (["-d", "0"], "-d"),
        (["-d", "two"], "-d"),
        (["--exclude", "nobody"], "nobody"),
        (["--drop", "99"], "99"),
        (["--mu", "-1"], "mu"),
        (["-m", "i-anisomap", "--bins", "1"], "bins"),
        (["-m", "isomap", "--n-neighbours", "0"], "neighbours"),
        (["--tolerance", "-1"], "tolerance"),
        (["--seed", "-1"], "seed"),
        (["--missing", "ignore"], "drop-frames"),
        (["--frobnicate"], "frobnicate"),
    ],
)
def test_bad_options(run, skin_npz, tmp_path, options, message):
    before = sorted(tmp_path.iterdir())
    found = run("map", skin_npz, *options)
    assert found.code == 2
    assert message in found.err
    assert found.err.startswith("error: ")
    assert found.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_a_failed_run_leaves_the_old_map_whole(run, skin_csv, tmp_path):
    old = tmp_path / "map.csv"
    old.write_text("precious")
    skin_csv.write_text("a,b,c\n1,2,3\n1,2,3\n")
    assert run("map", skin_csv, "-o", "map.csv").code == 2
    assert old.read_text() == "precious"


def test_a_recording_without_truth_cannot_be_compared(run, skin_csv):
    found = run("compare", skin_csv)
    assert found.code == 2
    assert "no true positions" in found.err


def test_an_unexpected_error_is_reported_as_a_defect(run, skin_csv, monkeypatch):
    def broken(*_, **__):
        message = "a bug"
        raise KeyError(message)

    monkeypatch.delenv("ANISOMAP_DEBUG")
    monkeypatch.setattr(anisomap.io, "read", broken)
    found = run("map", skin_csv)
    assert found.code == 70
    assert "defect in anisomap" in found.err
    assert "Traceback" not in found.err


@pytest.mark.parametrize(
    "options", [["-o", "skin.csv"], ["--report", "skin.csv"], ["-o", "a.csv", "--picture", "a.csv"]]
)
def test_nothing_is_written_over_what_is_read_or_written(run, skin_csv, options):
    before = skin_csv.read_bytes()
    found = run("map", skin_csv, *options)
    assert found.code == 2
    assert "another file" in found.err or "two outputs" in found.err
    assert skin_csv.read_bytes() == before
    assert run("compare", skin_csv, "-o", "skin.csv").code == 2
    assert skin_csv.read_bytes() == before


def test_an_unknown_method_is_reported_before_the_recording_is_read(run):
    found = run("map", "missing.csv", "-m", "pca")
    assert found.code == 2
    assert "no method 'pca'" in found.err


def test_too_many_sensors_are_refused_before_they_are_compared(run, tmp_path, monkeypatch):
    """Comparing a million sensors with one another takes hours, and their map terabytes."""
    np.savez_compressed(tmp_path / "many.npz", readings=np.eye(20, 100_000, dtype=np.uint8))
    answers = {"SC_PAGE_SIZE": 1, "SC_PHYS_PAGES": 24 << 30}
    ask = os.sysconf
    monkeypatch.setattr(os, "sysconf", lambda name: answers.get(name) or ask(name))
    for command in ("info", "map"):
        found = run(command, "many.npz")
        assert found.code == 2
        assert "100000 sensors needs about 298.0 GiB of memory" in found.err


def test_components_are_not_written_over_the_input(run, tmp_path):
    components = [0, 0, 0, 1, 1, 1]
    made = anisomap.SensorMap(np.random.default_rng(0).random((6, 3)), component=components)
    anisomap.write(made, tmp_path / "skin-1.csv")
    before = (tmp_path / "skin-1.csv").read_bytes()
    found = run("convert", "skin-1.csv", "skin.csv", "--split-components")
    assert found.code == 2
    assert "skin-1.csv is also an input" in found.err
    assert (tmp_path / "skin-1.csv").read_bytes() == before
    assert not (tmp_path / "skin-2.csv").exists()


@pytest.mark.parametrize("name", ["[1].npz", "[a", '{"a": 1}.npz', "[]"])
def test_names_that_look_like_json_are_paths(run_map, skin_npz, tmp_path, name):
    path = skin_npz.rename(tmp_path / name)
    done = run_map(path.name, "-m", "r-anisomap", "-o", "[map].csv")
    assert done.code == 0
    assert (tmp_path / "[map].csv").exists()


def test_a_checkpoint_is_neither_an_input_nor_another_output(run, skin_npz, tmp_path):
    before = skin_npz.read_bytes()
    for path in ("skin.npz", "map.csv"):
        found = run("map", skin_npz, "-o", "map.csv", "--checkpoint", path)
        assert found.code == 2
        assert f"{path} is" in found.err
    assert skin_npz.read_bytes() == before
    assert not (tmp_path / "map.csv").exists()


def test_errors_about_long_names_have_at_most_300_characters(run, skin_npz):
    found = run("map", skin_npz, "--drop", "x" * 9000)
    errors = [line for line in found.err.splitlines() if line.startswith("error: ")]
    assert found.code == 2
    assert len(errors) == 1
    assert len(errors[0]) <= len("error: ") + 300
    assert errors[0].startswith("error: there is no sensor 'xxx")


def layout(path, scale):
    """Write the layout of the skin at a scale."""
    positions = scale * flat_skin().positions
    anisomap.write(anisomap.SensorMap(np.column_stack([positions, positions[:, 0]])), path)


COMMANDS_ON_LAYOUTS = {
    "diff": ["diff", "a.csv", "b.csv"],
    "diff, exchanged": ["diff", "b.csv", "a.csv"],
    "check": ["check", "a.csv", "skin.npz"],
    "score": ["score", "a.csv", "b.csv"],
    "place": ["place", "a.csv", "--spacing", "5mm", "-o", "o.csv"],
    "simulate": ["simulate", "a.csv", "-s", "rubbing", "--frames", "3", "-o", "o.npz"],
}


@pytest.mark.parametrize("scale", [1e307, 1e-310, 0])
@pytest.mark.parametrize("command", COMMANDS_ON_LAYOUTS)
def test_layouts_without_distances(run, skin_npz, tmp_path, scale, command):
    """Positions are finite, but the squares of distances are 0 or infinite."""
    layout(tmp_path / "a.csv", scale)
    layout(tmp_path / "b.csv", 1)
    found = run(*COMMANDS_ON_LAYOUTS[command])
    assert found.code == 2
    assert len(found.err.splitlines()) == 1
    assert not list(tmp_path.glob("o.*"))


def test_a_map_in_which_most_sensors_coincide_is_compared(run, tmp_path):
    positions = np.repeat(np.random.default_rng(0).random((9, 3)), 2, axis=0)
    anisomap.write(anisomap.SensorMap(positions), tmp_path / "a.csv")
    found = run("diff", "a.csv", "a.csv")
    assert found.code == 0
    assert "spacings" not in found.out


def test_a_single_sensor_is_placed(run, tmp_path):
    (tmp_path / "a.csv").write_text("name,x,y\na,1,2\n")
    assert run("place", "a.csv", "--spacing", "5mm", "-o", "o.csv").code == 0
    assert (tmp_path / "o.csv").exists()


@pytest.mark.parametrize("command", ["check", "place", "map", "repair", "convert"])
def test_links_that_lead_nowhere(run, skin_npz, tmp_path, command):
    (tmp_path / "a.csv").symlink_to("a.csv")
    (tmp_path / "b.csv").symlink_to("none.csv")
    other = {"check": ["skin.npz"], "convert": ["o.csv"], "place": ["-o", "o.csv"]}
    for name in ("a.csv", "b.csv"):
        found = run(command, name, *other.get(command, ["-o", "o.npz"]))
        assert found.code == 2
        assert name in found.err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
@pytest.mark.parametrize(
    "command",
    [
        ["convert", "a.csv", "{}.csv"],
        ["place", "a.csv", "--spacing", "5mm", "-o", "{}.csv"],
        ["coverage", "--frames", "9", "--runs", "1", "-o", "{}.csv"],
        ["compare", "skin.npz", "-m", "r-anisomap", "-o", "{}.csv"],
        ["repair", "skin.npz", "-o", "{}.npz"],
        ["score", "a.csv", "a.csv", "--picture", "{}.png"],
        ["score", "a.csv", "a.csv", "--report", "{}.html"],
    ],
    ids=lambda words: words[0] + words[-2],
)
def test_pipes_and_devices_are_not_replaced(run, skin_npz, tmp_path, command):
    layout(tmp_path / "a.csv", 1)
    *words, output = command
    pipe, link = tmp_path / output.format("pipe"), tmp_path / output.format("link")
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    before = sorted(tmp_path.iterdir())
    for target in (pipe, link):
        found = run(*words, target.name)
        assert found.code == 2
        assert "not a regular file" in found.err
    assert sorted(tmp_path.iterdir()) == before
    assert pipe.is_fifo()
    assert link.is_symlink()


def test_names_that_are_too_long_and_long_ones(run, tmp_path):
    layout(tmp_path / "a.csv", 1)
    found = run("convert", "a.csv", "b" * 300 + ".csv")
    assert found.code == 2
    assert "too long" in found.err
    assert run("convert", "a.csv", "b" * 250 + ".csv").code == 0


def test_an_output_that_is_a_link_keeps_it(run, tmp_path):
    layout(tmp_path / "a.csv", 1)
    (tmp_path / "far").mkdir()
    (tmp_path / "b.csv").symlink_to(tmp_path / "far" / "c.csv")
    assert run("convert", "a.csv", "b.csv").code == 0
    assert (tmp_path / "b.csv").is_symlink()
    assert anisomap.read_map(tmp_path / "far" / "c.csv").n_sensors == flat_skin().n_sensors


@pytest.mark.skipif(sys.platform != "linux", reason="other systems reject such names")
@pytest.mark.parametrize("command", ["repair", "map"])
def test_recordings_whose_names_are_not_utf_8(run, skin_npz, command):
    name = os.fsdecode(b"\xff.npz")
    skin_npz.rename(skin_npz.with_name(name))
    assert run(command, name, "-o", "o.npz", *["--no-verdict"] * (command == "map")).code == 0
