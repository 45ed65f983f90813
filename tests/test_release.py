"""The script of ``make release``: what it needs no network for."""

import importlib.util
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def release():
    spec = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


CHANGELOG = """# Changelog

## [Unreleased]

- New.

## [1.2.0] - 2026-01-02

### Breaking changes

- Gone: write this instead.

## [1.1.0] - 2026-01-01

- Old.
"""


def test_the_notes_are_the_section_of_the_version(release):
    notes = release.notes_of(CHANGELOG, "1.2.0")
    assert notes.startswith("# anisomap 1.2.0\n\n### Breaking changes\n")
    assert "instead." in notes
    assert "New." not in notes
    assert "Old." not in notes
    assert "New." in release.notes_of(CHANGELOG, "1.3.0.dev0")
    with pytest.raises(SystemExit, match=r"no section \[2.0.0\]"):
        release.notes_of(CHANGELOG, "2.0.0")


def test_a_version_that_is_not_ready_is_not_released(release, tmp_path):
    for name in ("CHANGELOG.md", "CITATION.cff"):
        shutil.copy(ROOT / name, tmp_path)
    release.subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    said = " ".join(release.obstacles(tmp_path, "9.9.9.dev0"))
    for part in ("is not the version of a release", "CITATION.cff", "CHANGELOG.md", "committed"):
        assert part in said


@pytest.mark.slow
def test_wheel_and_sdist_agree(release, tmp_path):
    release.main(["--rehearse", "--no-install", "-o", str(tmp_path / "dist")])
    version = release.version_of(ROOT)
    built = {path.name for path in (tmp_path / "dist").iterdir()}
    assert built == {
        f"anisomap-{version}.tar.gz",
        f"anisomap-{version}-py3-none-any.whl",
        f"notes-{version}.md",
    }


def test_the_commands_that_are_checked_are_those_of_the_readme(release):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for command in release.COMMANDS[1:]:
        assert f"anisomap {command}" in readme
