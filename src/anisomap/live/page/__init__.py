"""The page of a session in the browser: its contents as plain data, and actions of its buttons.

At the end, the page is written as one file that does not require a session: see `save_page`.
"""

from __future__ import annotations

import base64
import html
import json
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import number
from anisomap.errors import InputError
from anisomap.evaluation import median_spacing
from anisomap.files.paths import atomic_write, together
from anisomap.live.quick_map import QuickMap, turned_onto
from anisomap.live.session import LiveSession
from anisomap.map_verdict import Verdict
from anisomap.numerics.neighbours import padded
from anisomap.numerics.procrustes import fit_similarity
from anisomap.sensor_map import SensorMap

STATIC = Path(__file__).parent / "static"
"""Source files of the page."""

_MODULES = ("charts.js", "map_view.js", "live.js")  # in the order of their imports
_BETWEEN_MODULES = re.compile(r"^(?:import .*$|export )", re.MULTILINE)
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


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


def _save(session: LiveSession, _: Mapping[str, Any]) -> Done:
    """Write the checked map and a report beside the recording."""
    if session.segment is None:
        raise InputError("nothing is recorded yet")
    recording = session.segment.path
    with together():
        made = session.save(recording.with_suffix(".map.csv"))
        report = session.save_report(recording.with_suffix(".report.html"))
    return Done(f"written: {made.name}, {report.name}", (made, report))


def _end(session: LiveSession, _: Mapping[str, Any]) -> Done:
    session.wanted_end.set()
    return Done("ending the session: the final map follows")


ACTIONS: Mapping[str, Callable[[LiveSession, Mapping[str, Any]], Done]] = MappingProxyType(
    {"pause": _pause, "restart": _restart, "drop": _drop, "save": _save, "end": _end}
)
"""Actions by name."""


_DIGITS = 3  # of seconds and errors


def readings_snapshot(session: LiveSession) -> dict[str, Any]:
    """Return values that change with every frame: counts, and the readings from 0 to 255."""
    is_open = session.state == "running"  # otherwise, current readings are unknown
    return {
        "frames": session.recorder.n_frames,
        "seconds": round(session.seconds, _DIGITS),
        "levels": _encoded(np.round(255 * session.levels[: None if is_open else 0]), "u1"),
    }


def map_snapshot(session: LiveSession) -> dict[str, Any] | None:
    """Return the quick map, and the checked map aligned with it; None before the first map."""
    quick, checked = session.maps.quick, session.maps.checked
    if quick is None:
        return None
    made = None if checked is None else checked.sensor_map
    final = checked is not None and checked.final
    positions, truth = _checked_positions(made, quick), session.maps.options.truth
    stated = None if truth is None else _aligned(_in_order(truth, truth.positions, quick), quick)
    return {
        "names": list(quick.names),
        "dimensions": quick.positions.shape[1],
        "frames": quick.n_frames,
        "positions": _encoded(quick.positions),
        "checked": _encoded(positions),
        "checked_dimensions": None if positions is None else positions.shape[1],
        "checked_halo": _encoded(_checked_doubt(made, quick)),
        "final": final,
        "stated": _encoded(stated),
        "pairs": _encoded(quick.pairs, "<u4"),
        "halo": _encoded(_doubt(quick)),
        "contacts": quick.contacts.tolist(),
        "left_out": list(quick.left_out),
        "untouched": list(quick.advice.untouched),
        "places": [] if final else [list(place.sensors) for place in quick.advice.places],
        "reason": quick.reason,
    }


def status_snapshot(session: LiveSession) -> dict[str, Any]:
    """Return all other contents: verdict, curves, faults, advice, notices and files."""
    maps, checked = session.maps, session.maps.checked
    verdict = Verdict() if checked is None else checked.verdict
    error = math.nan if checked is None else checked.error_against_truth
    has_truth = math.isfinite(error)
    spacing, unit = maps.spacing
    from_truth = [f"{number(error * spacing, 2)} {unit} from the truth"] if has_truth else []
    waits = "checking the first map" if maps.examining else "no map yet"
    advice, enough = session.guidance
    return {
        "state": session.state,
        "source": session.source.description,
        "seconds": round(session.seconds, _DIGITS),
        "frames": session.recorder.n_frames,
        "sensors": session.maps.n_sensors,
        "rate_hz": _finite(session.rate_hz),
        "share_touched": session.maps.share_touched,
        "map_age": round(session.map_age, _DIGITS),
        "lags": session.lags,
        "level": verdict.level,
        "told": waits if checked is None else verdict.level,
        "error": "; ".join(filter(None, [maps.error_told, *from_truth])),
        "reason": maps.reason,
        "has_truth": has_truth,
        "spacing": spacing,
        "unit": unit,
        "advice": advice,
        "enough": enough,
        "faulty": [
            {"name": sensor.name, "status": sensor.status, "reason": sensor.reason}
            for sensor in session.maps.faults
        ],
        "dropped": list(maps.dropped),
        "curve": [
            [round(seconds, _DIGITS), *(_finite(error * spacing) for error in errors)]
            for seconds, *errors in session.maps.curve
        ],
        "touched": [
            [round(seconds, 1), round(share, _DIGITS)] for seconds, share in session.maps.touched
        ],
        "checked_frames": 0 if checked is None else checked.n_frames,
        "examining": session.maps.examining,
        "gaps": [round(seconds, 1) for seconds in session.gaps],
        "notices": [[round(note.seconds, 1), note.text] for note in list(session.notices)],
        "page": "" if session.page is None else str(session.page),
        "recording": "" if session.segment is None else str(session.segment.path),
    }


