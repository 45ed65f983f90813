"""Recordings of known truth: ``simulate``, ``demo`` and ``paper``."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

import anisomap
from anisomap import drawing, io
from anisomap.base import DEFAULT_METHOD, PERMUTATIONS
from anisomap.base.wording import number, percent
from anisomap.cli import parameters as options
from anisomap.cli.console import Printer, errors, progress
from anisomap.errors import InputError, import_extra
from anisomap.files.paths import named_errors, together

_MESHES = (".glb", ".obj", ".off", ".stl")  # .obj files would be read as tables


def simulate_body(
    body: str,
    /,
    *,
    scenario: Annotated[str, Parameter(alias="-s")] = "bombardment",
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    seed: options.Seed = 0,
    frames: options.Count = 2000,
    sensors: int | None = None,
    parameter: Annotated[list[str] | None, Parameter(alias="-p")] = None,
    picture: options.Picture = None,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Simulate a recording with known sensor positions.

    Parameters
    ----------
    body
        Name from `anisomap list bodies`, or a file of sensor positions.
    scenario
        Scenario: see `anisomap list scenarios`.
    output
        .npz or .txt file to write [BODY-SCENARIO.npz].
    frames
        Number of frames to record, at 20 Hz.
    sensors
        Number of sensors on a named body. Default: see `anisomap list bodies`.
    parameter
        Parameter of the scenario, as NAME=VALUE. May be repeated; `anisomap list
        scenarios SCENARIO` explains all parameters.

    Examples
    --------
    anisomap simulate sphere
    anisomap simulate hand -s rubbing --frames 4000 -o hand.npz
    anisomap simulate plane -s rubbing -p hand_size=0.6
    """
    from anisomap.cli.outputs import Outputs
    from anisomap.drawing.figures import scenes
    from anisomap.simulation import run_simulation
    from anisomap.simulation.options import parse_parameters

    skin = read_body(body, sensors)
    target = output or Path(f"{skin.name}-{scenario}.npz")
    Outputs(recording=target, picture=picture, inputs=[Path(body)])
    settings: dict[str, Any] = {"n_frames": frames, **parse_parameters(parameter or [])}
    with progress(f"simulating {frames} frames of {scenario} of {skin.name}") as report_progress:
        simulation = run_simulation(skin, scenario, seed=seed, progress=report_progress, **settings)
    recording = simulation.recording
    with together():
        io.write(recording, target)
        if picture:
            drawing.figures.save_figure(scenes.scene_figure(simulation.scene), picture)
    _print(printer, recording, skin)
    printer.files([("recording", target), *([("picture", picture)] if picture else [])])
    printer.line(f"\nMap it:\n  anisomap map {target} -o map.csv")


def _print(printer: Printer, recording: anisomap.Recording, skin: anisomap.simulation.Body) -> None:
    readings, silent = recording.readings, int((~recording.varying()).sum())
    facts = {
        "body": f"{skin.name}, {skin.n_sensors} sensors, median spacing "
        f"{number(skin.spacing, 3)}{skin.units and ' ' + skin.units}",
        "frames": f"{recording.n_frames} at {number(recording.rate_hz)} Hz",
        "readings": f"up to {number(float(readings.max()))}, {percent((readings == 0).mean())} "
        "zeros",
        "never touched": f"{silent} sensors",
    }
    shown = {"body", "scenario", "anisomap", "mujoco"}
    facts |= {
        name.replace("_", " "): number(value) if isinstance(value, float) else str(value)
        for name, value in recording.metadata.items()
        if name not in shown
    }
    printer.facts(recording.source, facts)
    printer.record(
        body=skin.name,
        sensors=skin.n_sensors,
        median_spacing=skin.spacing,
        frames=recording.n_frames,
        rate_hz=recording.rate_hz,
        never_touched=silent,
        metadata=dict(recording.metadata),
    )


