"""Notes on a map: kinds with values, which are put into words here alone.

Decisions test the kind of a note, never its text.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from anisomap.base.wording import join_items


class Note(str):
    """A caveat, which is the sentence that says it.

    Parameters
    ----------
    kind : str
        A key of `WORDINGS`.
    **values
        What the wording of this kind states.
    """

    kind: str
    values: Mapping[str, Any]

    def __new__(cls, kind: str, **values: Any) -> Note:
        """Word a note."""
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
    """Return a note with advice for electrodes, which nobody touches."""
    if isinstance(note, Note) and note.kind in _TOUCHED:
        return Note(note.kind, **note.values, touched=False)
    return note


_SIZE = re.compile(r"\bby (\d+\.\d+) spacings")


def kind_of(note: str) -> str:
    """Return the kind of a note; empty for one that was read from a file."""
    return note.kind if isinstance(note, Note) else ""


def scaled_note(note: str, spacing: float, unit: str) -> str:
    """Return a note whose size is in spacings with its length in a unit; other notes as they are.

    spacing: Length of a spacing.
    """
    if not isinstance(note, Note):  # it was read from a file
        return _SIZE.sub(lambda size: f"by {spacing * float(size[1]):.2f} {unit}", note)
    if "size" not in note.values:
        return note
    return Note(note.kind, **{**note.values, "size": spacing * note.values["size"], "unit": unit})


def _components(sizes: Sequence[int], outside: Sequence[str]) -> str:
    mostly = "most of the skin is not mapped: " if 2 * sizes[0] < sum(sizes) else ""
    return (
        f"{mostly}the sensors form {len(sizes)} separate components with unknown positions "
        f"relative to one another; sizes: {join_items(sizes)}; outside the largest: "
        f"{join_items(outside)}"
    )


def _hidden_links(sensors: Sequence[str], total: int) -> str:
    return (
        "sensors with uncertain positions, because noise hides how they are related to the others: "
        f"{len(sensors)} of {total} ({join_items(sensors)})"
    )


def _unknown_pairs(count: int, sensors: Sequence[str]) -> str:
    return (
        f"pairs of sensors that were never recorded together: {count:,} (sensors: "
        f"{join_items(sensors, 5)}); their distances follow from other pairs only"
    )


def _looks_flat(objects: bool = False) -> str:
    if objects:
        return "a third dimension explains no more than chance: 2 dimensions suffice (-d 2)"
    return (
        "this looks flat: a third dimension explains no more than chance; unless the skin is bent "
        "like a sheet of paper, a map in 2 dimensions (-d 2) is more accurate"
    )


def _unclear_dimensions(objects: bool = False) -> str:
    if objects:
        return "the dissimilarities do not show the number of dimensions: choose it (-d 2)"
    return (
        "the readings do not show whether the skin is flat, so the map has 3 dimensions: for a "
        "flat skin, choose 2 (-d 2)"
    )


def _line(objects: bool = False) -> str:
    what = "objects" if objects else "sensors"
    return f"the {what} appear to lie along a line: to map them along it, choose 1 dimension (-d 1)"


def _two_dimensions(objects: bool = False) -> str:
    bent = "; a skin that is bent like a sheet of paper is mapped as if rolled out"
    return f"a third dimension explains no more than chance{'' if objects else bent}"


def _three_dimensions(objects: bool = False) -> str:
    what = "dissimilarities" if objects else "readings"
    return f"two dimensions do not explain the {what}"


WORDINGS: Mapping[str, Callable[..., str]] = MappingProxyType(
    {
        "components": _components,
        "hidden-links": _hidden_links,
        "unknown-pairs": _unknown_pairs,
        "not-converged": lambda: "scaling stopped before it converged: allow more iterations",
        "not-refined": lambda method: (
            f"the positions are not refined: for this, {method} needs the similarity"
        ),
        "different-contacts": lambda share: (
            f"contacts differ from place to place ({share:.0%} of the variance of the correlations "
            "does not follow from distance), so lengths are less certain than neighbours"
        ),
        "looks-flat": _looks_flat,
        "unclear-dimensions": _unclear_dimensions,
        "line": _line,
        "two-dimensions": _two_dimensions,
        "three-dimensions": _three_dimensions,
        "apart": lambda apart, placed, touched=True: (
            "sensors whose positions relative to the others are unknown: "
            f"{apart} of {placed}; "
            + ("touch the skin where they join" if touched else "record longer")
        ),
        "unlinked": lambda count, total: (
            "sensors whose correlations with the others do not exceed noise: "
            f"{count} of {total}; record longer"
        ),
        "halves-disagree": lambda agreement, touched=True: (
            f"similarities differ between halves of the recording (their correlation is "
            f"{agreement:.2f}): they may be due to a few strong frames; record "
            + ("more contacts" if touched else "longer")
        ),
        "one-period": lambda share, period: (
            f"{share:.0%} of the variance of the readings is a sine with a period of {period:.4g} "
            "frames: such readings do not show which sensors are near"
        ),
        "paired": lambda touched=True: (
            "sensors pair off: most resemble one other far more than the rest"
            + (
                ", as if two places were always touched together; touch each place by itself"
                if touched
                else ""
            )
        ),
        "rarely-touched": lambda count, total: (
            f"sensors with too few contacts for a position: {count} of {total}; touch all of the "
            "skin"
        ),
        "small-body": lambda extent: (
            f"the sensors are only {extent:.1f} spacings from their centre (RMS), so that errors "
            "of this size change the shape"
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
            f"a second map, of the lengths of paths, differs by {size:.2f} {unit}"
            + (": contacts may differ in size from place to place" if much else "")
        ),
        "if-compact": lambda size, unit="spacings": (
            "the sensors are unevenly spaced on the map, and a fold or long contacts may have "
            "caused this unnoticed: if they are unevenly spaced on the skin, too, and all contacts "
            "were compact, such as those of a fingertip or a ball, positions are off by "
            f"{size:.2f} {unit} (--uneven --contacts compact)"
        ),
        "compact": lambda size, unit="spacings": (
            f"positions are off by {size:.2f} {unit} if sensors are not evenly spaced and all "
            "contacts were compact, as stated: long contacts would compress the map unnoticed"
        ),
        "if-flat": lambda size, unit="spacings": (
            "the readings do not show whether the skin is flat: if it is, positions are off by "
            f"{size:.2f} {unit}; choose the number of dimensions (-d 2 or -d 3)"
        ),
        "if-bent": lambda size, unit="spacings": (
            "a third dimension hardly improves the fit but changes the map: if the skin is bent in "
            f"two directions, positions are off by {size:.2f} {unit}; choose the number of "
            "dimensions (-d 2 or -d 3)"
        ),
        "chosen-dimensions": lambda: (
            "the number of dimensions was chosen from readings that do not show the shape for "
            "certain: choose it if it is known (-d 2 or -d 3)"
        ),
        "not-examined": lambda: "the map was not examined",
        "other-readings": lambda: "a verdict needs the readings that the map was made from",
        "no-verdict": lambda method, default: f"maps by {method} have no verdict: use {default}",
        "no-common-sensors": lambda least: (
            f"the recordings have fewer than {least} sensors in common: map one of them"
        ),
        "few-sensors": lambda count, least, touched=True: (
            f"too few sensors are related: {count}, and a verdict needs {least}: "
            + ("touch more of the skin" if touched else "record more of them")
        ),
        "many-sensors": lambda most: (
            f"resampling more than {most:,} sensors takes too much memory: map parts of the skin"
        ),
        "many-dimensions": lambda most: (
            f"a verdict needs a map in at most {most} dimensions: choose 2 or 3 (-d 2 or -d 3)"
        ),
        "few-frames": lambda count, least: (
            f"too few frames: {count}, and a verdict needs {least}: record longer"
        ),
    }
)
"""The sentence of each kind of note, from its values."""
