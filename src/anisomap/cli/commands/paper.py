"""``anisomap paper``: reproduce the experiments of the paper."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import parameters as options
from anisomap.cli.console import errors, progress
from anisomap.paper import Settings, Status, reproduce
from anisomap.paper.runner import PAGE


def paper(
    *,
    output_dir: Annotated[Path, Parameter(name=("--output-dir", "--output", "-o"))] = Path(
        "paper-out"
    ),
    quick: Annotated[bool, Parameter(negative=())] = False,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 1,
    workers: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    recordings: Path | None = None,
    only: Annotated[list[str] | None, Parameter(negative=())] = None,
    reporting: options.Reporting = options.DEFAULT_REPORTING,
) -> None:
    """Reproduce the figures, tables and claims of the paper, with a page of all results.

    Experiments that are already finished in the folder are not repeated, so an interrupted run can
    be continued.

    Parameters
    ----------
    output_dir
        Folder for the results; created if absent. Open its index.html.
    quick
        Use far fewer frames, seeds and permutations, for a preview.
    seed
        First seed of each scenario; the same seed gives the same results.
    workers
        Number of processes; the number of cores by default.
    recordings
        Folder of recordings of real skin (icub_hexagon.npz); the page explains how to get them.
    only
        Experiment to run, after those that it needs; may be repeated. All by default.
    """
    settings = Settings(seed=seed, quick=quick, recordings=recordings)
    with progress("reproducing the paper") as show:

        def report(status: Status, fraction: float) -> None:
            show(fraction)
            if status.state == "computed":
                errors.print(f"{status.name}: {status.seconds:.1f} s", markup=False)

        found = reproduce(output_dir, settings, only=only or (), workers=workers, report=report)
    with reporting.printer() as printer:
        printer.table(
            "Experiments",
            ("name", "seconds", "state"),
            [(status.name, f"{status.seconds:.1f}", status.state) for status in found],
        )
        printer.record(experiments=[asdict(status) for status in found], page=output_dir / PAGE)
        printer.line(f"\nOpen {output_dir / PAGE}")
