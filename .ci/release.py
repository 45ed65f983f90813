"""Build a release in dist/: wheel, sdist and notes (``make release``).

The wheel is installed in an empty environment, where it makes a map, a report and a URDF file. The
tests run with the lowest versions that are stated. The sdist must give the same wheel. The notes
are the section of the changelog. ``--rehearse`` does the same for a version that is not ready: a
development version, one that is not stated alike everywhere, or one with changes that are not
committed. ``--no-install`` leaves out the empty environment and the lowest versions, which need a
package index.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

COMMANDS = (
    "simulate hexagon -s rubbing --frames 600 -o run.npz",
    "map run.npz -d 2 --spacing 6.5mm -o map.csv --report report.html",
    "convert map.csv skin.urdf",
)
"""Commands of the README, which the extra of the README serves."""


def version_of(root: Path) -> str:
    """Return the version that the package states."""
    text = (root / "src/anisomap/_version.py").read_text(encoding="utf-8")
    found = re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE)
    if found is None:
        raise SystemExit("src/anisomap/_version.py states no version")
    return found[1]


def notes_of(changelog: str, version: str) -> str:
    """Return the section of a version; that of the unreleased changes for a development version."""
    wanted = "Unreleased" if ".dev" in version else version
    for section in re.split(r"^## ", changelog, flags=re.MULTILINE)[1:]:
        heading, _, body = section.partition("\n")
        if heading.startswith(f"[{wanted}]"):
            return f"# anisomap {version}\n\n{body.strip()}\n"
    raise SystemExit(f"CHANGELOG.md has no section [{wanted}]")


def obstacles(root: Path, version: str) -> list[str]:
    """Return what keeps a version from being released."""
    found = []
    if re.search(r"[a-z]", version):
        found.append(f"{version} is not the version of a release: set it in _version.py")
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    if f"\nversion: {version}\n" not in citation:
        found.append(f"CITATION.cff does not state version {version}")
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    if not re.search(
        rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$", changelog, re.MULTILINE
    ):
        found.append(f"CHANGELOG.md has no section [{version}] with a date")
    changed = subprocess.run(
        ["git", "status", "--porcelain"], cwd=root, capture_output=True, text=True, check=True
    )
    if changed.stdout:
        found.append("some changes are not committed")
    return found


def build(source: Path, folder: Path, *kinds: str) -> list[Path]:
    """Build distributions from a folder of the source."""
    command = [sys.executable, "-m", "build", "--no-isolation", *kinds, "--outdir", str(folder)]
    subprocess.run([*command, str(source)], check=True, stdout=subprocess.DEVNULL)
    return sorted(path for path in folder.iterdir() if path.suffix in {".whl", ".gz"})


def contents(wheel: Path) -> dict[str, bytes]:
    """Return the files of a wheel, but for the list of their digests."""
    with zipfile.ZipFile(wheel) as packed:
        names = [name for name in packed.namelist() if not name.endswith("/RECORD")]
        return {name: packed.read(name) for name in names}


def check_sdist(sdist: Path, wheel: Path) -> None:
    """Build a wheel from the sdist; it must hold what the wheel holds."""
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(sdist) as packed:
            packed.extractall(folder, filter="data")
        (source,) = Path(folder).iterdir()
        (again,) = build(source, Path(folder) / "dist", "--wheel")
        if contents(again) != contents(wheel):
            raise SystemExit("the wheel that is built from the sdist differs from the wheel")


def check_wheel(wheel: Path, version: str) -> None:
    """Install the wheel with the extra of the README in an empty environment, and make a map."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        venv.create(place / "empty", with_pip=True)
        programs = place / "empty" / ("Scripts" if sys.platform == "win32" else "bin")
        install = [programs / "python", "-m", "pip", "install", "--quiet", f"{wheel}[report]"]
        subprocess.run(install, check=True)
        for words in ("--version", *COMMANDS):
            subprocess.run([programs / "anisomap", *words.split()], cwd=place, check=True)
        stated = subprocess.run(
            [programs / "anisomap", "--version"], capture_output=True, text=True, check=True
        )
        if version not in stated.stdout:
            raise SystemExit(f"the installed package states {stated.stdout.strip()}, not {version}")


def check_lowest_versions(root: Path) -> None:
    """Run the tests, all but the slow ones, with the lowest versions of direct dependencies."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder)
        python = Path(folder) / ("Scripts" if sys.platform == "win32" else "bin") / "python"
        install = [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", python]
        lowest = ["--resolution", "lowest-direct", ".[all]", "--group", "test", "--group", "build"]
        subprocess.run([*install, *lowest], cwd=root, check=True)
        tests = ["-m", "pytest", "--numprocesses", "auto", "-m", "not slow"]
        needed = {**os.environ, "SCIPY_ARRAY_API": "1"}  # by scikit-learn 1.6 to import its checks
        subprocess.run([python, *tests], cwd=root, check=True, env=needed)


def main(arguments: Sequence[str] | None = None) -> None:
    """Build, check, and write the notes."""
    parser = argparse.ArgumentParser(prog="make release", description=__doc__)
    parser.add_argument("--rehearse", action="store_true", help="also if the version is not ready")
    parser.add_argument(
        "--no-install", action="store_true", help="leave out what needs a package index"
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist")
    chosen = parser.parse_args(arguments)
    version = version_of(ROOT)
    found = obstacles(ROOT, version)
    if found and not chosen.rehearse:
        raise SystemExit("\n".join([*found, "--rehearse builds it nevertheless"]))
    notes = notes_of((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version)
    chosen.output.mkdir(parents=True, exist_ok=True)
    if any(chosen.output.iterdir()):
        raise SystemExit(f"{chosen.output} is not empty: remove what an earlier release left")
    wheel, sdist = sorted(build(ROOT, chosen.output), key=lambda path: path.suffix != ".whl")
    check_sdist(sdist, wheel)
    if not chosen.no_install:
        check_wheel(wheel, version)
        check_lowest_versions(ROOT)
    path = chosen.output / f"notes-{version}.md"
    path.write_text(notes, encoding="utf-8")
    written = ", ".join(one.name for one in (sdist, wheel, path))
    sys.stdout.write(f"{chosen.output}: {written}\n")


if __name__ == "__main__":
    main()