def save_page(session: LiveSession, path: Path, files: Sequence[Path]) -> Path:
    """Write the final page: one file, with the final map and links to files."""
    places = [Path(os.path.relpath(file, path.parent)).as_posix() for file in files]
    links = [
        {"name": file.name, "url": quote(place, errors="surrogateescape")}
        for file, place in zip(files, places, strict=True)
    ]
    shown = {"map": map_snapshot(session), "status": status_snapshot(session), "files": links}
    data = json.dumps(shown, allow_nan=False).replace("<", "\\u003c")
    style, *modules = (
        (STATIC / name).read_text(encoding="utf-8") for name in ("live.css", *_MODULES)
    )
    script = "\n".join(_BETWEEN_MODULES.sub("", module) for module in modules)
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{html.escape(_POLICY)}">\n'
        f"<style>\n{style}</style>\n"
        f'<script id="end-of-session" type="application/json">{data}</script>\n'
        f'<script type="module">\n{script}</script>\n'
    )
    text = (STATIC / "index.html").read_text(encoding="utf-8")
    before, _, rest = text.partition('<link rel="stylesheet"')
    with atomic_write(path) as temporary:
        temporary.write_text(before + head + rest[rest.index("</head>") :], encoding="utf-8")
    return path


def _in_order(made: SensorMap, values: NDArray[np.float64], quick: QuickMap) -> NDArray[np.float64]:
    """Return values of the largest component in the order of the quick map; NaN for others."""
    own = {made.names[i]: values[i] for i in np.flatnonzero(made.component == 0)}
    unknown = np.full(values.shape[1:], np.nan)
    return np.array([own.get(name, unknown) for name in quick.names])


def _checked_positions(made: SensorMap | None, quick: QuickMap) -> NDArray[np.float64] | None:
    """Return the checked map in the frame of the quick map, matched by names of sensors."""
    if made is None:
        return None
    found = _in_order(made, made.positions, quick)
    placed = np.isfinite(found).all(axis=1)
    if found.shape[1] != quick.positions.shape[1]:
        return turned_onto(found, None) if placed.any() else None
    return _aligned(found, quick)


def _aligned(found: NDArray[np.float64], quick: QuickMap) -> NDArray[np.float64] | None:
    """Align positions with a quick map, in its dimensions; None for too few sensors."""
    shared = np.isfinite(found).all(axis=1) & np.isfinite(quick.positions).all(axis=1)
    width = max(found.shape[1], quick.positions.shape[1])
    if np.count_nonzero(shared) <= width:
        return None
    places, points = padded(found, width), padded(quick.positions, width)
    turned = fit_similarity(places[shared], points[shared]).apply(places)
    return np.asarray(turned[:, : quick.positions.shape[1]])


def _doubt(quick: QuickMap) -> NDArray[np.float64]:
    """Return the uncertainty of each sensor, from 0 to 1 for a sensor without a contact."""
    # The standard error of a mean over n independent contacts is proportional to n^(-1/2).
    return np.asarray(1 / np.sqrt(1.0 + quick.contacts))


def _checked_doubt(made: SensorMap | None, quick: QuickMap) -> NDArray[np.float64]:
    """Return the standard deviation of each sensor of the checked map in spacings, at most 1."""
    doubt = _doubt(quick)
    if made is None or made.covariances is None or np.count_nonzero(made.component == 0) < 2:
        return doubt
    spacing = median_spacing(made.positions[made.component == 0])
    spread = np.sqrt(np.trace(made.covariances, axis1=1, axis2=2)) / (spacing or 1.0)
    found = _in_order(made, spread, quick)
    return np.where(np.isfinite(found), np.minimum(found, 1.0), doubt)


def _encoded(array: NDArray[Any] | None, kind: str = "<f4") -> str | None:
    if array is None:
        return None
    return base64.b64encode(np.ascontiguousarray(array, kind).tobytes()).decode("ascii")


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
