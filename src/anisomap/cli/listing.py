"""``anisomap methods`` and ``anisomap formats``: what there is, a line each."""

from __future__ import annotations

from anisomap.cli.console import show_table
from anisomap.formats import FORMATS
from anisomap.methods import METHODS, PAPER_METHODS, SIMILARITIES


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
    """List the file formats, and what can be read from and written to each."""
    show_table(
        "Formats",
        ("name", "suffixes", "reads", "writes", "what it is"),
        [
            (
                form.name,
                " ".join(form.suffixes),
                _which(recording=form.read_recording, map=form.read_map),
                _which(recording=form.write_recording, map=form.write_map),
                form.summary,
            )
            for form in FORMATS
        ],
    )


def _which(**abilities: object) -> str:
    return ", ".join(f"{what}s" for what, ability in abilities.items() if ability) or "-"
