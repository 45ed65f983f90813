"""Faults of a recording as data, and texts for each kind of fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

from anisomap.base.immutable import Value
from anisomap.base.wording import join_items


@dataclass(frozen=True, eq=False)
class Finding(Value):
    """A fault of the read-out or of the stimulation that impairs maps.

    Attributes
    ----------
    kind : str
        A key of `CHECKS`, or ``"board-noise"``: common noise of a group of sensors.
    sensors : tuple of str
        Names of the affected sensors.
    size : float
        Size of the fault, in `unit`.
    values : mapping
        Further measured quantities, by name.
    mendable : bool
        Whether `repair` mends it.
    """

    kind: str
    sensors: tuple[str, ...]
    size: float
    values: Mapping[str, Any] = field(default_factory=dict)
    mendable: bool = False

    @property
    def what(self) -> str:
        """Description of the fault with its size, without sensors."""
        return _WORDS[self.kind].what(self)

    @property
    def unit(self) -> str:
        """Unit of `size`; ``"share"`` for shares in [0, 1]."""
        return _WORDS[self.kind].unit

    @property
    def consequence(self) -> str:
        """Effect of the fault on a map of the recording."""
        return _WORDS[self.kind].consequence

    @property
    def mended(self) -> str:
        """Description of the repair; empty if `repair` does not mend the fault."""
        return _WORDS[self.kind].mended(self) if self.mendable else ""

    @property
    def record(self) -> dict[str, Any]:
        """All properties as plain values."""
        names = ("kind", "sensors", "size", "unit", "what", "consequence", "mendable", "mended")
        return {name: getattr(self, name) for name in names}

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        listed = f"; sensors: {join_items(self.sensors, 5)}" if self.sensors else ""
        return f"{self.what} ({self.consequence}){listed}"


def spoiling(findings: Sequence[Finding]) -> tuple[str, ...]:
    """List descriptions of the faults of a recording that impair its map."""
    return tuple(
        f"{finding}" + ("; repair the recording" if finding.mendable else "")
        for finding in findings
    )


class _Words(NamedTuple):
    """See `Finding`."""

    unit: str
    what: Callable[[Finding], str]
    consequence: str
    mended: Callable[[Finding], str] = lambda _: ""


def _of_all(finding: Finding) -> str:
    return f"{len(finding.sensors)} of {finding.values['n_sensors']} sensors"


def _copies(finding: Finding) -> str:
    noise = finding.values["noise"]
    own = f", apart from up to {noise:.1%} of noise" if noise else ""
    return f"{len(finding.sensors)} sensors have the same readings{own}, as if on one wire"


def _left_out(finding: Finding) -> str:
    kept = finding.values["kept"]
    others = join_items([name for name in finding.sensors if name != kept])
    if kept is None:
        return f"all were left out, because it is unknown which of {others} is correct"
    return f"{kept} was kept; {others} were left out, because their positions are unknown"


def _hum(finding: Finding) -> str:
    period, rate = finding.values["period"], finding.values["rate_hz"]
    hertz = "" if rate is None else f" ({rate / period:.3g} Hz)"
    return (
        f"a hum with a period of {period:.4g} frames{hertz} makes up {finding.size:.0%} of the "
        f"standard deviation of {len(finding.sensors)} sensors"
    )


def _regions(finding: Finding) -> str:
    (one, other), frame = finding.values["sizes"], finding.values["frame"]
    return (
        f"two regions of {one} and {other} sensors were touched one after the other, "
        f"the second from frame {frame} on; sensors that were touched together with both "
        f"regions: {round(finding.size)}"
    )


_ALIKE = "it makes distant sensors look similar"
_NOISE = "common noise makes up {1:.0%} of the standard deviation of {0}"

_WORDS: Mapping[str, _Words] = MappingProxyType(
    {
        "gaps": _Words(
            "share",
            lambda f: f"{f.size:.0%} of the readings of {_of_all(f)} are missing",
            "contacts in the gaps are lost, so these sensors seem less similar to their neighbours",
            lambda _: "these readings were estimated from similar sensors, or interpolated",
        ),
        "frozen": _Words(
            "share of the frames",
            lambda f: (
                f"the readings of {_of_all(f)} repeat the previous frame in {f.size:.0%} of all "
                "frames"
            ),
            "contacts in these frames are lost, and the contacts before them count too often",
            lambda _: "these frames were left out",
        ),
        "hum": _Words(
            "share of the standard deviation",
            _hum,
            _ALIKE,
            lambda _: "a fitted sine was subtracted from each sensor",
        ),
        "common-noise": _Words(
            "share of the standard deviation",
            lambda f: _NOISE.format("all sensors", f.size),
            _ALIKE,
        ),
        "board-noise": _Words(
            "share of the standard deviation",
            lambda f: _NOISE.format(f"a group of {len(f.sensors)} sensors", f.size),
            _ALIKE,
            lambda _: "the common signal was estimated in each frame and subtracted",
        ),
        "spikes": _Words(
            "share of the frames",
            lambda f: (
                f"the readings of a group of {len(f.sensors)} sensors jump by "
                f"{f.values['height']:.3g} and back in {f.size:.2%} of the frames"
            ),
            _ALIKE,
        ),
        "steps": _Words(
            "share of the sensors",
            lambda f: (
                f"the level at rest of {_of_all(f)} jumps at frames "
                f"{join_items(f.values['frames'], 5)}"
            ),
            "sensors that jump together look related, and contacts are hidden",
        ),
        "saturation": _Words(
            "share of the frames",
            lambda f: (
                f"readings of {_of_all(f)} are at the limit of the range in {f.size:.1%} of the "
                "frames (median)"
            ),
            "differences between strong contacts are lost",
        ),
        "inverted": _Words(
            "share",
            lambda f: f"contacts have the opposite sign in {_of_all(f)}",
            "these sensors look unrelated to their neighbours",
            lambda _: "these sensors were mirrored at their rest value",
        ),
        "leak": _Words(
            "share",
            lambda f: (
                f"about {f.size:.1%} of each channel leaks into the next channel "
                f"({f.values['n_forward']} of {f.values['n_pairs']} pairs)"
            ),
            "consecutive channels look like neighbours",
        ),
        "copies": _Words(
            "sensors",
            _copies,
            "at most one of these sensors is real; the copies distort the map around it",
            _left_out,
        ),
        "changed": _Words(
            "share",
            lambda f: (
                f"the neighbours of {len(f.sensors)} sensors change at about frame "
                f"{f.values['frame']} of {f.values['n_frames']}"
            ),
            "wires were exchanged, or the posture changed; map the frames before and after "
            "separately",
        ),
        "separate-regions": _Words(
            "sensors touched with both",
            _regions,
            "the relative position of the regions is unknown; touch the skin between them",
        ),
    }
)
