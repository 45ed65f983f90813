"""``anisomap live``: a map that grows while the skin is touched."""

from __future__ import annotations

import math
import signal
import threading
import time
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Group, Parameter
from cyclopts.validators import Number

import anisomap.live
from anisomap.base.wording import join_items, number, percent
from anisomap.cli import parameters as options
from anisomap.cli.console import Printer, print_warning, progress
from anisomap.errors import InputError
from anisomap.files.paths import together
from anisomap.map_verdict import Verdict

if TYPE_CHECKING:
    from anisomap.live import LiveSession
    from anisomap.live.batches import Source
    from anisomap.live.sources import Advised

_source = Group("Source", sort_key=0)
_page = Group("Page", sort_key=4)

_LINE_S = 1.0  # between two lines of --headless
_POLL_S = 0.2  # between two checks for the end of the session


@Parameter(name="*", group=_page)
@dataclass(frozen=True)
class PageOptions:
    """The page in the browser.

    Parameters
    ----------
    port
        Port of the page; 0 for any free port.
    host
        Address to listen on. By default, only this computer can open the page. With 0.0.0.0, other
        computers can open the page at the printed address, which contains a token.
    browser
        Open the page in a browser.
    headless
        Print lines instead of showing a page. With --json, print JSON objects.
    until
        End when the verdicts on two successive checked maps reach this level.
    duration
        Seconds from the first frame to the end.
    """

    port: Annotated[int, Parameter(validator=Number(gte=0, lte=65535)), options.expert] = 8765
    host: Annotated[str, options.expert] = "127.0.0.1"
    browser: Annotated[bool, Parameter(negative="--no-browser"), options.expert] = True
    headless: bool = False
    until: Annotated[options.Quality | None, options.expert] = None
    duration: Annotated[float | None, Parameter(name="--for", validator=Number(gt=0))] = None


def live(
    source: Annotated[
        str | None,
        Parameter(
            help="A recording to replay, - for standard input, or an address such as "
            "tcp://HOST:PORT.",
            allow_leading_hyphen=True,
        ),
    ] = None,
    /,
    *,
    simulate: Annotated[str | None, Parameter(group=_source)] = None,
    coached: Annotated[bool, Parameter(group=_source)] = False,
    speed: Annotated[float, Parameter(group=_source, validator=Number(gte=0))] = 1.0,
    seed: options.Seed = 0,
    preset: Annotated[str, options.expert] = "",
    grid: Annotated[str, options.expert] = "",
    recording: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    output: options.Output = None,
    report: options.Report = None,
    spacing: Annotated[str, Parameter(group=options.outputs_group)] = "",
    dimensions: Annotated[
        Literal["auto", 2, 3], Parameter(alias="-d", group=options.method_group)
    ] = "auto",
    drop: options.Drop = None,
    truth: Annotated[Path | None, options.expert] = None,
    page: PageOptions = PageOptions(),
    printer: options.Printing = options.PRINTER,
) -> None:
    """Map a skin while it is touched, and show where to touch next.

    Readings are recorded in a file for `anisomap map`. A page in the browser shows the readings,
    the current map, and how far it can be trusted. Ctrl-C ends the session. The final map is then
    made from all frames, and the page is saved beside the recording.

    Parameters
    ----------
    simulate
        Body that a simulated hand rubs, instead of a source. See `anisomap list bodies`.
    coached
        Let the simulated hand follow the advice of the page.
    speed
        Speed relative to real time. Use 0 for a replay or a simulation without pauses.
    preset
        Robot whose numbering of sensors is known: icub or icub-hand.
    grid
        Rows and columns of a matrix, such as 32x64. Each line is one row, or all rows of a frame.
    recording
        New file for the recording [live-DATE-TIME.csv].
    output
        Map file; its suffix gives the format. May be repeated. Default: the name of the recording
        with .map.csv.
    spacing
        Median distance to the nearest sensor, such as 6.5mm. It gives the written maps a scale.
    dimensions
        2 for flat skins, 3 for curved skins, or auto. Auto chooses for each checked map; quick maps
        use the number that two successive checked maps chose.
    truth
        File of true positions to compare maps with.

    Examples
    --------
    anisomap live tcp://192.168.0.7:5000
    anisomap live --simulate sphere --coached
    anisomap live udp://0.0.0.0:5000 --headless --for 300 -o skin.map.csv
    """
    from anisomap import route
    from anisomap.cli.outputs import Outputs, read_reference
    from anisomap.io.presets import check_preset
    from anisomap.live.page.server import Server
    from anisomap.live.sources import SimulatedHand
    from anisomap.names import find_sensors

    target = _target(recording)
    given = Path(source) if source and Path(source).exists() else None
    maps = output or [target.with_suffix(".map.csv")]
    ending = [] if page.headless else [target.with_suffix(".html")]
    others = [target, *ending]
    Outputs(maps=maps, report=report, others=others, inputs=[given, truth])
    options.PlacingOptions(spacing=spacing).check(maps)
    if preset:
        check_preset(preset)
    chosen = anisomap.live.ExaminationOptions(
        dimensions=dimensions,
        preset=preset,
        drop=tuple(drop or ()),
        truth=None if truth is None else read_reference(truth),
        spacing_mm=_millimetres(spacing),
    )
    opened = _opened(source, simulate, speed, seed, coached=coached, grid=grid)
    if opened.names and not preset:  # otherwise, names are known later
        find_sensors(opened.names, route.split_names(drop, opened.names))
    session = anisomap.live.LiveSession(opened, target, chosen)
    session.page = ending[0] if ending else None
    with _signals() as received, ExitStack() as stack:
        # Errors such as a port in use are reported before recording.
        server = None
        if not page.headless:
            server = stack.enter_context(Server(session, page.host, page.port))
        stack.enter_context(session)
        if isinstance(opened, SimulatedHand) and coached:
            opened.where = partial(_advised, session)
        if server is not None:
            printer.line(f"Open {server.url} in a browser; Ctrl-C ends the session.")
            printer.event({"url": server.url})
            if page.browser:
                webbrowser.open(server.url)
        _run(session, page, printer, received)
        _finish(session, printer, maps, report, spacing, received=received)
        if server is not None and session.page is not None and session.page.exists():
            server.keep(session.page)
        if page.browser and session.page is not None and session.page.exists():
            webbrowser.open(session.page.absolute().as_uri())
    if session.failure is not None:
        raise session.failure


