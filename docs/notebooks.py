"""Run notebooks without Jupyter, in the tests and when the documentation is built.

Notebooks are stored without outputs, so that their files change only when their cells do.
"""

import ast
import contextlib
import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

_VALUE = "_"  # as in IPython


class Cell(NamedTuple):
    """A cell of a notebook: "markdown" or "code"."""

    kind: str
    source: str


class Output(NamedTuple):
    """What a cell printed, and the value of its last expression (None without one)."""

    printed: str
    value: Any


def read_notebook(text: str) -> list[Cell]:
    """Return the cells of a notebook (nbformat 4)."""
    return [Cell(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]


def run(cells: Sequence[Cell], folder: Path) -> Iterator[tuple[Cell, Output]]:
    """Run the code cells one after another in one namespace, in a folder for their files."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in cells:
        with contextlib.chdir(folder):
            output = _execute(cell.source, names) if cell.kind == "code" else Output("", None)
        yield cell, output


def to_markdown(text: str, folder: Path, address: str) -> str:
    """Return a notebook as a page in MyST Markdown, with the outputs of its cells.

    Parameters
    ----------
    text : str
        The notebook file.
    folder : Path
        Folder for figures and for the files that cells write; it is created.
    address : str
        Address of that folder in the documentation.
    """
    folder.mkdir(parents=True, exist_ok=True)
    blocks = []
    for i, (cell, output) in enumerate(run(read_notebook(text), folder)):
        if cell.kind == "markdown":
            blocks.append(cell.source)
            continue
        blocks.append(f"```python\n{cell.source}\n```")
        shown = output.printed
        if hasattr(output.value, "savefig"):
            output.value.savefig(folder / f"{i}.png", dpi=100)
            blocks.append(f"```{{image}} {address}/{i}.png\n:alt: Figure drawn by this cell\n```")
        elif output.value is not None:
            shown += repr(output.value)
        if shown:
            blocks.append(f"```text\n{shown.rstrip()}\n```")
    return "\n\n".join(blocks) + "\n"


def _execute(source: str, names: dict[str, Any]) -> Output:
    tree = ast.parse(source)
    names[_VALUE] = None
    if tree.body and isinstance(tree.body[-1], ast.Expr):
        target = ast.Name(_VALUE, ast.Store())
        tree.body[-1] = ast.Assign([target], tree.body[-1].value)
        ast.fix_missing_locations(tree)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, "<cell>", "exec"), names)
    return Output(printed.getvalue(), names[_VALUE])
