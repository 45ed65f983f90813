"""Names from files and of files appear as text: no terminal escapes, no markup, no exit code 70."""

import io
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap.base.wording import printable
from anisomap.cli.app import run as run_here

HOSTILE = "\x1b[31m\x9b2J\x07\u202egnp.\u2066[/bold][red]\r\n"


def unsafe(text: str) -> set[str]:
    """Return the characters of an output that a terminal would act on."""
    return {c for c in text if not c.isprintable()} - {"\n"}


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    rng = np.random.default_rng(3)
    readings = rng.random((50, 4)).round(3)
    readings[:, 0] = 0.5  # faulty, so that warnings name it
    names = [f"a{HOSTILE}", "b[/x]", "=cmd|' /C calc'!A0", "c"]
    path = tmp_path / "d[" / "x].npz"
    path.parent.mkdir()
    np.savez(path, readings=readings, names=np.array(names))
    return path


def strings(value: object) -> set[str]:
    if isinstance(value, dict):
        return strings([*value, *value.values()])
    if isinstance(value, list):
        return set().union(*map(strings, value))
    return {value} if isinstance(value, str) else set()


def test_information_shows_names_as_text(run, hostile: Path) -> None:
    for options in ([], ["--all"], ["--all", "--json"]):
        shown = run("info", hostile, *options)
        assert not unsafe(shown.out + shown.err)
    assert f"a{HOSTILE}" in strings(json.loads(shown.out))


def test_errors_show_names_as_text(run, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text('"a\x1b[31m[/x]\u202e",b\n1,2\n"\x1b]0;t\x07",4\n5,"\x1b]0;t\x07"\n')
    assert not unsafe(run("info", path, code=2).err)


def test_file_names_that_are_not_utf_8(
    run_map, skin_npz: Path, caplog: pytest.LogCaptureFixture
) -> None:
    odd = skin_npz.with_name(os.fsdecode(b"sk\xffin.csv"))
    try:
        readings = anisomap.read(skin_npz).readings
        times = np.arange(len(readings)) / 50
        header = ",".join(["time", *(f"s{i}" for i in range(readings.shape[1]))])
        np.savetxt(odd, np.c_[times, readings], delimiter=",", header=header, comments="")
    except OSError:
        pytest.skip("the file system stores no such names")
    suffixes = ("csv", "json", "npz", "ply", "html")
    targets = {s: skin_npz.with_name(os.fsdecode(b"m\xfeap." + s.encode())) for s in suffixes}
    outputs = [w for s in suffixes[:-1] for w in ("-o", targets[s])]
    with caplog.at_level("INFO"):
        done = run_map(odd, *outputs, "--report", targets["html"])
    assert not unsafe(done.out + done.err + caplog.text)
    done.out.encode()
    assert all(target.exists() for target in targets.values())
    for suffix in suffixes[:3]:
        source = anisomap.io.read_map(targets[suffix]).provenance["source"]
        assert r"sk\udcffin.csv" in str(source)
    missing = skin_npz.with_name(os.fsdecode(b"n\xff.csv"))
    assert not unsafe(run_map(missing, "-o", "m.csv", code=2).err)


def test_lone_surrogates_are_refused_before_anything_is_written(run, tmp_path: Path) -> None:
    path = tmp_path / "map.json"
    anisomap.io.write(anisomap.SensorMap(np.eye(3), names=["a", "b", "c"], units="m"), path)
    path.write_text(path.read_text().replace('"b"', r'"b\ud800"'))
    said = run("convert", path, "out.csv", code=2).err
    assert "\\ud800" in said
    assert not unsafe(said)
    assert not (tmp_path / "out.csv").exists()


def test_an_encoding_without_the_character_shows_an_escape(
    skin_npz: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = skin_npz.rename(skin_npz.with_name("gr\u00fcn.npz"))
    output = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", output)
    assert run_here(["info", str(path)]) == 0
    output.flush()
    assert rb"gr\xfcn.npz" in output.buffer.getvalue()


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain \u00e9 \u4e2d\u00a0x", "plain \u00e9 \u4e2d\u00a0x"),
        ("a\x1b[2J", r"a\x1b[2J"),
        ("a\nb\t", r"a\nb\t"),
        ("\u202e\u2028\u200b", r"\u202e\u2028\u200b"),
        ("\udcff", r"\udcff"),
        ("\U000e0041", r"\U000e0041"),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown
