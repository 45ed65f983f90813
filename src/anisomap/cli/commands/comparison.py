"""``anisomap compare`` and ``score``: methods and maps against known positions."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import parameters as options
from anisomap.cli.console import print_warning, progress
from anisomap.defaults import MIN_TOUCHES, PERMUTATIONS
from anisomap.errors import FileError, InputError
from anisomap.files import atomic_write, check_distinct, check_target, together
from anisomap.wording import printable

if TYPE_CHECKING:
    from anisomap.comparison import Comparison, MethodScore
    from anisomap.recording import Recording

_FACTS = ("recording", "sensors x frames", "map", "scored")
_LEGEND = (
    "Each cell holds Mantel r and, in brackets, the RMS error in spacings of neighbouring sensors. "
    "All methods of a row are scored on the same sensors. Bold marks the best method of anisomap "
    "and the best stock method."
)


def to_markdown(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as a Markdown table, followed by its losses."""
    from anisomap.comparison import RIVALS

    methods = [s.method for s in comparisons[0].scores]
    lines = [[*_FACTS, *methods]]
    lines.append(["---"] * len(lines[0]))
    for comparison in comparisons:
        best = [comparison.best(stock=stock) for stock in (False, True)]
        lines.append(
            [
                escape(printable(comparison.name), quote=False).replace("|", "\\|"),
                *_facts(comparison),
                *(
                    f"**{_cell(s)}**" if any(s is one for one in best) else _cell(s)
                    for s in comparison.scores
                ),
            ]
        )
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    stock = "; ".join(f"{m}: {RIVALS[m].summary}" for m in methods if m in RIVALS)
    said = [*sentences(comparisons), *([f"Stock methods: {stock}."] if stock else [])]
    return "\n\n".join([table, _LEGEND, *(escape(text, quote=False) for text in said)]) + "\n"


def _facts(comparison: Comparison) -> tuple[str, str, str]:
    """Describe a row of a table: its values below `_FACTS`, after the name."""
    size = f"{comparison.n_sensors} x {comparison.n_frames}"
    return size, f"{comparison.dimensions}D", str(len(comparison.sensors))


def columns(methods: Sequence[str]) -> list[str]:
    """Return the columns of `to_csv`."""
    errors = [f"{method}: error" for method in methods]
    return [*_FACTS, *methods, *errors, "best stock", "best stock r", "margin"]


