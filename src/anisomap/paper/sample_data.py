"""Data S1 to S11 and Texts S1 to S3: sample runs and their documentation as plain text."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from anisomap import io
from anisomap._version import __version__
from anisomap.errors import AnisomapWarning
from anisomap.paper.cases import FAILING, PATCH, SILENT, Case, patch_runs
from anisomap.paper.experiment import Document, Row, Settings, Table, Tables, experiment
from anisomap.recording import Recording
from anisomap.simulation import find_scenario
from anisomap.simulation.options import meanings_of, options_for

_WIDTH = 100
_COLUMNS = {
    "file": "name of the file",
    "what": "content",
    "seed": "seed of the run",
    "frames": "number of frames",
    "sensors": "number of sensors",
}
_FORMAT = """\
Data files are plain text (UTF-8), which `anisomap.read` reads back equal. Lines that begin with #
are comments as "name: value": the source, the frame rate, the true positions of the sensors and the
normals of the skin, which point outwards (x y z of each sensor, separated by semicolons), the unit
of length, and the parameters of the simulation. They are followed by one line with the names of the
sensors and one line per frame, separated by tabs.
"""


@experiment(
    "data-s1-s6",
    "Data S1 to S6 and Text S1: sample runs of all scenarios",
    "Plain-text files. Text S1 describes their format and all parameters of the simulation.",
    cost=20,
)
def sample_runs(settings: Settings, _: Tables) -> Iterator[Document | Table]:
    """Write Data S1 to S6 and Text S1."""
    cases = [Case(body) for body in ("cylinder", "sphere", "plane", "y-shape")]
    cases += [Case(body, "locomotion") for body in ("cylinder", "sphere")]
    rows: list[Row] = []
    for i, case in enumerate(cases, start=1):
        seed = settings.picked_seed(case.name)
        recording, what = case.record(settings, seed), f"{case.body} {case.scenario}"
        text = _text_of(recording)
        yield Document(f"data-s{i}.txt", f"Data S{i}: {what}, seed {seed}.", text)
        rows.append((f"data-s{i}.txt", what, seed, recording.n_frames, recording.n_sensors))
    yield Document(
        "text-s1.txt", "Text S1: the simulation and its parameters.", _text_s1(cases, settings)
    )
    yield Table("data-s1-s6", "Sample runs of all scenarios.", _COLUMNS, rows)


@experiment(
    "data-s7-s11",
    "Data S7 to S11 and Text S2: the five runs of the patch",
    "The runs of the simulated patch, in the same format.",
    cost=8,
)
def sample_patch(settings: Settings, _: Tables) -> Iterator[Document | Table]:
    """Write Data S7 to S11 and Text S2."""
    rows: list[Row] = []
    for number, recording, seed in patch_runs(settings):
        name = f"data-s{6 + number}.txt"
        what = f"simulated patch, run {number}"
        text = _text_of(recording)
        yield Document(name, f"Data S{6 + number}: run {number}, seed {seed}.", text)
        rows.append((name, what, seed, recording.n_frames, recording.n_sensors))
    yield Document("text-s2.txt", "Text S2: the patch and its files.", _text_s2(settings))
    yield Table("data-s7-s11", "The five runs of the simulated patch.", _COLUMNS, rows)


@experiment(
    "text-s3",
    "Text S3: shortest paths leave a metric unchanged",
    "The theorem behind the second step of ANISOMAP, with a proof.",
)
def proof(_: Settings, __: Tables) -> Iterator[Document]:
    """Write Text S3."""
    caption = "Text S3: proof that shortest paths leave a metric unchanged."
    text = files("anisomap.paper").joinpath("templates", "text-s3.txt").read_text(encoding="utf-8")
    yield Document("text-s3.txt", caption, text)


def _text_of(recording: Recording) -> str:
    """Write a recording as text with its positions."""
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # distances along the surface are left out
        path = Path(folder) / "data.tsv"
        io.write(recording, path)
        return path.read_text(encoding="utf-8")


def _text_s1(cases: Iterable[Case], settings: Settings) -> str:
    parts = [
        "Text S1. Summary of the simulation",
        f"Simulated with anisomap {__version__}; the paper's parameters were not available to us. "
        "Lengths are in metres. Each data file repeats the parameters of its run.",
        _FORMAT.strip(),
        "A sensor is a point on the surface of a rigid body, surrounded by a detection sphere. Its "
        "reading is the depth in metres to which the nearest detectable object enters this sphere, "
        "and 0 if there is none. For balls it is max(0, detection_radius + ball_radius - distance "
        "to the centre of the ball), the maximum over all balls. Sensors have no mass and do not "
        "collide. As in the paper's words, they feel all that enters the sphere, through the body, "
        "too: on Y-shape and plane, a third of the non-zero readings come from balls behind the "
        "surface alone. With one_sided = 1, sensors feel balls in front of the skin only.",
    ]
    parts += [_describe(case, settings) for case in cases]
    return "\n\n".join(_wrapped(part) for part in parts) + "\n"


def _text_s2(settings: Settings) -> str:
    parts = [
        "Text S2. The patch and the format of its data",
        "The five runs are simulated, not recorded from hardware. Six triangles of the skin of the "
        "Italian Institute of Technology lie around a vertex. Each has 12 pads, as in the paper. A "
        "hand rubs them along lines and circles.",
        _FORMAT.strip(),
        f"Sensors are named by triangle and pad. The triangle of {SILENT[0]} to {SILENT[-1]} is "
        "silent: its readings are 0 in all runs. From run 4 on, sensor 30 (counted from 0: "
        f"{FAILING}) intermittently jumps to the highest reading of the run, whether touched or "
        "not.",
        _describe(PATCH, settings),
    ]
    return "\n\n".join(_wrapped(part) for part in parts) + "\n"


def _describe(case: Case, settings: Settings) -> str:
    """Describe a body, a scenario and all its parameters."""
    entry, body = find_scenario(case.scenario), case.shape(settings)
    options = options_for(entry.options, body, case.parameters(settings))
    lines = [
        f"{case.body}, {case.scenario}",
        f"    {entry.summary}.",
        f"    {body.n_sensors} sensors; the outermost sensor is {body.reach:.4g} m from the "
        f"centre; neighbouring sensors are {body.spacing:.4g} m apart (median).",
    ]
    lines += [
        f"    {name} = {_plain(getattr(options, name))}: {text}"
        for name, text in meanings_of(options).items()
        if text
    ]
    return "\n".join(lines)


def _wrapped(text: str) -> str:
    return "\n".join(
        textwrap.fill(line, _WIDTH, subsequent_indent=" " * (len(line) - len(line.lstrip())))
        for line in text.splitlines()
    )


def _plain(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
