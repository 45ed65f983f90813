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

import anisomap
from anisomap import io
from anisomap.base.defaults import PERMUTATIONS
from anisomap.base.wording import printable
from anisomap.cli import parameters as options
from anisomap.cli.console import Printer, print_warning, progress
from anisomap.errors import FileError, InputError
from anisomap.files.paths import atomic_write, check_distinct, check_target, together

if TYPE_CHECKING:
    from anisomap.evaluation.compare import Comparison

_FACTS = ("recording", "sensors x frames", "map", "scored")
_LEGEND = (
    "Each cell holds Mantel r and, in brackets, the RMS error in spacings of neighbouring sensors. "
    "All methods of a row are scored on the same sensors. Bold marks the best method of anisomap "
    "and the best stock method."
)


def to_markdown(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as a Markdown table, followed by its losses."""
    from anisomap.evaluation.rivals import RIVALS

    methods = [s.method for s in comparisons[0].scores]
    lines = [[*_FACTS, *methods], ["---"] * (len(_FACTS) + len(methods))]
    for comparison in comparisons:
        best = [comparison.best(stock=stock) for stock in (False, True)]
        name = escape(printable(comparison.name), quote=False).replace("|", "\\|")
        cells = [name, *_facts(comparison)]
        for s in comparison.scores:
            cell = (
                f"{_number(s.mantel_r, '.3f')} ({s.rms_in_spacings:.2f})" if not s.reason else "-"
            )
            cells.append(f"**{cell}**" if s in best else cell)
        lines.append(cells)
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
    from anisomap.io.parsing.tables import guard_formula

    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns([s.method for s in comparisons[0].scores]))
    for comparison in comparisons:
        stock = comparison.best(stock=True)
        table.writerow(
            [
                guard_formula(printable(comparison.name)),
                *_facts(comparison),
                *(_number(s.mantel_r) for s in comparison.scores),
                *(_number(s.rms_in_spacings) for s in comparison.scores),
                *((stock.method, _number(stock.mantel_r)) if stock else "--"),
                _number(comparison.margin, "+.3f"),
            ]
        )
    return text.getvalue()


def sentences(comparisons: Sequence[Comparison]) -> list[str]:
    """Say on which recordings a stock method is better, and which methods have no score and why."""
    said = []
    losses, judged = [], 0
    reasons: dict[tuple[str, str], list[str]] = {}
    own = ""
    for comparison in comparisons:
        title = f"{printable(comparison.name)} in {comparison.dimensions}D"
        if not math.isnan(comparison.margin):
            judged += 1
            first, stock = comparison.judged, comparison.best(stock=True)
            r = math.nan if first is None else first.mantel_r
            own = own or (first.method if first else "")
            if round(comparison.margin, 3) < 0 and stock:
                reached = "no map" if math.isnan(r) else f"{r:.3f}"
                against = f"{stock.mantel_r:.3f} of {stock.method}"
                losses.append(f"{title} ({reached} against {against})")
        for s in comparison.scores:
            if s.reason:
                reasons.setdefault((s.method, s.reason), []).append(title)
    if judged:
        named = f": {', '.join(losses)}" if losses else ""
        count = f"{len(losses)} of {judged} maps"
        said.append(f"A stock method is better than {own} on {count}{named}.")
    for (method, reason), names in reasons.items():
        everywhere = "" if len(names) == len(comparisons) else f" on {', '.join(names)}"
        said.append(f"No score of {method}{everywhere}: {printable(reason)}.")
    return said


def _number(value: float, form: str = ".4f") -> str:
    return "-" if math.isnan(value) else f"{value:{form}}"


_WRITERS = {".md": to_markdown, ".csv": to_csv}


def compare(
    recordings: Annotated[
        list[Path],
        Parameter(
            name="RECORDING",
            help="Recordings with known positions, or folders of such recordings as NPZ files.",
        ),
        options.existing,
    ],
    /,
    *,
    method: Annotated[list[str] | None, Parameter(alias="-m", group=options.method_group)] = None,
    dimensions: Annotated[
        list[int] | None,
        Parameter(alias="-d", group=options.method_group, validator=Number(gte=1)),
    ] = None,
    seed: options.Seed = 0,
    output: options.Output = None,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Score several methods on recordings with known positions.

    The scores are Mantel r and the RMS error in sensor spacings. All methods of a recording are
    scored on the same sensors: those in the largest component of every map that differ from their
    median reading in at least 5 frames.

    Parameters
    ----------
    method
        Method to compare; may be repeated. Default: the default method, the paper's four,
        and the stock methods isomap-on-r, umap-on-r (extra 'umap'), tsne-on-r, pca-on-r and
        laplacian-on-r.
    dimensions
        Number of coordinates; may be repeated. Default: as many as the true positions span.
    output
        Table in Markdown (.md) or CSV (.csv); may be repeated.

    Examples
    --------
    anisomap compare run1.npz run2.npz
    anisomap compare recordings/ -o table.md -o table.csv
    anisomap compare run1.npz -m covariogram -m isomap-on-r -d 2
    """
    from anisomap.evaluation.compare import COMPARED, compare_methods
    from anisomap.evaluation.rivals import check_methods

    check_methods(method or ())
    outputs = output or []
    for path in outputs:
        check_target(path)
        if path.suffix.lower() not in _WRITERS:
            raise FileError(
                f"cannot write {path}: give a name that ends in {' or '.join(_WRITERS)}"
            )
    files = _files(recordings)
    check_distinct(outputs, [file for file, _ in files])
    comparisons = []
    for path, recording in _read(files):
        for k in dimensions or (None,):
            with progress(f"mapping {path.name}") as report_progress:
                found = compare_methods(
                    recording,
                    method or COMPARED,
                    k,
                    name=path.name.split(".")[0],
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
    _print_scores(printer, comparisons)


def _print_scores(printer: Printer, comparisons: Sequence[Comparison]) -> None:
    titles = [*_FACTS, "method", "Mantel r", "spacings"]
    rows = [
        (
            c.name,
            *_facts(c),
            s.method,
            _number(s.mantel_r, ".3f"),
            _number(s.rms_in_spacings, ".2f"),
        )
        for c in comparisons
        for s in c.scores
    ]
    printer.table("Scores", titles, rows)
    for sentence in sentences(comparisons):
        printer.say(sentence)
    printer.record(scores=[_values(comparison) for comparison in comparisons])


def _files(given: Sequence[Path]) -> list[tuple[Path, bool]]:
    """List files, and whether each was found in a folder that was given.

    A folder without NPZ files is passed on: it may be a recording, such as a session of YARP.
    """
    folders = {path: sorted(path.glob("*.npz")) for path in given if path.is_dir()}
    return [
        (file, bool(folders.get(path))) for path in given for file in folders.get(path) or [path]
    ]


def _read(files: Sequence[tuple[Path, bool]]) -> Iterator[tuple[Path, anisomap.Recording]]:
    """Read recordings with positions; others are skipped in folders, and errors elsewhere."""
    from anisomap import route

    for path, in_folder in files:
        try:
            with progress(f"reading {path.name}") as report_progress:
                found = route.read_runs([path], io.ReadOptions(), progress=report_progress)
            (recording,) = route.complete(found, "error")
        except InputError as error:
            recording, problem = None, error
        else:
            problem = InputError(
                f"{path} contains no true positions; compare requires recordings with positions"
            )
        if recording is not None and recording.positions is not None:
            yield path, recording
        elif in_folder:
            print_warning(f"skipped: {problem}")
        else:
            raise problem


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
    units: options.Units = None,
    exclude: options.Exclude = None,
    report: options.Report = None,
    picture: options.Picture = None,
    permutations: options.Permutations = PERMUTATIONS,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Score a map against known positions, and name the worst sensors.

    Sensors are matched by name, or by order if no name is shared.

    Examples
    --------
    anisomap score skin.map.csv truth.csv
    anisomap score skin.map.csv truth.csv --units mm --report score.html
    anisomap score skin.map.csv layout.csv --exclude s3,c0-c35
    """
    from anisomap import route
    from anisomap.cli.outputs import Outputs, Truth, read_reference

    outputs = Outputs(picture=picture, report=report, inputs=(map_file, reference_file))
    sensor_map, reference = io.read_map(map_file), read_reference(reference_file, units)
    left_out = route.split_names(exclude, sensor_map.names)
    kind = "the map " if reference.method else ""
    title = f"Score of {map_file.name} against {kind}{reference_file.name}"
    scored = Truth(permutations, reference=reference, exclude=left_out)
    printer.files(outputs.write_all(sensor_map, scored.score(printer, sensor_map, title)))
