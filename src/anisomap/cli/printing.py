"""Output of commands: recordings, faults, maps, verdicts and scores, as text and for JSON."""

from __future__ import annotations

import warnings
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from anisomap import io
from anisomap.base.wording import join_items, number, percent
from anisomap.cli.console import Columns, Printer, attributes, print_warning
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation import Score
from anisomap.health import Finding, RecordingSummary, SensorHealth, TouchCoverage, touch_coverage
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.method.pipeline import reconstruct
from anisomap.placement.placing import errors_in_mm, judgement
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.verdict.chance import MIN_FRAMES

_MAX_SHOWN = 12  # faulty sensors; anisomap info --all shows all


def print_contents(printer: Printer, path: Path, how: io.ReadOptions) -> None:
    """Print the contents of a file that may contain several recordings."""
    contents = io.contents(path, options=how)
    if contents:
        records = [asdict(content) for content in contents]
        columns: Columns = {
            "name": ("name", str),
            "content": ("summary", str),
            "a recording": ("usable", lambda usable: "yes" if usable else "no"),
        }
        printer.rows(f"Contents of {path.name}", columns, records)
        printer.record(contents=records)


def print_recording(printer: Printer, recording: Recording, summary: RecordingSummary) -> None:
    """Print a summary of a recording."""
    known = {"true positions": "unknown" if recording.positions is None else "known"}
    source = {"source": recording.source or "unknown"}
    printer.facts("Recording", source | summary.facts | known)
    values = {name.removeprefix("n_"): value for name, value in asdict(summary).items()}
    printer.record(recording={"source": recording.source, **values})


def doubt_orientation(summary: RecordingSummary, *, judged: bool = False) -> None:
    """Warn of more sensors than frames before mapping: the file may be transposed.

    There is no warning if the transposed table has too few frames for a verdict. judged: Whether a
    verdict is requested. Raises InputError if it is possible for the transposed table only.
    """
    n_frames, n_sensors = summary.n_frames, summary.n_sensors
    if n_sensors < max(n_frames + 1, MIN_FRAMES):
        return
    doubt = (
        f"there are more sensors (columns, {n_sensors}) than frames (rows, {n_frames}): if the "
        "rows of the file are the sensors, transpose it"
    )
    if judged and n_frames < MIN_FRAMES:
        raise InputError(
            f"{doubt}; if not, record the {MIN_FRAMES} frames that a verdict needs, or add "
            "--no-verdict"
        )
    print_warning(doubt)


def print_health(
    printer: Printer, health: Sequence[SensorHealth], *, all_sensors: bool = False
) -> None:
    """Print the health of sensors that are not ok, or of all, and the number of each status."""
    faulty = [sensor for sensor in health if sensor.status != "ok"]
    shown = faulty if all_sensors else faulty[:_MAX_SHOWN]
    healthy = [sensor for sensor in health if sensor.status == "ok"]
    counts = Counter(sensor.status for sensor in health)
    title = "Sensor health: " + ", ".join(f"{n} {status}" for status, n in counts.most_common())
    printer.record(health=[asdict(sensor) for sensor in (health if all_sensors else faulty)])
    rows = [
        (
            sensor.name,
            sensor.status,
            f"{number(sensor.minimum)} .. {number(sensor.maximum)}",
            str(sensor.distinct),
            percent(sensor.active),
            str(sensor.contacts),
            number(sensor.best_match, 2),
        )
        for sensor in (shown + healthy if all_sensors else shown)
    ]
    if not rows:
        printer.facts(title, {})
        return
    columns = ("sensor", "status", "range", "values", "active", "contacts", "best r")
    printer.table(title, columns, rows)
    alike: defaultdict[str, list[str]] = defaultdict(list)
    for sensor in shown:
        alike[sensor.reason].append(sensor.name)
    for reason, names in alike.items():
        printer.say(f"  {join_items(names)}: {reason}")
    if len(faulty) > len(shown):
        printer.line(
            f"  ... and {len(faulty) - len(shown)} more: anisomap info --all lists them all"
        )