def to_csv(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as CSV, one line per recording.

    The columns are named after the methods (Mantel r), after the methods with ``: error`` (RMS
    error in spacings), and ``best stock``, ``best stock r`` and ``margin``: Mantel r of the first
    method of anisomap minus that of the best stock method.
    """
    from anisomap.io.parsing.delimited import guard_formula

    methods = [s.method for s in comparisons[0].scores]
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns(methods))
    for comparison in comparisons:
        stock = comparison.best(stock=True)
        table.writerow(
            [
                guard_formula(printable(comparison.name)),
                *_facts(comparison),
                *(_number(s.mantel_r) for s in comparison.scores),
                *(_number(s.rms_in_spacings) for s in comparison.scores),
                stock.method if stock else "-",
                _number(stock.mantel_r if stock else math.nan),
                _margin(comparison.margin),
            ]
        )
    return text.getvalue()


def sentences(comparisons: Sequence[Comparison]) -> list[str]:
    """Say on which recordings a stock method is better, and which methods have no score and why."""
    said = []
    judged = [c for c in comparisons if not math.isnan(c.margin)]
    if judged:
        own = judged[0].judged.method if judged[0].judged else ""
        losses = [_loss(c) for c in judged if round(c.margin, 3) < 0]
        named = f": {', '.join(losses)}" if losses else ""
        count = f"{len(losses)} of {len(judged)} maps"
        said.append(f"A stock method is better than {own} on {count}{named}.")
    reasons: dict[tuple[str, str], list[str]] = {}
    for comparison in comparisons:
        for s in comparison.scores:
            if s.reason:
                reasons.setdefault((s.method, s.reason), []).append(_title(comparison))
    for (method, reason), names in reasons.items():
        everywhere = "" if len(names) == len(comparisons) else f" on {', '.join(names)}"
        said.append(f"No score of {method}{everywhere}: {printable(reason)}.")
    return said


def _loss(comparison: Comparison) -> str:
    stock = comparison.best(stock=True)
    own = math.nan if comparison.judged is None else comparison.judged.mantel_r
    against = f"{stock.mantel_r:.3f} of {stock.method}" if stock else "-"
    return (
        f"{_title(comparison)} ({'no map' if math.isnan(own) else f'{own:.3f}'} against {against})"
    )


def _title(comparison: Comparison) -> str:
    return f"{printable(comparison.name)} in {comparison.dimensions}D"


def _cell(s: MethodScore) -> str:
    return "-" if math.isnan(s.mantel_r) else f"{s.mantel_r:.3f} ({s.rms_in_spacings:.2f})"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4f}"


def _margin(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:+.3f}"


_WRITERS = {".md": to_markdown, ".csv": to_csv}


def compare(
    recordings: Annotated[
        list[Path],
        Parameter(
            help="Files of recordings with positions, or folders, which stand for the NPZ files in "
            "them."
        ),
        options.existing,
    ],
    /,
    *,
    method: Annotated[options.Words, Parameter(alias="-m", group=options.method_group)] = None,
    dimensions: Annotated[
        list[int] | None,
        Parameter(alias="-d", group=options.method_group, negative=(), validator=Number(gte=1)),
    ] = None,
    min_touches: Annotated[options.Amount, options.expert] = MIN_TOUCHES,
    missing: options.Missing = "error",
    seed: options.Seed = 0,
    reading: options.Reading = options.DEFAULT_READING,
    output: options.Output = None,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Score several methods on recordings with known positions.

    The scores are Mantel r and the RMS error in sensor spacings. All methods of a recording are
    scored on the same sensors: those in the largest component of every map.

    Parameters
    ----------
    method
        Method to compare; may be repeated. Default: the default method, contact-fit, the paper's
        four, and the stock methods isomap-on-r, umap-on-r (extra 'umap'), tsne-on-r, pca-on-r,
        laplacian-on-r, som-on-r and phate-on-r.
    dimensions
        Number of coordinates; may be repeated. Default: as many as the true positions span.
    min_touches
        Leave out sensors that differ from their median reading in fewer frames.
    output
        File for the table, in Markdown (.md) or CSV (.csv); may be repeated.
    """
    from anisomap.comparison import COMPARED, check_methods, compare_methods

    check_methods(method or ())
    outputs = output or []
    for path in outputs:
        check_target(path)
        if path.suffix.lower() not in _WRITERS:
            raise FileError(
                f"cannot write {path}: give a name that ends in {' or '.join(_WRITERS)}"
            )
    check_distinct(outputs, [*(file for file, _ in _files(recordings)), *reading.inputs])
    comparisons = []
    for path, recording in _read(recordings, reading, missing):
        for k in dimensions or (None,):
            with progress(f"mapping {path.name}") as report_progress:
                found = compare_methods(
                    recording,
                    method or COMPARED,
                    k,
                    name=path.name.split(".")[0],
                    min_touches=min_touches,
                    seed=seed,
                    progress=report_progress,
                )
            comparisons.append(found)
    if not comparisons:
        raise InputError(f"no recording with true positions in {recordings[0]}")
    with together():
        for path in outputs:
            with atomic_write(path) as aside:
                text = _WRITERS[path.suffix.lower()](comparisons)
                aside.write_text(text, encoding="utf-8")
    with reporting.printer() as printer:
        columns = [*_FACTS, "method", "Mantel r", "spacings"]
        rows = [row for comparison in comparisons for row in _rows(comparison)]
        printer.table("Scores", columns, rows)
        for sentence in sentences(comparisons):
            printer.line(sentence)
        printer.record(scores=[_values(comparison) for comparison in comparisons])


def _files(given: Sequence[Path]) -> Iterator[tuple[Path, bool]]:
    """List files, and whether each was found in a folder that was given.

    A folder without NPZ files is passed on: it may be a recording, such as a session of YARP.
    """
    for path in given:
        found = sorted(path.glob("*.npz")) if path.is_dir() else []
        yield from ((file, True) for file in found)
        if not found:
            yield path, False


def _read(
    given: Sequence[Path], reading: options.ReadingOptions, missing: options.Missing
) -> Iterator[tuple[Path, Recording]]:
    """Read recordings with positions; others are skipped in folders, and errors elsewhere."""
    for path, in_folder in _files(given):
        try:
            recording = _with_positions(path, reading, missing)
        except InputError as error:
            if not in_folder:
                raise
            print_warning(f"skipped: {error}")
        else:
            yield path, recording


def _with_positions(
    path: Path, reading: options.ReadingOptions, missing: options.Missing
) -> Recording:
    from anisomap.cli import pipeline

    recording = pipeline.complete(pipeline.read(path, reading.checked()), missing)
    if recording.positions is None:
        raise InputError(
            f"{path} contains no true positions; compare requires recordings with positions"
        )
    return recording


def _rows(comparison: Comparison) -> Iterator[tuple[str, ...]]:
    for s in comparison.scores:
        r, error = ("-", "-") if s.reason else (f"{s.mantel_r:.3f}", f"{s.rms_in_spacings:.2f}")
        yield comparison.name, *_facts(comparison), s.method, r, error


def _values(comparison: Comparison) -> dict[str, object]:
    return {
        "recording": comparison.name,
        "sensors": comparison.n_sensors,
        "frames": comparison.n_frames,
        "dimensions": comparison.dimensions,
        "sensors_compared": len(comparison.sensors),
        "mantel_r": {s.method: s.mantel_r for s in comparison.scores},
        "rms_in_spacings": {s.method: s.rms_in_spacings for s in comparison.scores},
        "placed": {s.method: s.n_placed for s in comparison.scores},
        "without_score": {s.method: s.reason for s in comparison.scores if s.reason},
        "margin": comparison.margin,
    }


def score_map(
    map_file: options.MapFile,
    reference_file: Annotated[
        Path,
        Parameter(
            help="File of reference positions: true positions (x, y[, z] and names), a recording "
            "with positions, or another map."
        ),
        options.existing,
    ],
    /,
    *,
    units: str | None = None,
    exclude: options.Exclude = None,
    permutations: options.Permutations = PERMUTATIONS,
    seed: options.Seed = 0,
    picture: options.Picture = None,
    report: options.Report = None,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Score a map against reference positions of its sensors, and name the worst sensors.

    Sensors are matched by name, or by order if no name is shared.

    Parameters
    ----------
    units
        Unit of the reference positions, if the file does not state it.
    """
    from anisomap import io
    from anisomap.cli import pipeline, printing

    outputs = pipeline.Outputs(picture=picture, report=report, inputs=(map_file, reference_file))
    sensor_map, reference = io.read_map(map_file), pipeline.read_reference(reference_file, units)
    left_out = options.sensors(exclude, sensor_map.names)
    with reporting.printer() as printer:
        result = pipeline.score_with_progress(
            sensor_map, reference, permutations, seed, exclude=left_out
        )
        files = pipeline.write_outputs(outputs, sensor_map, result)
        kind = f"the map {reference_file.name}" if reference.method else reference_file.name
        printing.print_score(
            printer, result, sensor_map, f"Score of {map_file.name} against {kind}"
        )
        if files:
            printing.print_files(printer, files)
