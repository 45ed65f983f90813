"""The installed wheel and its data are complete, and importing it is cheap."""

import inspect
import json
import os
import re
import subprocess
import sys
import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from packaging.version import Version

import anisomap
from anisomap import datasets
from anisomap.cli.commands.simulation import demo
from anisomap.errors import install_command
from skins import flat_skin

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Build a wheel and give the folder that it is unpacked into."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    site = folder / "site"
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(site)
    return site


def run(installed, *arguments, cwd):
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_the_wheel_makes_a_map_a_picture_and_a_report(installed, tmp_path):
    pytest.importorskip("mujoco")
    code = (
        "import anisomap, sys; assert sys.argv[1] in anisomap.__file__, anisomap.__file__;"
        "from anisomap.cli import main;"
        "main(['demo', '-o', 'out', '--frames', '200'])"
    )
    done = run(installed, "-c", code, str(installed), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "map.csv", "map.png", "recording.npz", "report.html",
    }  # fmt: skip


def test_the_wheel_holds_types_and_templates_but_no_tests(installed):
    for name in ("py.typed", "__init__.pyi"):
        assert (installed / "anisomap" / name).exists()
    templates = {path.name for path in (ROOT / "src").rglob("templates/*")}
    assert "report.html" in templates
    assert templates == {path.name for path in installed.rglob("templates/*")}
    data = {path.name for path in (ROOT / "src/anisomap/datasets/data").iterdir()}
    assert data == {path.name for path in (installed / "anisomap/datasets/data").iterdir()}
    assert {path.name.split("-")[0] for path in installed.iterdir()} == {"anisomap"}


def test_importing_costs_nothing_until_something_is_used(installed, tmp_path):
    code = "import sys, anisomap; assert 'numpy' not in sys.modules; dir(anisomap)"
    done = run(installed, "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_release_is_stated_alike():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    stated = dict(re.findall(r"^(version|date-released): (.*)$", citation, re.MULTILINE))
    _, *sections = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")
    released = [changes for changes in sections if not changes.startswith("[Unreleased]")]
    assert released[0].startswith(f"[{stated['version']}] - {stated['date-released']}\n")
    ahead = len(released) < len(sections)
    version = Version(anisomap.__version__)
    assert version > Version(stated["version"]) if ahead else str(version) == stated["version"]


def test_every_public_name_can_be_had():
    for name in dir(anisomap):
        assert getattr(anisomap, name) is not None


WITHOUT_EXTRAS = """
import json, sys
for name in ("mujoco", "matplotlib", "jinja2", "numba"):
    sys.modules[name] = None
from anisomap.cli import main
for arguments in json.loads(sys.argv[1]):
    try:
        main(["map", "skin.npz", "-d", "2", "--no-verdict", "--permutations", "0", *arguments])
    except SystemExit as end:
        print("exit code", end.code, file=sys.stderr)
"""


def test_the_core_does_without_the_extras(installed, tmp_path):
    anisomap.write(flat_skin(), tmp_path / "skin.npz")
    calls = [["-o", "m.csv"], ["--report", "r.html"], ["--picture", "p.png"]]
    done = run(installed, "-c", WITHOUT_EXTRAS, json.dumps(calls), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    made, *refused = done.stderr.split("exit code ")[1:]
    assert made.split()[0] == "0", done.stderr
    assert (tmp_path / "m.csv").exists()
    assert [words.split()[0] for words in refused] == ["2", "2"]
    assert done.stderr.count("[report]'") == 2


LARGE = """
import sys
sys.modules["numba"] = None
import numpy as np
from anisomap import Recording, assess, reconstruct
from anisomap.errors import MissingExtraError
from anisomap.method.named import METHODS
readings = np.load("large.npy")
for method in METHODS:
    try:
        reconstruct(readings, method, 2)
    except MissingExtraError as error:
        assert error.extra == "fast"
    else:
        raise AssertionError(method)
print([sensor.status for sensor in assess(Recording(readings))])
"""


def test_maps_of_many_sensors_need_compiled_loops_and_checks_do_not(tmp_path):
    """Without numba no map is made, rather than another one."""
    touches = np.random.default_rng(0).uniform(size=(600, 1))
    readings = np.maximum(0, 0.02 - abs(touches - np.linspace(0, 1, 510)))
    readings[:, [3, 70]] = 0.01
    np.save(tmp_path / "large.npy", readings)
    done = subprocess.run(
        [sys.executable, "-c", LARGE], check=True, cwd=tmp_path, capture_output=True, text=True
    )
    known = [sensor.status for sensor in anisomap.assess(anisomap.Recording(readings))]
    assert done.stdout.strip() == str(known)
    assert len(set(known)) > 1


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        (None, "'anisomap[report]'"),
        ({"url": "file:///a%20b/skin", "dir_info": {"editable": True}}, "-e '/a b/skin[report]'"),
        ({"url": "file:///a/anisomap.whl", "archive_info": {}}, "'/a/anisomap.whl[report]'"),
    ],
)
def test_an_extra_is_installed_from_where_the_package_was(source, wanted, tmp_path, monkeypatch):
    folder = tmp_path / "anisomap-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: anisomap\nVersion: 1.0\n")
    if source:
        (folder / "direct_url.json").write_text(json.dumps(source))
    monkeypatch.syspath_prepend(tmp_path)
    assert install_command("report") == f"pip install {wanted}"


def test_the_demo_names_all_extras_it_needs(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(anisomap.AnisomapError, match=r"\[report,simulation\]"):
        demo(output_dir=tmp_path / "demo")
    assert not (tmp_path / "demo").exists()


LOADERS = [name for name, _ in inspect.getmembers(datasets, inspect.isfunction) if "load" in name]
MAX_BYTES = 500_000


@pytest.mark.parametrize("name", LOADERS)
def test_a_data_set_is_described_and_licensed(name):
    found = getattr(datasets, name)()
    assert any(word in found.DESCR for word in ("BSD-3-Clause", "free to use"))
    if "recording" not in found:
        values = found.dissimilarities
        assert values.shape == (len(found.names),) * 2
        np.testing.assert_array_equal(values, values.T)
        return
    recording = found.recording
    assert f"{recording.n_sensors} sensors" in found.DESCR
    assert f"n_frames={recording.n_frames}" in found.DESCR
    made = anisomap.reconstruct(recording)
    assert anisomap.score(made, recording, permutations=0).mantel.r > 0.98


def test_the_data_sets_are_small():
    found = list((files("anisomap.datasets") / "data").iterdir())
    assert len(found) == len(LOADERS)
    assert sum(file.stat().st_size for file in found) < MAX_BYTES
