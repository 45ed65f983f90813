"""``anisomap compare``: several methods on recordings with known positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import comparison_tables, pipeline
from anisomap.cli import parameters as options
from anisomap.cli.console import print_warning, progress
from anisomap.comparison import COMPARED, MIN_TOUCHES, Comparison, check_methods, compare_methods
from anisomap.errors import FileError, InputError
from anisomap.files import atomic_write, check_distinct, check_target
from anisomap.recording import Recording

_WRITERS = {".md": comparison_tables.to_markdown, ".csv": comparison_tables.to_csv}


def compare(
    recordings: Annotated[
        list[Path],
        Parameter(
            help="Files of recordings with positions, or folders, which stand for the NPZ files in "
            "them."
        ),
    ],
    /,
    *,
    method: Annotated[
        list[str] | None, Parameter(alias="-m", group=options.method_group, negative=())
    ] = None,
    dimensions: Annotated[
        list[int] | None,
        Parameter(alias="-d", group=options.method_group, negative=(), validator=Number(gte=1)),
    ] = None,
    min_touches: Annotated[
        int, Parameter(group=options.method_group, validator=Number(gte=0))
    ] = MIN_TOUCHES,
    missing: options.Missing = "error",
    seed: options.Seed = 0,
    reading: options.Reading = options.DEFAULT_READING,
    output: Annotated[
        list[Path] | None, Parameter(alias="-o", group=options.outputs_group, negative=())
    ] = None,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Score several methods on recordings with known positions.

    The scores are Mantel r and the RMS error in sensor spacings. All methods of a recording are
    scored on the same sensors: those in the largest component of every map.

    Parameters
    ----------
    method
        Method to compare; may be repeated. Default: the default method, contact-fit, the paper's
        four, and the stock methods isomap-on-r, umap-on-r (extra 'umap'), tsne-on-r, pca-on-r and
        laplacian-on-r.
    dimensions
        Number of coordinates; may be repeated. Default: as many as the true positions span.
    min_touches
        Leave out sensors that differ from their median reading in fewer frames.
    output
        File for the table, in Markdown (.md) or CSV (.csv); may be repeated.
    """
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
    for path in outputs:
        with atomic_write(path) as aside:
            text = _WRITERS[path.suffix.lower()](comparisons)
            aside.write_text(text, encoding="utf-8")
    with reporting.printer() as printer:
        printer.table(
            "Scores",
            ("recording", "sensors x frames", "map", "scored", "method", "Mantel r", "spacings"),
            [row for comparison in comparisons for row in _rows(comparison)],
        )
        for sentence in comparison_tables.sentences(comparisons):
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
    recording = pipeline.complete(pipeline.read(path, reading.checked()), missing)
    if recording.positions is None:
        raise InputError(
            f"{path} contains no true positions; compare requires recordings with positions"
        )
    return recording


def _rows(comparison: Comparison) -> Iterator[tuple[str, ...]]:
    size = f"{comparison.n_sensors} x {comparison.n_frames}"
    for s in comparison.scores:
        r, error = ("-", "-") if s.reason else (f"{s.mantel_r:.3f}", f"{s.rms_in_spacings:.2f}")
        scored = str(len(comparison.sensors))
        yield comparison.name, size, f"{comparison.dimensions}D", scored, s.method, r, error


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
