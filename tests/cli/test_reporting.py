"""Option --json of all reporting commands, and streams that are closed or full."""

import json
import os
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap.cli import app, console, printing
from anisomap.placement.placing import judgement
from command_line import call
from skins import flat_skin

MAP = "map skin.npz -d 2 -m r-anisomap -o m.csv --no-verdict --permutations 9"
COMMANDS = {
    "info skin.npz": "recording",
    MAP: "map",
    "score made.csv skin.npz --permutations 9": "score",
    "check skin.npz skin.npz": "findings",
    "convert made.csv made.json": "files",
    "list methods": "similarities",
    "list formats": "formats",
    "info skin.npz --all": "health",
    "diff made.csv made.csv": "moved",
    "place made.csv": "placed_by",
    "place made.csv --suggest 4": "suggested",
    "repair skin.npz": "findings",
}
SIMULATIONS = {
    "list bodies": "bodies",
    "list scenarios": "scenarios",
    "list scenarios bombardment": "parameters",
    "simulate plane -s rubbing --frames 40 -o sim.npz": "files",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reporting")
    anisomap.write(flat_skin(n_frames=600), folder / "skin.npz")
    made = anisomap.SensorMap(flat_skin().positions, units="mm")
    anisomap.write(made, folder / "made.csv")
    return folder


SCHEMA = json.loads(
    (Path(__file__).parents[2] / "docs" / "reference" / "output.schema.json").read_text()
)
TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
    "null": type(None),
}


def check_schema(value, schema, where="the output"):
    """Check a value by the keywords of JSON Schema that the schema of the outputs has."""
    if "$ref" in schema:
        return check_schema(value, SCHEMA["$defs"][schema["$ref"].split("/")[-1]], where)
    kinds = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    assert isinstance(value, tuple(t for k in kinds for t in np.atleast_1d(TYPES[k]))), where
    assert isinstance(value, bool) == (kinds == ["boolean"]), where
    assert value in schema.get("enum", [value]), where
    if isinstance(value, dict):
        assert set(schema.get("required", ())) <= value.keys(), where
        rest = schema.get("additionalProperties", {"type": list(TYPES)})
        for key, item in value.items():
            if key in schema.get("properties", {}):
                check_schema(item, schema["properties"][key], f"{where}: {key}")
            elif rest is False:
                pytest.fail(f"{where} has the unknown key {key}")
            elif "properties" not in schema and rest != {"type": list(TYPES)}:
                check_schema(item, rest, f"{where}: {key}")
    for item in value if isinstance(value, list) else ():
        check_schema(item, schema["items"], f"an item of {where}")
    return None


def _refuse(constant):
    raise ValueError(f"{constant} is not JSON")


@pytest.mark.parametrize("command", [*COMMANDS, *SIMULATIONS])
def test_results_are_one_json_object(folder, command):
    if command in SIMULATIONS:
        pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    found = call(folder, command, "--json")
    values = json.loads(found.out, parse_constant=_refuse)
    assert (COMMANDS | SIMULATIONS)[command] in values
    check_schema(values, SCHEMA)


@pytest.mark.parametrize(
    "command", ["info nothing.npz", "map skin.npz --frobnicate", "mapp skin.npz"]
)
def test_errors_are_json_if_asked_for(folder, command):
    plain = call(folder, command, code=2)
    found = call(folder, command, "--json", code=2)
    assert found.values["exit_code"] == 2
    check_schema(found.values, SCHEMA)
    assert (found.err, plain.err) == ("", f"error: {found.values['error']}\n")


def test_all_commands_and_files_say_the_same(run, made):
    """Of a sensor without contacts, and of a map."""
    skin = anisomap.read(made / "skin.npz")
    readings = np.array(skin.readings)
    readings[:, 9] = 0
    anisomap.write(anisomap.Recording(readings), "silent.npz")
    mapping = "map silent.npz -m r-anisomap -d 2 --no-verdict -o m.csv"
    info, mapped, repaired = (
        run(command, "--json") for command in ("info silent.npz", mapping, "repair silent.npz")
    )
    said = info.values["health"]
    assert said == mapped.values["health"] == repaired.values["health"]
    for err in (info.err, mapped.err, run("info silent.npz").err):
        assert err.count("never varied") == 1
    ((sensor, status),) = ((one["name"], one["status"]) for one in said)
    stated = anisomap.read_map("m.csv")
    assert stated.health[stated.names.index(sensor)] == status == "silent"

    page = (made / "map.html").read_text(encoding="utf-8")
    assert all(sentence in page for sentence in judgement(anisomap.read_map(made / "map.json")))


def test_no_advice_says_that_touches_suffice_where_the_verdict_asks_for_more():
    golden = Path(__file__).parents[1] / "golden"
    record = json.loads((golden / "record.json").read_text())
    asked = [name for name, row in record.items() if "touch all of" in str(row.get("reasons"))]
    found = 0
    for path in (golden / "readings" / f"{name}.npz" for name in asked):
        if path.exists():
            recording = anisomap.read(path)
            coverage = printing.coverage_without_map(recording)
            told = printing.touch_facts(coverage, recording.names)["touch next"]
            assert not any(word in told for word in ("nowhere", "enough"))
            found += 1
    assert found > 2


def test_the_map_is_written_if_the_reader_closes_the_pipe(folder, monkeypatch):
    monkeypatch.setattr(console.console, "quiet", False)  # restored, since a closed pipe sets it
    reader, writer = os.pipe()
    os.close(reader)
    with chdir(folder), os.fdopen(writer, "w") as pipe, redirect_stdout(pipe):
        assert app.run([*MAP.split(), "-o", "piped.csv"]) == 0
    assert anisomap.read_map(folder / "piped.csv").placed.all()


needs_full = pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="needs a device that is always full"
)


@needs_full
def test_a_full_standard_output_is_an_error_after_files_are_written(folder, capsys):
    with chdir(folder), Path("/dev/full").open("w") as full, redirect_stdout(full):
        assert app.run([*MAP.split(), "-o", "full.csv"]) == 2
    said = capsys.readouterr().err
    assert said == "error: cannot write to standard output: No space left on device\n"
    assert (folder / "full.csv").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="closes streams in a shell of Unix")
@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("list formats >&- 2>&-", 0),
        pytest.param("--help >/dev/full 2>/dev/null", 2, marks=needs_full),
    ],
)
def test_standard_streams_that_are_closed_or_full(tmp_path, command, code):
    shell = ["/bin/sh", "-c", f'exec "$0" -m anisomap {command}', sys.executable]
    done = subprocess.run(shell, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")
