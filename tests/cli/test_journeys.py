"""Journeys through the other commands: summaries, scores, comparisons, lists and help."""

import hashlib
import re
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap.method.evidence import SIMILARITIES
from anisomap.method.named import METHODS
from anisomap.placement import median_spacing
from anisomap.simulation import BODIES, SCENARIOS
from command_line import call, write_layout
from skins import flat_skin


def test_info_lists_what_there_is_to_choose_from(run, run_map, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "skin.h5", "w") as file:
        file["left"] = file["right"] = flat_skin().readings
        file["note"] = np.arange(3)
    found = run("info", "skin.h5")
    assert "left" in found.out
    assert "choose one with --select" in found.err
    run_map("skin.h5", code=2)
    run_map("skin.h5", "--select", "left")


def test_a_map_is_scored_against_any_layout(run, run_map, skin_csv, truth_csv, tmp_path):
    """The true positions may come in a file of their own, while mapping or after."""
    truth = tmp_path / "truth.json"
    run("convert", truth_csv, truth)
    mapped = run_map(skin_csv, "-o", "map.csv", "--truth", truth, "--json")
    while_mapping = mapped.values["score"]
    assert while_mapping["mantel_r"] > 0.9
    files = "--picture score.png --report score.html"
    after = run(f"score map.csv truth.json {files} --permutations 9 --json").values["score"]
    assert after["mantel_r"] == while_mapping["mantel_r"]
    assert (tmp_path / "score.png").stat().st_size > 10_000
    assert "Mantel r" in (tmp_path / "score.html").read_text()
    told = run("score", "map.csv", truth_csv, "--units", "mm", "--permutations", 9).out
    for expected in ("Mantel r", "median", "RMS error", "mm", "mirrored", "neighbours kept"):
        assert expected in told


def test_the_worst_sensors_of_a_map_are_named(run, truth_csv, tmp_path):
    """Two wires swapped: the score stays high, but the two sensors are named."""
    positions = flat_skin().positions.copy()
    positions[[3, 40]] = positions[[40, 3]]
    write_layout(tmp_path / "swapped.csv", positions, flat_skin().names)
    found = run("score", "swapped.csv", truth_csv, "--json").values["score"]
    assert found["mantel_r"] > 0.7
    assert {worst["sensor"] for worst in found["worst"][:2]} == {"s3", "s40"}
    assert found["worst"][0]["error"] > 10 * found["median_error"]
    assert "s40 " in run("score", "swapped.csv", truth_csv).out


def test_the_demo_ends_with_a_picture_and_a_report(run, tmp_path):
    pytest.importorskip("mujoco")
    made = run("demo", "-o", "out", "--frames", 300)
    for name in ("map.csv", "map.png", "report.html", "recording.npz"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
        assert name in made.out
    # Of 300 frames, the map is better than all permutations of it.
    assert re.search(r"p +(1e-04|0.0001) \(10000 permutations\)", made.out)


def test_maps_of_the_demo_are_accurate():
    """Recordings as of the demo, of 1,200 frames in 256 levels, by three seeds of the simulator."""
    with np.load(Path(__file__).parents[1] / "fixtures" / "bombarded-spheres.npz") as stored:
        made = [anisomap.reconstruct(readings.astype(float)) for readings in stored["readings"]]
        r = [anisomap.mantel(one, stored["positions"], permutations=0).r for one in made]
    assert np.median(r) > 0.95  # .991 to .993


@pytest.mark.slow
@pytest.mark.usefixtures("skin_npz")
def test_two_runs_give_the_same_bytes(run, tmp_path):
    for folder in ("run-1", "run-2"):
        (tmp_path / folder).mkdir()
        outputs = [a for s in ("csv", "npz", "json", "ply") for a in ("-o", f"{folder}/m.{s}")]
        drawn = f"--picture {folder}/m.png --report {folder}/m.html"
        run(f"map skin.npz --permutations 50 {drawn}", *outputs)
    for first in (tmp_path / "run-1").iterdir():
        # A report states its command, with the names of its files; - is not in coded pictures.
        second = (tmp_path / "run-2" / first.name).read_bytes()
        second = second.replace(b"run-2/", b"run-1/")
        assert first.read_bytes() == second, first.name


@pytest.mark.parametrize(
    ("words", "needed", "unneeded"),
    [
        (["--help"], {"cyclopts"}, {"scipy", "sklearn", "matplotlib", "mujoco"}),
        (
            ["map", "skin.npz", "-o", "map.csv", "--no-verdict"],
            {"scipy.optimize"},
            {"asyncio", "h5py", "matplotlib", "numba", "pyarrow", "scipy.cluster", "scipy.ndimage",
             "scipy.stats", "sklearn", "ssl"},
        ),
    ],
    ids=["help", "map"],
)  # fmt: skip
def test_commands_import_no_more_than_they_need(tmp_path, words, needed, unneeded):
    np.savez(tmp_path / "skin.npz", readings=flat_skin(n_frames=500).readings)
    code = (
        "import sys\n"
        "from anisomap.cli.app import run\n"
        "assert run(sys.argv[1:]) == 0\n"
        "print('loaded', *sys.modules)\n"
    )
    command = [sys.executable, "-c", code, *words]
    said = subprocess.check_output(command, text=True, cwd=tmp_path)
    loaded = set(said.rpartition("loaded")[2].split())
    assert needed <= loaded
    assert not unneeded & loaded


def test_lists_name_everything(run):
    listed = {
        "methods": [*METHODS, *SIMILARITIES],
        "formats": [".npz", ".csv", ".ply", ".json"],
        "bodies": BODIES,
        "scenarios": SCENARIOS,
    }
    for kind, names in listed.items():
        told = run("list", kind).out
        assert all(name in told for name in names)
    for name, scenario in SCENARIOS.items():
        told = run("list", "scenarios", name).out
        for parameter, default in vars(scenario.options()).items():
            assert f"{parameter} = {default}" in told


@pytest.mark.usefixtures("skin_csv")
def test_ports_in_use_are_errors_before_anything_is_recorded(run, tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        page = run(f"live skin.csv --port {port} --no-browser --recording r.csv", code=2)
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        datagrams = other.getsockname()[1]
        source = run(f"live udp://127.0.0.1:{datagrams} --headless", code=2)
    assert f"cannot show the page on 127.0.0.1:{port}" in page.err
    assert "choose another --port" in page.err
    assert f"cannot listen on 127.0.0.1:{datagrams}" in source.err
    assert [path.name for path in tmp_path.iterdir()] == ["skin.csv"]


def test_a_report_states_where_it_comes_from(tmp_path):
    skin = flat_skin(n_frames=300)
    anisomap.write(replace(skin, positions=skin.positions / 1000, units="m"), tmp_path / "skin.npz")
    command = "map skin.npz -d 2 -m r-anisomap --no-verdict --permutations 9 --report r.html"
    call(tmp_path, command)
    page = (tmp_path / "r.html").read_text()
    digest = hashlib.sha256((tmp_path / "skin.npz").read_bytes()).hexdigest()
    for stated in (f"anisomap {command}", digest, anisomap.__version__):
        assert stated in page
    assert '"units":"mm"' in page


def test_a_map_is_made_in_millimetres_and_mirrored_at_once(run_map, skin_npz):
    arguments = (skin_npz, "-d", "2", "--spacing", "6.5mm")
    run_map(*arguments, "-o", "one.json", "-o", "one.icub.txt")
    run_map(*arguments, "-o", "two.json", "--mirror")
    one, two = (anisomap.read_map(f"{name}.json") for name in ("one", "two"))
    assert one.units == "mm"
    assert median_spacing(one) == pytest.approx(6.5)
    np.testing.assert_allclose(two.positions, one.positions * [-1, 1])
    assert two.mirrored is True
    assert anisomap.read_map("one.icub.txt").units == "m"