def print_findings(
    printer: Printer, findings: Sequence[Finding], *, repaired: bool = False
) -> None:
    """Print the faults of a recording, and their repairs, possible or made."""
    printer.record(findings=[finding.record for finding in findings])
    if not findings:
        return
    printer.line("Faults of the recording" + (", mended where possible" if repaired else ""))
    for finding in findings:
        printer.say(f"  {finding.kind}: {finding}")
        if repaired and finding.mended:
            printer.say(f"    mended: {finding.mended}")
    mendable = sum(finding.mendable for finding in findings)
    if mendable and not repaired:
        printer.line(f"  {mendable} of {len(findings)} can be mended: anisomap map --repair")


def print_map(printer: Printer, sensor_map: SensorMap) -> None:
    """Print the contents of a map, and its fit."""
    n_placed, dimensions = int(np.count_nonzero(sensor_map.placed)), sensor_map.dimensions
    kind, sizes, order = sensor_map.kind, sensor_map.component_sizes, _order(sensor_map)
    placed = f"{n_placed} of {sensor_map.n_sensors}, in {dimensions}D"
    components, means = str(len(sizes)), "0 is a perfect fit of the metric"
    if len(sizes) > 1:
        placed += f", {sizes[0]} of them in the largest component"
        components += f"; {kind}s in each: {join_items(sizes, max_items=12)}"
        means = "within components; small components always fit"
    because = sensor_map.provenance.get("dimensions_because")
    printer.facts(
        f"Map by {sensor_map.method}",
        {
            f"{kind}s placed": placed,
            "dimensions": f"{dimensions}, chosen: {because}" if because else "",
            "order along the line": join_items(order, len(order)),
            "components": components,
            "Stress-1": f"{number(sensor_map.stress)} ({means})",
            "pose": sensor_map.pose,
        },
    )
    if dimensions > 3:
        print_warning(
            f"maps in {dimensions} dimensions can only be written as tables (CSV, JSON, NPZ), and "
            "pictures show three dimensions: for skins, choose 2 (-d 2) or 3 (-d 3)"
        )


def print_verdict(printer: Printer, sensor_map: SensorMap) -> None:
    """Print the verdict on a map, and the reasons."""
    first, *others = judgement(sensor_map)
    printer.facts(first, {})
    for sentence in others:
        printer.say(f"  {sentence}")


def record_map(printer: Printer, sensor_map: SensorMap) -> None:
    """Record a map and its verdict for the JSON object."""
    printer.record(
        map={
            **attributes(sensor_map, "method dimensions"),
            "sensors": sensor_map.n_sensors,
            "placed": int(sensor_map.placed.sum()),
            **({"order": _order(sensor_map)} if sensor_map.dimensions == 1 else {}),
            **attributes(sensor_map, "component_sizes stress units notes provenance"),
        },
        verdict=asdict(sensor_map.verdict) | errors_in_mm(sensor_map),
    )


def _order(sensor_map: SensorMap) -> list[str]:
    """Return the names of the largest component in order along a line; [] if it is not a line."""
    if sensor_map.dimensions > 1:
        return []
    order = np.argsort(sensor_map.positions[:, 0], kind="stable").tolist()
    return [sensor_map.names[i] for i in order if sensor_map.component[i] == 0]