def _target(recording: Path | None) -> Path:
    """Return the file for the recording, which must be new."""
    target = recording or Path(time.strftime("live-%Y%m%d-%H%M%S.csv"))
    if target.suffix.lower() != ".csv":
        raise InputError(f"the recording is written as CSV: {target} must end in .csv")
    if target.exists():
        raise InputError(
            f"{target} exists: record to another file, and map both together, as in anisomap map "
            f"{target} NEW.csv"
        )
    return target


def _millimetres(spacing: str) -> float:
    from anisomap.base import METRES
    from anisomap.placement import parse_length

    value, unit = parse_length(spacing) if spacing else (0.0, "mm")
    return 1e3 * value * METRES[unit]


def _opened(
    source: str | None, simulate: str | None, speed: float, seed: int, *, coached: bool, grid: str
) -> Source:
    if (source is None) == (simulate is None):
        raise InputError("give either a source or --simulate BODY")
    if coached and simulate is None:
        raise InputError("--coached is for a simulated hand; use it with --simulate BODY")
    if simulate is not None:
        from anisomap.cli.commands.simulation import read_body
        from anisomap.live.sources import SimulatedHand

        return SimulatedHand(read_body(simulate), seed, speed)
    size = options.rows_and_columns(grid) if grid else None
    return anisomap.live.open_source(str(source), speed=speed, grid=size)


