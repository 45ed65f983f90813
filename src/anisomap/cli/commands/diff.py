"""``anisomap diff``: two maps of one skin compared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from anisomap import io
from anisomap.cli import parameters as options
from anisomap.cli import printing
from anisomap.cli.console import MAX_SHOWN, Printer, number
from anisomap.drawing import figures
from anisomap.evaluation import Difference, compare_maps
from anisomap.evaluation.difference import LEVEL
from anisomap.files import check_distinct
from anisomap.sensor_map import UNSCALED
from anisomap.wording import join_items

DIFFERENT = 1
"""Exit code if the maps differ."""


def diff(
    before_file: Annotated[Path, Parameter(help="File of the first map.")],
    after_file: Annotated[Path, Parameter(help="File of the second map.")],
    /,
    *,
    picture: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    level: float = LEVEL,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> int:
    """Compare two maps of one skin: which sensors moved, appeared or were lost.

    The maps may come from two days or two methods, or from before and after a repair. The second
    map is aligned with the first; sensors that moved do not affect the alignment. The exit code is
    0 if no difference is found, and 1 otherwise.

    Parameters
    ----------
    picture
        File for a figure: .png, .svg or .pdf.
    level
        Probability that chance alone marks any sensor as moved.
    """
    if picture:
        check_distinct([picture], [before_file, after_file])
        figures.check_writable(picture)
    before, after = io.read_map(before_file), io.read_map(after_file)
    found = compare_maps(before, after, level=level)
    if picture:
        title = f"{before_file.name} and {after_file.name}"
        figures.save_figure(figures.difference_figure(found, title), picture)
    with reporting.printer() as printer:
        _print(printer, found, f"{after_file.name} compared with {before_file.name}")
        if picture:
            printing.print_files(printer, [("picture", picture)])
    return DIFFERENT if found.found else 0


def _print(printer: Printer, found: Difference, title: str) -> None:
    units = "units of the first map" if found.units in UNSCALED else found.units
    spacing = found.spacing  # 0 if most sensors have the place of another
    counts = {
        "moved": found.moved,
        "appeared": found.appeared,
        "lost": found.lost,
    }
    printer.facts(
        title,
        {
            "sensors compared": str(np.count_nonzero(found.compared)),
            **{kind: str(np.count_nonzero(mask)) for kind, mask in counts.items()},
            "chance": f"explains up to {number(found.chance)} {units}"
            + (f", or {number(found.chance / spacing, 3)} spacings" if spacing else ""),
            "scale": f"{number(found.scale)} (second map to first)",
            "mirrored": "yes" if found.reflected else "no",
        },
    )
    moved = np.flatnonzero(found.moved)
    moved = moved[np.argsort(-found.distance[moved], kind="stable")]
    if moved.size:
        printer.table(
            "Sensors that moved",
            ("sensor", f"distance ({units})", "spacings", "p"),
            [
                (
                    found.names[i],
                    number(found.distance[i]),
                    number(found.distance[i] / spacing if spacing else np.nan, 3),
                    number(found.p_values[i], 2),
                )
                for i in moved
            ],
            max_rows=MAX_SHOWN,
        )
    names = {kind: [found.names[i] for i in np.flatnonzero(m)] for kind, m in counts.items()}
    for kind in ("appeared", "lost"):
        if names[kind]:
            printer.line(f"{kind}: {join_items(names[kind], MAX_SHOWN)}")
    for note in found.notes:
        printer.line(f"  note: {note}")
    printer.record(
        different=found.found,
        sensors_compared=int(np.count_nonzero(found.compared)),
        moved=[
            {
                "sensor": found.names[i],
                "distance": found.distance[i],
                "spacings": found.distance[i] / found.spacing,
                "p_value": found.p_values[i],
                "before": found.before[i],
                "after": found.after[i],
            }
            for i in moved
        ],
        appeared=names["appeared"],
        lost=names["lost"],
        chance=found.chance,
        median_spacing=found.spacing,
        scale=found.scale,
        reflected=found.reflected,
        units=found.units,
        notes=found.notes,
    )
