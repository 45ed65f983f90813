"""Data S1 to S11 and Texts S1 to S3: sample runs, and all there is to know of them, in text."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterable
from importlib.resources import files

import numpy as np
from docstring_parser import parse as parse_docstring

from anisomap._version import __version__
from anisomap.paper.experiment import Document, Experiment, Outcome, Settings, Table, Tables
from anisomap.paper.experiments.quality import PATCH_RUNS
from anisomap.paper.runs import BOMBARDED, FAILING, ROLLED, SILENT, Case, patch_run
from anisomap.recording import Recording
from anisomap.simulation import find_body, find_scenario
from anisomap.simulation.options import options_for

_WIDTH = 100
_FILES = {
    "file": "name of the file",
    "what": "what was recorded",
    "seed": "seed of the run",
    "frames": "number of frames",
    "sensors": "number of sensors",
}
_FORMAT = """\
A file of data is plain text (UTF-8, lines that end with a line feed).

Lines that begin with # are comments: what was recorded, every parameter of the simulation as
"name: value", and where the sensors are, a line each:

    # sensor NAME x y z nx ny nz

x y z is the true place, nx ny nz a unit vector that points out of the skin. Then comes one line of
column names, and one line a frame, between tabs: the time in seconds, then what each sensor reads,
in the order of the lines about sensors.
"""


def data_text(title: str, recording: Recording) -> str:
    """Write a recording as plain text.

    Parameters
    ----------
    title : str
    recording : Recording
        With true positions, normals and a rate.

    Returns
    -------
    str
        As Text S1 describes it.
    """
    positions, normals = recording.positions, recording.normals
    if positions is None or normals is None or not recording.rate_hz:
        raise ValueError("sample runs know positions, normals and their rate")
    facts = {"frames": recording.n_frames, "rate_hz": recording.rate_hz, **recording.metadata}
    lines = [f"# {title}", f"# {recording.source}"]
    lines += [f"# {name}: {value}" for name, value in facts.items()]
    lines += [f"# positions in {recording.units}"]
    for name, place, normal in zip(recording.names, positions, normals, strict=True):
        numbers = " ".join(f"{value:.6g}" for value in (*place, *normal))
        lines.append(f"# sensor {name} {numbers}")
    lines.append("\t".join(("time", *recording.names)))
    times = np.arange(recording.n_frames) / recording.rate_hz
    for time, frame in zip(times, recording.readings.tolist(), strict=True):
        lines.append("\t".join((f"{time:.6g}", *(f"{value:.5g}" for value in frame))))
    return "\n".join(lines) + "\n"


def sample_runs(settings: Settings, _: Tables) -> Outcome:
    """Write Data S1 to S6 and Text S1."""
    cases = [_case(BOMBARDED, body) for body in ("cylinder", "sphere", "plane", "y-shape")]
    cases += [_case(ROLLED, body) for body in ("cylinder", "sphere")]
    documents, rows = [], []
    for i, case in enumerate(cases, start=1):
        seed = settings.picked_seed(case.name)
        recording = case.record(settings, seed)
        what = f"{case.body} {case.scenario}"
        text = data_text(f"Data S{i}: sample run, {what}", recording)
        documents.append(Document(f"data-s{i}.txt", f"Data S{i}: {what}, seed {seed}.", text))
        rows.append((f"data-s{i}.txt", what, seed, recording.n_frames, recording.n_sensors))
    documents.append(
        Document("text-s1.txt", "Text S1: the simulation and every parameter.", _text_s1(cases))
    )
    table = Table("data-s1-s6", "Sample runs of every scenario.", _FILES, tuple(rows))
    return Outcome(tables=(table,), documents=tuple(documents))


def patch_runs(settings: Settings, _: Tables) -> Outcome:
    """Write Data S7 to S11 and Text S2."""
    documents, rows = [], []
    for number in PATCH_RUNS:
        recording = patch_run(settings, number)
        name, seed = f"data-s{6 + number}.txt", settings.seed + number - 1
        text = data_text(f"Data S{6 + number}: simulated patch, run {number}", recording)
        caption = f"Data S{6 + number}: run {number}, seed {seed}."
        documents.append(Document(name, caption, text))
        what = f"simulated patch, run {number}"
        rows.append((name, what, seed, recording.n_frames, recording.n_sensors))
    documents.append(Document("text-s2.txt", "Text S2: the patch and its files.", _text_s2()))
    table = Table("data-s7-s11", "The five runs on the simulated patch.", _FILES, tuple(rows))
    return Outcome(tables=(table,), documents=tuple(documents))


def proof(_: Settings, __: Tables) -> Outcome:
    """Write Text S3."""
    caption = "Text S3: shortest-path metricisation leaves a metric unaltered."
    text = files("anisomap.paper").joinpath("templates", "text-s3.txt").read_text(encoding="utf-8")
    return Outcome(documents=(Document("text-s3.txt", caption, text),))


def _case(cases: Iterable[Case], body: str) -> Case:
    return next(case for case in cases if case.body == body)


def _text_s1(cases: Iterable[Case]) -> str:
    parts = [
        "Text S1. Summary of the simulation",
        f"Simulated with anisomap {__version__}, whose defaults these are; the paper's own values "
        "are lost. Lengths are in metres. Each file of data repeats the parameters of its run.",
        _FORMAT.strip(),
        "A sensor is a point on the surface of a rigid body with a sphere of detection around it. "
        "It reads how deep the nearest thing that can be detected reaches into that sphere, in "
        "metres: 0 if nothing does. Against a ball that is max(0, detection_radius + ball_radius - "
        "distance to the ball's middle), the greatest over the balls. Sensors have no weight and "
        "touch nothing.",
    ]
    parts += [_words_on(case) for case in cases]
    return "\n\n".join(_wrapped(part) for part in parts) + "\n"


def _words_on(case: Case) -> str:
    """Describe a body, a scenario and all its parameters."""
    entry, body = find_scenario(case.scenario), find_body(case.body)
    options = options_for(entry.options, body)
    about = parse_docstring(inspect.cleandoc(inspect.getdoc(entry.run) or ""))
    lines = [
        f"{case.body}, {case.scenario}",
        f"    {entry.summary}. {about.short_description}",
        f"    {body.n_sensors} sensors; the body reaches to {body.reach:.4g} m from its middle; "
        f"neighbouring sensors are {body.spacing:.4g} m apart (median).",
    ]
    for kind in reversed(type(options).__mro__):
        for parameter in parse_docstring(inspect.cleandoc(kind.__doc__ or "")).params:
            if hasattr(options, parameter.arg_name):
                value = getattr(options, parameter.arg_name)
                text = " ".join((parameter.description or "").split())
                lines.append(f"    {parameter.arg_name} = {_plain(value)}: {text}")
    return "\n".join(lines)


def _text_s2() -> str:
    parts = [
        "Text S2. The patch and the format of its data",
        "The five runs are not of hardware: they are of a twin in simulation. Six triangles of the "
        "Italian Institute of Technology's skin lie around a corner, 10 pads that sense pressure "
        "and 2 that measure temperature each; a hand rubs them along lines and circles.",
        _FORMAT.strip(),
        f"Sensors are named after triangle and pad. The triangle of {SILENT[0]} to {SILENT[-1]} is "
        "silent: it reads 0 in all frames of all runs. From run 4 on, sensor 30 (counted from 0: "
        f"{FAILING}) jumps to the highest reading of the run now and then, touched or not.",
        _words_on(Case("patch", "hexagon", "rubbing", "")),
    ]
    return "\n\n".join(_wrapped(part) for part in parts) + "\n"


def _wrapped(text: str) -> str:
    return "\n".join(
        textwrap.fill(line, _WIDTH, subsequent_indent=" " * (len(line) - len(line.lstrip())))
        for line in text.splitlines()
    )


def _plain(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


EXPERIMENTS = (
    Experiment(
        "data-s1-s6",
        "Data S1 to S6 and Text S1: sample runs of every scenario",
        "Plain text, with the format and every parameter of the simulation described in Text S1, "
        "for anyone with or without Python.",
        sample_runs,
        cost=20,
    ),
    Experiment(
        "data-s7-s11",
        "Data S7 to S11 and Text S2: the five runs on the patch",
        "As the paper's, of our simulated twin of the patch.",
        patch_runs,
        cost=8,
    ),
    Experiment(
        "text-s3",
        "Text S3: metricising leaves a metric unaltered",
        "The theorem behind ANISOMAP's second step, with its proof in our own words.",
        proof,
    ),
)