def _advised(session: LiveSession) -> Advised:
    """Return the sensors that the coach asks to touch, and touched sensors, as 0 and 1."""
    quick = session.maps.quick
    if quick is None:
        return (), None
    return quick.advice.next_sensors, np.minimum(quick.contacts, 1)


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Yield a list to which received signals are added; the first ends the session."""
    received: list[int] = []
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    before = {n: handler for n, handler in before.items() if handler is not signal.SIG_IGN}
    for each in before:
        signal.signal(each, lambda number, _: received.append(number))
    try:
        yield received
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _run(
    session: LiveSession, page: PageOptions, printer: Printer, received: Sequence[int]
) -> None:
    """Wait for the end of the session; without a page, print its state each second and finally."""
    until = "" if page.until is None else page.until.replace("-", " ")
    told, next_line, ended = 0.0, time.monotonic() + _LINE_S, False
    while not ended:
        ended = session.ended.wait(_POLL_S) or bool(received) or session.wanted_end.is_set()
        ended |= bool(until) and session.maps.reached(until)
        ended |= time.monotonic() >= session.first_frame_at + (page.duration or math.inf)
        if page.headless and (ended or time.monotonic() >= next_line):
            next_line = time.monotonic() + _LINE_S
            for note in list(session.notices):
                if note.seconds > told:
                    printer.say(f"  {number(note.seconds, 3)} s: {note.text}")
                    told = note.seconds
            facts = _facts(session)
            printer.event(facts)
            printer.say(_in_words(facts, session.maps.spacing))
    if received:
        printer.line("ending the session; press Ctrl-C again to leave out the final map")


def _facts(session: LiveSession) -> dict[str, Any]:
    checked = session.maps.checked
    verdict = Verdict() if checked is None else checked.verdict
    return {
        "seconds": round(session.seconds, 2),
        "frames": session.recorder.n_frames,
        "sensors": session.maps.n_sensors,
        "share_touched": None if session.maps.quick is None else session.maps.share_touched,
        "map_age": session.map_age,
        "lags": session.lags,
        "verdict": asdict(verdict),
        "error_against_truth": None if checked is None else checked.error_against_truth,
        "faulty": {sensor.name: sensor.status for sensor in session.maps.faults},
        "advice": session.guidance[0],
        "notices": [note.text for note in session.notices],
    }


def _in_words(facts: dict[str, Any], spacing: tuple[float, str]) -> str:
    if not facts["frames"]:
        return f"{facts['seconds']:.0f} s, no frame yet"
    parts = [
        f"{facts['seconds']:.0f} s",
        f"{facts['frames']} frames",
        "no map yet"
        if facts["share_touched"] is None
        else f"{percent(facts['share_touched'])} of {facts['sensors']} sensors touched, map "
        f"{facts['map_age']:.1f} s old{', lags' if facts['lags'] else ''}",
        f"verdict: {Verdict(**facts['verdict']).headline(*spacing)}",
    ]
    if facts["faulty"]:
        parts.append("faulty: " + ", ".join(f"{n} ({s})" for n, s in facts["faulty"].items()))
    return "; ".join([", ".join(parts), *([facts["advice"]] if facts["advice"] else [])])


def _finish(
    session: LiveSession,
    printer: Printer,
    maps: list[Path],
    report: Path | None,
    spacing: str,
    *,
    received: Sequence[int],
) -> None:
    """Make the final map, write all files, and print their names."""
    from anisomap.placement.placing import headline

    with progress("making the final map"):
        final = session.finish(lambda: len(received) > 1)
    written = [("recording", segment.path) for segment in session.recorder.segments]
    if final is not None and final.sensor_map is not None:
        with progress("writing"), together():
            written += [("map", session.save(path, spacing)) for path in maps]
            if report:
                written.append(("report", session.save_report(report)))
        shown = options.PlacingOptions(spacing=spacing).applied(final.sensor_map)
        printer.say(f"Final map of {final.n_frames} frames: {headline(shown)}")
    elif final is not None:
        print_warning(f"there is no map: {final.verdict.reasons[0]}")
    elif written:
        print_warning("the final map was not made; the recording is complete")
    else:
        print_warning("no frame arrived, so nothing was recorded")
    if session.maps.unknown:
        print_warning(f"there is no sensor {join_items(session.maps.unknown)} to leave out")
    if session.page is not None and written:
        from anisomap.live.page import save_page

        links = [path for _, path in written]
        written.append(("page", save_page(session, session.page, links)))
    printer.record(
        **_facts(session), files=[], final=final is not None and final.sensor_map is not None
    )
    printer.files(written)
    if written:
        printer.line(f"\nMake the map again:\n  {session.command}")
