"""``anisomap methods``, ``formats``, ``bodies``, ``scenarios`` and ``faults``: lists."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Sequence

import anisomap
from anisomap import io
from anisomap.base.wording import number
from anisomap.cli import parameters as options
from anisomap.cli.console import Printer


def methods(*, printer: options.Printing = options.PRINTER) -> None:
    """List the methods and the similarities."""
    from anisomap.evaluation.rivals import RIVALS
    from anisomap.method.named import PAPER_METHODS

    own = [
        (name, method.summary, "the paper" if name in PAPER_METHODS else "anisomap")
        for name, method in anisomap.METHODS.items()
    ]
    stock = [(name, rival.summary, rival.extra or "-") for name, rival in RIVALS.items()]
    similarities = [(name, one.summary) for name, one in anisomap.SIMILARITIES.items()]
    _print_rows(printer, "Methods", "name summary source", own)
    title = "Stock methods, for comparison only (anisomap compare)"
    _print_rows(printer, title, "name summary extra", stock)
    _print_rows(printer, "Similarities", "name summary", similarities)


def formats(*, printer: options.Printing = options.PRINTER) -> None:
    """List the file formats, what reads and writes them, and the extras that they need."""
    rows = [
        (
            form.name,
            " ".join(form.suffixes),
            _abilities(recording=form.open_recording, map=form.read_map),
            _abilities(recording=form.write_recording, map=form.write_map),
            form.extra or "-",
            form.summary,
        )
        for form in io.FORMATS
    ]
    _print_rows(printer, "Formats", "name suffixes reads writes extra summary", rows)


def bodies(*, printer: options.Printing = options.PRINTER) -> None:
    """List the bodies that can be simulated."""
    rows = []
    for name, make in anisomap.simulation.BODIES.items():
        body = make()
        size = (f"{number(length, 3)} {body.units}" for length in (body.reach, body.spacing))
        rows.append((name, str(body.n_sensors), *size, _first_line(make).removeprefix("Make ")))
    _print_rows(printer, "Bodies", "name sensors reach spacing summary", rows)
    printer.line("A closed mesh, a MuJoCo model or a file of positions works, too:")
    printer.line("  anisomap simulate part.stl --sensors 200")


def scenarios(
    scenario: str | None = None, /, *, printer: options.Printing = options.PRINTER
) -> None:
    """List the scenarios, or the parameters of one scenario.

    Parameters
    ----------
    scenario
        Scenario for which to list the parameters, with their defaults for a sphere of 1 m.
    """
    from anisomap.simulation import SCENARIOS, find_scenario
    from anisomap.simulation.options import meanings_of

    if scenario is None:
        rows = [(name, entry.summary) for name, entry in SCENARIOS.items()]
        _print_rows(printer, "Scenarios", "name summary", rows)
        return
    options_of = find_scenario(scenario).options()
    parameters = [
        {"name": name, "default": getattr(options_of, name), "summary": text}
        for name, text in meanings_of(options_of).items()
    ]
    printer.record(scenario=scenario, parameters=parameters)
    for one in parameters:
        printer.line(f"{one['name']} = {one['default']}")
        printer.line(textwrap.indent(textwrap.fill(one["summary"], 96), "  "))


def faults(*, printer: options.Printing = options.PRINTER) -> None:
    """List the faults that `anisomap spoil` can inject."""
    from anisomap.simulation import FAULTS, FRAME_FAULTS

    rows = []
    for name, function in {**FAULTS, **FRAME_FAULTS}.items():
        parameters = inspect.signature(function).parameters.values()
        taken = ", ".join(
            f"{one.name}={one.default}"
            for one in parameters
            if one.kind is one.KEYWORD_ONLY and one.name not in ("rng", "source")
        )
        affects = "sensors" if name in FAULTS else "all sensors"
        rows.append((name, affects, taken or "-", _first_line(function)))
    _print_rows(printer, "Faults", "name affects parameters summary", rows)


def _print_rows(printer: Printer, title: str, columns: str, rows: Sequence[Sequence[str]]) -> None:
    """Print and record a table; its columns are separated by blanks."""
    names = columns.split()
    printer.table(title, names, rows)
    key = title.split(",", maxsplit=1)[0].lower().replace(" ", "_")
    printer.values[key] = [dict(zip(names, row, strict=True)) for row in rows]


def _first_line(thing: object) -> str:
    return (inspect.getdoc(thing) or "").splitlines()[0].removesuffix(".")


def _abilities(**abilities: object) -> str:
    return ", ".join(f"{kind}s" for kind, ability in abilities.items() if ability) or "-"
