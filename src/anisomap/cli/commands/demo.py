"""``anisomap demo`` and ``paper``: a simulated skin mapped, and the paper reproduced."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import anisomap
from anisomap import io
from anisomap.base.defaults import DEFAULT_METHOD, PERMUTATIONS
from anisomap.cli import parameters as options
from anisomap.cli.console import errors, progress
from anisomap.errors import FileError, import_extra


def demo(
    *,
    output_dir: Annotated[Path, Parameter(alias="-o")] = Path("demo"),
    frames: options.Count = 2000,
    method: Annotated[str, Parameter(alias="-m"), options.expert] = DEFAULT_METHOD,
    permutations: options.Permutations = PERMUTATIONS,
    seed: options.Seed = 0,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Simulate a skin, map it, and score the map.

    A sphere with 60 sensors is bombarded by elastic balls, as in the paper.

    Parameters
    ----------
    output_dir
        Folder for the recording, the map, the figure and the report; created if necessary.
    frames
        Number of frames to simulate, at 20 Hz.
    method
        Reconstruction method: see `anisomap methods`.
    """
    from anisomap import route
    from anisomap.cli import outputs

    import_extra("mujoco", "the demo", "report,simulation")
    try:
        output_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot create the folder {output_dir}: {error.strerror}") from error
    recorded = output_dir / "recording.npz"
    files = outputs.Outputs(
        maps=(output_dir / "map.csv",),
        recording=recorded,
        picture=output_dir / "map.png",
        report=output_dir / "report.html",
    )
    with progress(f"simulating {frames} frames of a bombarded sphere") as report_progress:
        recording = anisomap.simulate(
            "sphere", "bombardment", n_frames=frames, seed=seed, progress=report_progress
        )
    examined = route.examine([recording], progress=progress)
    outputs.print_recording(printer, examined.recording, examined.summary)
    sensor_map, judge = route.make_map(examined, method, dimensions=3, progress=progress)

    def write_recording() -> list[tuple[str, Path]]:
        io.write(recording, recorded)
        return [("recording", recorded)]

    truth = outputs.Truth(permutations, seed)
    outputs.finish(
        printer, files, sensor_map, examined, truth, judge=judge, write_others=write_recording
    )
    printer.line("\nMap the recording from its file:")
    printer.line(f"  anisomap map {recorded} -o map.csv")


def paper(
    *,
    output_dir: Annotated[Path, Parameter(name=("--output-dir", "--output", "-o"))] = Path(
        "paper-out"
    ),
    quick: bool = False,
    first_seed: Annotated[options.Amount, options.expert] = 1,
    workers: options.Count | None = None,
    recordings: Path | None = None,
    only: list[str] | None = None,
    printer: options.Printing = options.PRINTER,
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
    first_seed
        First seed of each scenario; the same seed gives the same results.
    workers
        Number of processes; the number of cores by default.
    recordings
        Folder of recordings of real skin (icub_hexagon.npz); the page explains how to get them.
    only
        Experiment to run, after those that it needs; may be repeated. All by default.
    """
    from anisomap.paper import Settings, Status, reproduce
    from anisomap.paper.runner import PAGE

    settings = Settings(seed=first_seed, quick=quick, recordings=recordings)
    with progress("reproducing the paper") as show:

        def report(status: Status, fraction: float) -> None:
            show(fraction)
            if status.state == "computed":
                errors.print(f"{status.name}: {status.seconds:.1f} s", markup=False)

        found = reproduce(output_dir, settings, only=only or (), workers=workers, report=report)
    printer.table(
        "Experiments",
        ("name", "seconds", "state"),
        [(status.name, f"{status.seconds:.1f}", status.state) for status in found],
    )
    printer.record(experiments=[asdict(status) for status in found], page=output_dir / PAGE)
    printer.line(f"\nOpen {output_dir / PAGE}")
