"""What gets installed works: the wheel is whole, and importing it costs next to nothing."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import anisomap
from skins import flat_skin

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with the package as a user gets it, from a wheel."""
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


def test_the_wheel_makes_a_map_a_picture_and_a_report(installed, tmp_path):
    pytest.importorskip("mujoco")
    code = (
        "import anisomap, sys; assert sys.argv[1] in anisomap.__file__, anisomap.__file__;"
        "from anisomap.cli import main;"
        "main(['demo', '-o', 'out', '--frames', '300', '--permutations', '20'])"
    )
    done = run(installed, "-c", code, str(installed), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "map.csv", "map.png", "recording.npz", "report.html",
    }  # fmt: skip


def test_the_wheel_is_typed_and_holds_no_tests(installed):
    assert (installed / "anisomap" / "py.typed").exists()
    assert (installed / "anisomap" / "__init__.pyi").exists()
    assert {path.name.split("-")[0] for path in installed.iterdir()} == {"anisomap"}


def test_importing_costs_nothing_until_something_is_used(installed, tmp_path):
    code = "import sys, anisomap; assert 'numpy' not in sys.modules; dir(anisomap)"
    done = run(installed, "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_every_public_name_can_be_had():
    for name in dir(anisomap):
        assert getattr(anisomap, name) is not None


def test_the_core_does_without_the_extras(installed, tmp_path):
    code = """
import sys
for name in ("mujoco", "matplotlib", "plotly", "jinja2"):
    sys.modules[name] = None
from anisomap.cli import main
main(sys.argv[1:])
"""
    anisomap.write(flat_skin(), tmp_path / "skin.npz")
    made = run(installed, "-c", code, "map", "skin.npz", "-o", "m.csv", "-d", "2", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    for arguments, extra in (
        (["map", "skin.npz", "--report", "r.html"], "report"),
        (["map", "skin.npz", "--picture", "p.png"], "report"),
    ):
        refused = run(installed, "-c", code, *arguments, cwd=tmp_path)
        assert refused.returncode == 2
        assert f"pip install 'anisomap[{extra}]'" in refused.stderr
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "mujoco", None)
        with pytest.raises(anisomap.AnisomapError, match=r"anisomap\[simulation\]"):
            anisomap.simulate(n_frames=10)
