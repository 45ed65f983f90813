"""Notes on a map: kinds with values, and the only definitions of their texts.

Decisions depend on the kind of a note, never on the text.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from anisomap.base.wording import join_items


class Note(str):
    """A caveat; the string is the sentence.

    Parameters
    ----------
    kind : str
        A key of `WORDINGS`.
    **values
        Values for the wording of this kind.
    """

    kind: str
    values: Mapping[str, Any]

    def __new__(cls, kind: str, **values: Any) -> Note:
        """Format a note."""
        note = super().__new__(cls, WORDINGS[kind](**values))
        note.kind, note.values = kind, MappingProxyType(values)
        return note

    def __reduce__(self) -> tuple[Callable[..., Note], tuple[str, dict[str, Any]]]:
        """Pickle the kind and the values."""
        return _note, (self.kind, dict(self.values))


def _note(kind: str, values: Mapping[str, Any]) -> Note:
    return Note(kind, **values)


_TOUCHED = ("apart", "paired", "few-sensors", "chance", "halves-disagree")


def untouched(note: str) -> str:
    """Return a note with advice for electrodes, which are not touched."""
    if isinstance(note, Note) and note.kind in _TOUCHED:
        return Note(note.kind, **note.values, touched=False)
    return note


_SIZE = re.compile(r"\bby (\d+\.\d+) spacings")


def kind_of(note: str) -> str:
    """Return the kind of a note; empty for a note that was read from a file."""
    return note.kind if isinstance(note, Note) else ""


def scaled_note(note: str, spacing: float, unit: str) -> str:
    """Return a note with its size in spacings converted to a length; other notes are unchanged.

    spacing: Length of a spacing.
    """
    if not isinstance(note, Note):  # read from a file
        return _SIZE.sub(lambda size: f"by {spacing * float(size[1]):.2f} {unit}", note)
    if "size" not in note.values:
        return note
    return Note(note.kind, **{**note.values, "size": spacing * note.values["size"], "unit": unit})


def _components(sizes: Sequence[int], outside: Sequence[str]) -> str:
    mostly = "no component contains most of the skin: " if 2 * sizes[0] < sum(sizes) else ""
    return (
        f"{mostly}the sensors form {len(sizes)} separate components, whose relative positions are "
        f"unknown; sizes: {join_items(sizes)}; sensors outside the largest: {join_items(outside)}"
    )


WORDINGS: Mapping[str, Callable[..., str]] = MappingProxyType(
    {
        "components": _components,
        "hidden-links": lambda sensors, total: (
            f"noise hides how {len(sensors)} of {total} sensors are related to other sensors, so "
            f"their positions are uncertain ({join_items(sensors)})"
        ),
        "unknown-pairs": lambda count, sensors: (
            f"{count:,} pairs of sensors were never recorded together (sensors: "
            f"{join_items(sensors, 5)}); their distances are estimated from other pairs only"
        ),
        "not-converged": lambda: "scaling stopped before it converged: allow more iterations",
        "not-refined": lambda method: (
            f"the positions are not refined, because {method} needs similarities for this"
        ),
        "different-contacts": lambda share: (
            f"contacts differ from place to place ({share:.0%} of the variance of the correlations "
            "is not explained by distance), so lengths are less certain than neighbours"
        ),
        "looks-flat": lambda objects=False: (
            "a third dimension explains no more than chance: 2 dimensions suffice (-d 2)"
            if objects
            else "the map looks flat: a third dimension explains no more than chance; unless the "
            "skin is bent like a sheet of paper, a map in 2 dimensions (-d 2) is more accurate"
        ),
        "unclear-dimensions": lambda objects=False: (
            "the dissimilarities do not show the number of dimensions: choose it (-d 2)"
            if objects
            else "the readings do not show whether the skin is flat, so the map has 3 dimensions: "
            "for a flat skin, choose 2 (-d 2)"
        ),
        "line": lambda objects=False: (
            f"the {'objects' if objects else 'sensors'} appear to lie along a line: choose 1 "
            "dimension (-d 1)"
        ),
        "two-dimensions": lambda objects=False: (
            "a third dimension explains no more than chance"
            + (
                ""
                if objects
                else "; a skin that is bent like a sheet of paper is mapped as if unrolled"
            )
        ),
        "three-dimensions": lambda objects=False: (
            f"two dimensions do not explain the {'dissimilarities' if objects else 'readings'}"
        ),
        "apart": lambda apart, placed, touched=True: (
            f"the positions of {apart} of {placed} sensors relative to the other sensors are "
            f"unknown; {'touch the skin between them' if touched else 'record longer'}"
        ),
        "unlinked": lambda count, total: (
            f"{count} of {total} sensors have no significant correlations with the other sensors; "
            "record longer"
        ),
        "halves-disagree": lambda agreement, touched=True: (
            f"similarities differ between halves of the recording (correlation {agreement:.2f}): "
            "a few strong frames may dominate them; record "
            + ("more contacts" if touched else "longer")
        ),
        "one-period": lambda share, period: (
            f"{share:.0%} of the variance of the readings is a sine with a period of {period:.4g} "
            "frames: such readings do not show which sensors are adjacent"
        ),
        "paired": lambda touched=True: (
            "sensors pair off: most are far more similar to one partner than to any other sensor"
            + (
                ", as if two places were always touched together; touch each place separately"
                if touched
                else ""
            )
        ),
        "rarely-touched": lambda count, total: (
            f"{count} of {total} sensors have too few contacts for a position; touch the whole skin"
        ),
        "chance": lambda size, much, unit="spacings", touched=True: (
            f"maps of resampled recordings differ by {size:.2f} {unit}"
            + (": record longer" if much and not touched else "")
            + (": record longer, and touch all of the skin" if much and touched else "")
        ),
        "second-map": lambda size, much, unit="spacings": (
            f"a second map, which assumes even spacing, differs by {size:.2f} {unit}"
            + (": contacts may be elongated or differ in size from place to place" if much else "")
        ),
        "map-of-paths": lambda size, much, unit="spacings": (
            f"a second map, made from lengths of paths, differs by {size:.2f} {unit}"
            + (": contacts may differ in size from place to place" if much else "")
        ),
        "if-compact": lambda size, unit="spacings": (
            "the sensors are unevenly spaced on the map: if they are on the skin, too, and if all "
            f"contacts were compact (fingertips or balls), positions are off by {size:.2f} {unit} "
            "(--uneven --contacts compact); else the map may be folded or compressed"
        ),
        "compact": lambda size, unit="spacings": (
            f"positions are off by {size:.2f} {unit} if, as stated, sensors are unevenly spaced "
            "and all contacts were compact: a compression by long contacts cannot be detected"
        ),
        "if-flat": lambda size, unit="spacings": (
            "the readings do not show whether the skin is flat: if it is, positions are off by "
            f"{size:.2f} {unit}; choose the number of dimensions (-d 2 or -d 3)"
        ),
        "if-bent": lambda size, unit="spacings": (
            f"a third dimension hardly improves the fit, and changes the map by {size:.2f} {unit}: "
            "if the skin may be bent in two directions, choose the number of dimensions (-d 2 or "
            "-d 3)"
        ),
        "chosen-dimensions": lambda: (
            "the number of dimensions was chosen from readings that do not determine the shape: "
            "choose the number yourself if you know it (-d 2 or -d 3)"
        ),
        "not-examined": lambda: "the map was not examined",
        "other-readings": lambda: "a verdict needs the readings that the map was made from",
        "no-verdict": lambda method, default: f"maps by {method} have no verdict: use {default}",
        "no-common-sensors": lambda least: (
            f"the recordings have fewer than {least} sensors in common: map one of them"
        ),
        "few-sensors": lambda count, least, touched=True: (
            f"only {count} sensors are related, but a verdict needs {least}: "
            + ("touch more of the skin" if touched else "record more sensors")
        ),
        "many-sensors": lambda most: (
            f"resampling more than {most:,} sensors takes too much memory: map parts of the skin"
        ),
        "many-dimensions": lambda most: (
            f"a verdict needs a map in at most {most} dimensions: choose 2 or 3 (-d 2 or -d 3)"
        ),
        "few-frames": lambda count, least: (
            f"only {count} frames were recorded, but a verdict needs {least}: record longer"
        ),
    }
)
"""Functions that format the sentence of each kind of note from its values."""