def read_body(body: str, n_sensors: int | None = None) -> anisomap.simulation.Body:
    """Make a body from its name, or from a file of positions."""
    from anisomap.simulation import BODIES, body_from_points, find_body

    if body in BODIES:
        return find_body(body, n_sensors)
    path = Path(body)
    if path.suffix.lower() in _MESHES:
        raise InputError(f"{body} is a mesh; give a file of the positions of sensors on it")
    if not path.exists():
        raise InputError(f"there is no body or file {body!r}; bodies: {', '.join(BODIES)}")
    if n_sensors is not None:
        raise InputError(f"--sensors is for named bodies; the file {body} holds its sensors")
    found = io.read_map(path)
    if found.dimensions != 3:
        raise InputError(f"{path} must contain positions in 3 dimensions, got {found.dimensions}")
    return body_from_points(
        found.positions, names=found.names, name=path.name.split(".")[0], units=found.units
    )


def demo(
    *,
    output_dir: Annotated[Path, Parameter(alias="-o")] = Path("demo"),
    frames: options.Count = 2000,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Simulate a skin, map it, and score the map.

    A sphere with 60 sensors is bombarded by elastic balls, as in the paper.

    Parameters
    ----------
    output_dir
        Folder for the recording, map, figure and report. It is created if necessary.
    frames
        Number of frames to simulate, at 20 Hz.

    Examples
    --------
    anisomap demo
    anisomap demo -o try --frames 4000
    anisomap map demo/recording.npz -o map.csv
    """
    from anisomap import route
    from anisomap.cli import outputs
    from anisomap.cli.printing import print_recording

    import_extra("mujoco", "the demo", "report,simulation")
    with named_errors(output_dir, "create the folder"):
        output_dir.mkdir(parents=True, exist_ok=True)
    recorded = output_dir / "recording.npz"
    files = outputs.Outputs(
        maps=(output_dir / "map.csv",),
        recording=recorded,
        picture=output_dir / "map.png",
        report=output_dir / "report.html",
    )
    with progress(f"simulating {frames} frames of a bombarded sphere") as report_progress:
        recording = anisomap.simulate(
            "sphere", "bombardment", n_frames=frames, progress=report_progress
        )
    examined = route.examine(recording)
    print_recording(printer, examined.recording, examined.summary)
    with progress("making the map"):
        made, stages = route.make_map(examined, DEFAULT_METHOD, dimensions=3)

    def write_recording() -> list[tuple[str, Path]]:
        io.write(recording, recorded)
        return [("recording", recorded)]

    outputs.finish(
        printer,
        files,
        made,
        examined,
        outputs.Truth(PERMUTATIONS),
        judge=partial(route.judge, examined, stages=stages),
        write_others=write_recording,
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
    recordings: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set")] = None,
    only: list[str] | None = None,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Reproduce the figures, tables and claims of the paper.

    Experiments run in one process per core. Experiments whose results are already in the folder are
    not repeated, so an interrupted run can be continued.

    Parameters
    ----------
    output_dir
        Folder for the results, created if absent. Its index.html shows the results.
    quick
        Use fewer frames, seeds and permutations, for a preview.
    first_seed
        First seed of each scenario; the same seed gives the same results.
    recordings
        Folder of icub_hexagon.npz, a recording of real skin. The page of results explains how to
        get it.
    set_
        Parameter that the paper does not give, as NAME=NUMBER. May be repeated. An example is
        locomotion.detection_radius=.25.
    only
        Experiment to run. Experiments that it needs run first. May be repeated. Default: all.

    Examples
    --------
    anisomap paper --quick
    anisomap paper --recordings recordings/ -o paper-out
    anisomap paper --only figure-4
    """
    from anisomap.paper import Settings, Status, reproduce
    from anisomap.paper.cases import parse_changes
    from anisomap.paper.results import PAGE

    settings = Settings(
        seed=first_seed, quick=quick, recordings=recordings, changes=parse_changes(set_ or ())
    )
    with progress("reproducing the paper") as show:

        def report(status: Status, fraction: float) -> None:
            show(fraction)
            if status.state == "computed":
                errors.print(f"{status.name}: {status.seconds:.1f} s", markup=False)

        found = reproduce(output_dir, settings, only=only or (), report=report)
    printer.table(
        "Experiments",
        ("name", "seconds", "state"),
        [(status.name, f"{status.seconds:.1f}", status.state) for status in found],
    )
    printer.record(experiments=[asdict(status) for status in found], page=output_dir / PAGE)
    printer.line(f"\nOpen {output_dir / PAGE}")