def print_score(printer: Printer, result: Score, sensor_map: SensorMap, title: str) -> None:
    """Print the comparison of a map with reference positions, and name the worst sensors."""
    units = result.units or "units of the reference"
    null, permutations = result.mantel.quantiles(), result.mantel.null.size
    facts = {
        "Mantel r": number(result.mantel.r),
        "null distribution": ", ".join(
            f"{_QUANTILES.get(level, f'{level:.0%}')} {r:.3f}" for level, r in null.items()
        ),
        "p": f"{number(result.mantel.p_value, 3)} ({permutations} permutations)" if null else "",
        "RMS error": f"{number(result.rms)} {units}, or "
        f"{number(result.rms_in_spacings, 3)} spacings of {number(result.spacing)} {units}",
        "median error": f"{number(result.median_error)} {units}",
        "scale": ""
        if np.isnan(result.scale)
        else f"{number(result.scale, 3)} times the reference; "
        f"without scaling, the RMS error is {number(result.rigid_rms)} {units}",
        "mirrored": "yes" if result.alignment.reflected else "no",
        "neighbours kept": percent(result.neighbours_kept),
        "sensors compared": str(result.mantel.n_sensors),
    }
    printer.facts(title, facts)
    printer.notes(result.notes)
    names, errors = sensor_map.names, result.alignment.errors
    partner = {i: names[j] for pair in result.exchanged for i, j in (pair, pair[::-1])}
    worst = [
        {"sensor": names[k], "error": float(errors[i]), "exchanged_with": partner.get(k)}
        for i, k in ((i, int(result.sensors[i])) for i in result.worst())
    ]
    spacing = result.spacing if result.spacing > 0 else np.nan
    columns: Columns = {
        "sensor": ("sensor", str),
        f"error ({units})": ("error", number),
        "spacings": ("error", lambda error: number(error / spacing, 3)),
    }
    if partner:
        columns = {**columns, "": ("exchanged_with", _exchange)}
    printer.rows("Worst sensors", columns, worst)
    printer.record(
        score={
            "mantel_r": result.mantel.r,
            "null_quantiles": {str(level): r for level, r in null.items()},
            "p_value": result.mantel.p_value if null else None,
            "permutations": permutations,
            **attributes(result, "rms rigid_rms scale median_error units rms_in_spacings"),
            "median_spacing": result.spacing,
            "reflected": result.alignment.reflected,
            "neighbours_kept": result.neighbours_kept,
            "sensors_compared": result.mantel.n_sensors,
            "notes": result.notes,
            "worst": worst,
        }
    )


def _exchange(other: str | None) -> str:
    return f"looks exchanged with {other}: run anisomap check" if other else ""


_QUANTILES = {0.0: "min", 0.5: "median", 1.0: "max"}
_MAX_QUICK = 1000  # maximum sensors for a quick map by `anisomap info`, in about a second
_PLACES_TOLD = 3
_QUICK_METHOD = "r-anisomap"  # the fastest method; only neighbours are needed


def coverage_without_map(recording: Recording) -> TouchCoverage | None:
    """Return the coverage by contacts on true positions or a quick map; None without a map."""
    if not recording.touched:
        return None
    if recording.positions is not None:
        return touch_coverage(SensorMap(recording.positions, names=recording.names), recording)
    if recording.n_sensors > _MAX_QUICK:
        return None
    try:
        with warnings.catch_warnings(action="ignore", category=AnisomapWarning):
            complete = recording.complete("interpolate")
            return touch_coverage(reconstruct(complete, _QUICK_METHOD), recording)
    except InputError:  # too few sensors vary
        return None


def touch_facts(coverage: TouchCoverage, names: Sequence[str]) -> dict[str, str]:
    """Return two texts: the contacts of a skin, and the places to touch next."""
    counts = coverage.contacts
    least = names[int(np.argmin(counts))]
    apart = len(coverage.never_together)
    told = [f"median {np.median(counts):g} per sensor, minimum {counts.min()} ({least})"]
    if coverage.untouched.size:
        told.append(f"{coverage.untouched.size} of {len(counts)} untouched")
    if apart:
        told.append(
            f"{apart} of {len(coverage.pairs)} pairs of neighbours were never touched together"
        )
    around = "; ".join(place.in_words(names) for place in coverage.places[:_PLACES_TOLD])
    untouched = join_items([names[i] for i in coverage.untouched[:_PLACES_TOLD].tolist()])
    enough = (
        "nothing left to touch: every pair of neighbours was touched together at least "
        f"{ENOUGH_CONTACTS} times"
    )
    return {
        "contacts": ", ".join(told),
        "touch next": around or (f"the unknown places of {untouched}" if untouched else enough),
    }


def print_touches(printer: Printer, coverage: TouchCoverage | None, names: Sequence[str]) -> None:
    """Print the contacts of a skin, and the places to touch next."""
    if coverage is None:
        return
    printer.facts("Touches", touch_facts(coverage, names))
    printer.record(
        touches={
            "contacts": dict(zip(names, coverage.contacts.tolist(), strict=True)),
            "never_together": [[names[i], names[j]] for i, j in coverage.never_together.tolist()],
            "next": [
                {
                    "sensors": [names[i] for i in place.sensors],
                    "centre": place.centre.tolist(),
                    "need": place.need,
                }
                for place in coverage.places
            ],
        }
    )
