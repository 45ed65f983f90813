"""What the buttons of the page do. Each action returns a sentence, and the files it has written."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from anisomap import io
from anisomap.errors import InputError
from anisomap.files import together
from anisomap.live.saving import EXPORTS, save_map, save_report
from anisomap.live.session import LiveSession
from anisomap.placement import Anchors, parse_anchor

_TRUTH_SUFFIXES = (".csv", ".tsv", ".txt", ".json", ".ply", ".pcd", ".urdf", ".xml", ".mjcf")


class Done(NamedTuple):
    """The result of an action: one sentence, and files that were written."""

    text: str
    files: tuple[Path, ...] = ()


def act(session: LiveSession, request: Mapping[str, Any]) -> Done:
    """Carry out a request of the page."""
    name = request.get("do")
    if not isinstance(name, str) or name not in ACTIONS:
        raise InputError(f"an action must be one of {', '.join(ACTIONS)}")
    return ACTIONS[name](session, request)


def _pause(session: LiveSession, request: Mapping[str, Any]) -> Done:
    session.pause(bool(request.get("on")))
    return Done("paused: nothing is recorded" if session.paused else "recording")


def _restart(session: LiveSession, _: Mapping[str, Any]) -> Done:
    session.restart()
    return Done("the next frame begins a new recording")


def _drop(session: LiveSession, request: Mapping[str, Any]) -> Done:
    names = request.get("sensors")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError("sensors must be a list of names")
    session.drop(names)
    return Done(f"left out: {', '.join(names)}" if names else "no sensor is left out")


def _truth(session: LiveSession, request: Mapping[str, Any]) -> Done:
    text, suffix = _text(request, "text"), Path(_text(request, "name")).suffix.lower()
    if suffix not in _TRUTH_SUFFIXES:
        raise InputError(f"a file of positions must be one of {', '.join(_TRUTH_SUFFIXES)}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"positions{suffix}"
        path.write_text(text, encoding="utf-8")
        truth = io.read_map(path)
    session.declare_truth(truth)
    return Done(f"the next checked map is compared with {truth.n_sensors} positions")


def _anchors(session: LiveSession, request: Mapping[str, Any]) -> Done:
    given = [
        parse_anchor(line.strip()) for line in _text(request, "text").split("\n") if line.strip()
    ]
    if not given:
        session.anchors = None
        return Done("there are no anchors: maps have no frame")
    width = max(len(position) for _, position in given)
    rows = [(*position, *(0.0,) * (width - len(position))) for _, position in given]
    anchors = Anchors(tuple(name for name, _ in given), np.array(rows))
    if unknown := [name for name in anchors.names if name not in session.maps.names]:
        raise InputError(f"there is no sensor {unknown[0]}")
    session.anchors = anchors
    return Done(f"saved maps are placed by {len(given)} anchors, in metres")


def _save(session: LiveSession, request: Mapping[str, Any]) -> Done:
    with together():
        made = _written(session, request, ".map.csv")
        report = save_report(session.maps.checked, _recording(session).with_suffix(".report.html"))
    return Done(f"{made.text}, {report.name}", (*made.files, report))


def _export(session: LiveSession, request: Mapping[str, Any]) -> Done:
    suffix = _text(request, "suffix")
    if suffix not in EXPORTS:
        raise InputError(f"a format must be one of {', '.join(EXPORTS)}")
    return _written(session, request, f".map{suffix}")


def _written(session: LiveSession, request: Mapping[str, Any], suffix: str) -> Done:
    """Write the checked map beside the recording."""
    recording = _recording(session)
    path = save_map(
        session.maps.checked,
        recording.with_suffix(suffix),
        recording=recording,
        preset=session.maps.options.preset,
        spacing=str(request.get("spacing") or ""),
        anchors=session.anchors,
    )
    return Done(f"written: {path.name}", (path,))


def _end(session: LiveSession, _: Mapping[str, Any]) -> Done:
    session.wanted_end.set()
    return Done("ending the session: the final map follows")


ACTIONS: Mapping[str, Callable[[LiveSession, Mapping[str, Any]], Done]] = MappingProxyType(
    {
        "pause": _pause,
        "restart": _restart,
        "drop": _drop,
        "truth": _truth,
        "anchors": _anchors,
        "save": _save,
        "export": _export,
        "end": _end,
    }
)
"""Actions by name."""


def _recording(session: LiveSession) -> Path:
    if session.segment is None:
        raise InputError("nothing is recorded yet")
    return session.segment.path


def _text(request: Mapping[str, Any], key: str) -> str:
    value = request.get(key)
    if not isinstance(value, str):
        raise InputError(f"{key} must be text")
    return value
