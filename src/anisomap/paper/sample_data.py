"""Data S1 to S11 and Text S3: sample runs with their parameters, and a proof, as plain text."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from anisomap import io
from anisomap.errors import AnisomapWarning
from anisomap.paper.cases import Case, patch_runs
from anisomap.paper.experiment import Document, Row, Settings, Table, Tables, experiment
from anisomap.recording import Recording

_COLUMNS = {
    "file": "name of the file",
    "what": "content",
    "seed": "seed of the run",
    "frames": "number of frames",
    "sensors": "number of sensors",
}


@experiment(
    "data-s1-s6",
    "Data S1 to S6: sample runs of all scenarios",
    "Plain-text files, which `anisomap.read` reads. Lines that begin with # state the parameters.",
    cost=20,
)
def sample_runs(settings: Settings, _: Tables) -> Iterator[Document | Table]:
    """Write Data S1 to S6."""
    cases = [Case(body) for body in ("cylinder", "sphere", "plane", "y-shape")]
    cases += [Case(body, "locomotion") for body in ("cylinder", "sphere")]
    rows: list[Row] = []
    for i, case in enumerate(cases, start=1):
        seed = settings.picked_seed(case.name)
        recording, what = case.record(settings, seed), f"{case.body} {case.scenario}"
        yield _document(i, what, seed, recording, rows)
    yield Table("data-s1-s6", "Sample runs of all scenarios.", _COLUMNS, rows)


@experiment(
    "data-s7-s11",
    "Data S7 to S11: the five runs of the patch",
    "The runs of the simulated patch, in the same format.",
    cost=8,
)
def sample_patch(settings: Settings, _: Tables) -> Iterator[Document | Table]:
    """Write Data S7 to S11."""
    rows: list[Row] = []
    for number, recording, seed in patch_runs(settings):
        yield _document(6 + number, f"simulated patch, run {number}", seed, recording, rows)
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


def _document(number: int, what: str, seed: int, recording: Recording, rows: list[Row]) -> Document:
    """Write a recording with positions as text, and add a row about it."""
    name = f"data-s{number}.txt"
    rows.append((name, what, seed, recording.n_frames, recording.n_sensors))
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # surface distances are left out
        path = Path(folder) / "data.tsv"
        io.write(recording, path)
        text = path.read_text(encoding="utf-8")
    return Document(name, f"Data S{number}: {what}, seed {seed}.", text)
