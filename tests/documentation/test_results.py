"""Tables of results in the documentation have the columns that their commands write."""

import csv
from pathlib import Path

import pytest
from benchmarks.accuracy import check, dimension, limits, quality
from benchmarks.harness import columns
from benchmarks.live import coach, session
from benchmarks.placing import placement, self_touch, updating
from benchmarks.verdicts import faults, trust

from anisomap.cli.commands import comparison as comparison_tables
from anisomap.comparison import COMPARED
from anisomap.paper import accuracy, bodies, claims

RESULTS = Path(__file__).parents[2] / "docs" / "results"


HEADERS = {
    "bins": accuracy.BINS_COLUMNS,
    "check": columns(check.Result),
    "claims": claims.COLUMNS,
    "coach": columns(coach.Row),
    "coach-evenness": coach.EVENNESS_COLUMNS,
    "coach-summary": columns(coach.Goal),
    "dimension": columns(dimension.Row),
    "dimensions": accuracy.DIMENSIONS_COLUMNS,
    "faults": columns(faults.Result),
    "figure-3": accuracy.SUMMARY_COLUMNS,
    "figure-4": bodies.AXIAL_COLUMNS,
    "figure-7": bodies.ROUNDNESS_COLUMNS,
    "limits": columns(limits.Limits),
    "live-memory": session.MEMORY_COLUMNS,
    "placement": columns(placement.Figure),
    "quality": columns(quality.Result),
    "recordings": comparison_tables.columns(COMPARED),
    "rivals": accuracy.RIVALS_COLUMNS,
    "self-touch": self_touch.HEADER,
    "trust": trust.COLUMNS,
    "updating": columns(updating.Figure),
}


@pytest.mark.parametrize("path", sorted(RESULTS.iterdir()), ids=lambda path: path.name)
def test_columns_are_those_that_the_command_writes(path):
    with path.open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    assert header == list(HEADERS[path.stem])
