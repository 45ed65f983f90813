"""``anisomap paper``: every experiment of the paper, made again."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import parameters as options
from anisomap.cli.console import errors, progress
from anisomap.paper import Done, Settings, reproduce
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
    reporting: options.Reporting = options.AS_TEXT,
) -> None:
    """Make every figure and table of the paper again, and a page that walks through them.

    What is finished in the folder is not run again, so a run that was interrupted goes on.

    Parameters
    ----------
    output_dir
        Folder for the results; made if it is not there. Open its index.html.
    quick
        Take far fewer frames, seeds and permutations: to see what there will be.
    seed
        First seed of the runs of each scenario; the same seed gives the same results.
    workers
        Processes; as many as there are cores unless given.
    recordings
        Folder of recordings of real skin (icub_hexagon.npz), which the page tells how to get.
    only
        Experiment to run, with those that it needs; may be repeated. All unless given.
    """
    settings = Settings(seed=seed, quick=quick, recordings=recordings)
    with progress("running the paper's experiments") as show:

        def tell(done: Done, share: float) -> None:
            show(share)
            if done.how == "made":
                errors.print(f"{done.name}: {done.seconds:.1f} s", markup=False)

        found = reproduce(output_dir, settings, only=only or (), workers=workers, tell=tell)
    with reporting.printer() as printer:
        printer.table(
            "Experiments",
            ("name", "seconds", "result"),
            [(done.name, f"{done.seconds:.1f}", done.how) for done in found],
        )
        printer.record(experiments=[asdict(done) for done in found], page=output_dir / PAGE)
        printer.line(f"\nOpen {output_dir / PAGE}")
