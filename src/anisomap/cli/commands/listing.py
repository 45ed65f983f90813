"""``anisomap methods``, ``formats``, ``bodies``, ``scenarios``, ``faults``: what there is."""

from __future__ import annotations

import inspect

from docstring_parser import parse as parse_docstring
from rich.markup import escape
from rich.padding import Padding

from anisomap.cli.console import console, number, show_table
from anisomap.io import FORMATS
from anisomap.methods import METHODS, PAPER_METHODS
from anisomap.simulation import BODIES, FAULTS, FRAME_FAULTS, SCENARIOS, find_scenario
from anisomap.stages.pairs import SIMILARITIES


def methods() -> None:
    """List the methods and the similarities."""
    show_table(
        "Methods",
        ("name", "what it does", "from"),
        [
            (name, method.summary, "the paper" if name in PAPER_METHODS else "anisomap")
            for name, method in METHODS.items()
        ],
    )
    show_table(
        "Similarities",
        ("name", "what it is"),
        [(name, similarity.summary) for name, similarity in SIMILARITIES.items()],
    )


def formats() -> None:
    """List the file formats, what can be read from and written to each, and what that needs."""
    show_table(
        "Formats",
        ("name", "suffixes", "reads", "writes", "extra", "what it is"),
        [
            (
                form.name,
                " ".join(form.suffixes),
                _which(recording=form.open_recording, map=form.read_map),
                _which(recording=form.write_recording, map=form.write_map),
                form.extra or "-",
                form.summary,
            )
            for form in FORMATS
        ],
    )


def bodies() -> None:
    """List the bodies that can be simulated."""
    rows = []
    for name, make in BODIES.items():
        body = make()
        size = (f"{number(length, 3)} {body.units}" for length in (body.reach, body.spacing))
        rows.append((name, str(body.n_sensors), *size, _first_line(make).removeprefix("Make ")))
    show_table("Bodies", ("name", "sensors", "reach", "spacing", "what it is"), rows)
    console.print(
        "A closed mesh, a MuJoCo model or a file of positions is a body, too:\n"
        "  anisomap simulate part.stl --sensors 200",
        soft_wrap=True,
    )


def scenarios(scenario: str | None = None, /) -> None:
    """List what can happen to a body; of one scenario, every parameter.

    Parameters
    ----------
    scenario
        Whose parameters to tell, with their defaults for the paper's sphere.
    """
    if scenario is None:
        rows = [(name, entry.summary) for name, entry in SCENARIOS.items()]
        show_table("Scenarios", ("name", "what happens"), rows)
        return
    options = find_scenario(scenario).options
    defaults = options()
    # Options may inherit parameters, which are documented where they come from.
    for kind in reversed(options.__mro__):
        for entry in parse_docstring(inspect.cleandoc(kind.__doc__ or "")).params:
            if hasattr(defaults, entry.arg_name):
                console.print(f"[bold]{entry.arg_name}[/] = {getattr(defaults, entry.arg_name)}")
                text = " ".join((entry.description or "").split())
                console.print(Padding(escape(text), (0, 0, 0, 2)))


def faults() -> None:
    """List what can go wrong with a recording, for `anisomap spoil`."""
    rows = []
    for name, function in {**FAULTS, **FRAME_FAULTS}.items():
        parameters = inspect.signature(function).parameters.values()
        taken = ", ".join(
            f"{one.name}={one.default}"
            for one in parameters
            if one.kind is one.KEYWORD_ONLY and one.name not in ("rng", "source")
        )
        befalls = "sensors" if name in FAULTS else "all sensors"
        rows.append((name, befalls, taken or "-", _first_line(function)))
    show_table("Faults", ("name", "of", "parameters", "what it does"), rows)


def _first_line(thing: object) -> str:
    return (inspect.getdoc(thing) or "").splitlines()[0].removesuffix(".")


def _which(**abilities: object) -> str:
    return ", ".join(f"{what}s" for what, ability in abilities.items() if ability) or "-"
