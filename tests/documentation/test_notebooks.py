"""Notebooks of the documentation run, and hold no outputs."""

import json
from pathlib import Path

import pytest
from docs.notebooks import read_notebook, run

NOTEBOOKS = sorted(Path(__file__).parents[2].joinpath("docs").glob("**/*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_cells_run_in_order(path, tmp_path):
    outputs = [output for _, output in run(read_notebook(path.read_text("utf-8")), tmp_path)]
    assert any(hasattr(output.value, "savefig") for output in outputs)
    assert any(tmp_path.iterdir())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_no_outputs_are_stored(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
