"""``anisomap list``: methods, formats, and what can be simulated."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Sequence
from typing import Literal

import anisomap
from anisomap import io
from anisomap.base.wording import number
from anisomap.cli import parameters as options
from anisomap.cli.console import Printer
from anisomap.errors import InputError


def list_kind(
    kind: Literal["methods", "formats", "bodies", "scenarios"],
    name: str | None = None,
    /,
    *,
    printer: options.Printing = options.PRINTER,
) -> None:
    """List methods, formats, bodies or scenarios.

    Parameters
    ----------
    kind
        methods (and similarities), formats, bodies or scenarios.
    name
        Scenario to explain. Default lengths are for a sphere with a radius of 1 m.

    Examples
    --------
    anisomap list methods
    anisomap list formats
    anisomap list scenarios bombardment
    """
    if name is None:
        {"methods": _methods, "formats": _formats, "bodies": _bodies, "scenarios": _scenarios}[
            kind
        ](printer)
    elif kind == "scenarios":
        _explain_scenario(printer, name)
    else:
        raise InputError(f"only scenarios have parameters to list, not {kind}")


def _methods(printer: Printer) -> None:
    from anisomap.method.named import PAPER_METHODS

    own = [
        (name, method.summary, "the paper" if name in PAPER_METHODS else "anisomap")
        for name, method in anisomap.METHODS.items()
    ]
    similarities = [(name, one.summary) for name, one in anisomap.SIMILARITIES.items()]
    _print_rows(printer, "Methods", "name summary source", own)
    _print_rows(printer, "Similarities", "name summary", similarities)
    printer.say(
        "Noise at rest distorts mutual-information and spearman where contacts are rare: set "
        "readings below a threshold above the noise to 0, or use the default method."
    )


def _formats(printer: Printer) -> None:
    records = [
        {
            "name": form.name,
            "suffixes": " ".join(form.suffixes),
            "recordings": _abilities(form.open_recording, form.write_recording),
            "maps": _abilities(form.read_map, form.write_map),
            "extra": form.extra,
            "summary": form.summary + (f" (extra {form.extra})" if form.extra else ""),
        }
        for form in io.FORMATS
    ]
    rows = [
        (one["suffixes"] or one["name"], one["recordings"], one["maps"], one["summary"])
        for one in records
    ]
    title = "Formats: r is read, w is written"
    printer.table(title, ["format", "recordings", "maps", "summary"], rows)
    printer.record(formats=records)


def _bodies(printer: Printer) -> None:
    rows = []
    for name, make in anisomap.simulation.BODIES.items():
        body = make()
        size = (f"{number(length, 3)} {body.units}" for length in (body.reach, body.spacing))
        summary = (inspect.getdoc(make) or "").splitlines()[0].removesuffix(".")
        rows.append((name, str(body.n_sensors), *size, summary.removeprefix("Make ")))
    _print_rows(printer, "Bodies", "name sensors reach spacing summary", rows)
    printer.line("A file of the positions of sensors works, too:")
    printer.line("  anisomap simulate sensors.csv")


def _scenarios(printer: Printer) -> None:
    rows = [(name, entry.summary) for name, entry in anisomap.simulation.SCENARIOS.items()]
    _print_rows(printer, "Scenarios", "name summary", rows)


def _explain_scenario(printer: Printer, name: str) -> None:
    from anisomap.simulation import find_scenario
    from anisomap.simulation.options import meanings_of

    options_of = find_scenario(name).options()
    parameters = [
        {"name": one, "default": getattr(options_of, one), "summary": text}
        for one, text in meanings_of(options_of).items()
    ]
    printer.record(scenario=name, parameters=parameters)
    for one in parameters:
        printer.line(f"{one['name']} = {one['default']}")
        printer.line(textwrap.indent(textwrap.fill(str(one["summary"]), 96), "  "))


def _print_rows(printer: Printer, title: str, columns: str, rows: Sequence[Sequence[str]]) -> None:
    """Print and record a table; its columns are separated by blanks."""
    names = columns.split()
    printer.table(title, names, rows)
    key = title.split(",", maxsplit=1)[0].lower().replace(" ", "_")
    printer.values[key] = [dict(zip(names, row, strict=True)) for row in rows]


def _abilities(read: object, write: object) -> str:
    return f"{'r' if read else ''}{'w' if write else ''}" or "-"
