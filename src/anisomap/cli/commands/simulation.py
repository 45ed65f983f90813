"""Recordings of known truth: ``simulate``, ``coverage``, ``spoil``, ``demo`` and ``paper``."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Group, Parameter
from numpy.typing import NDArray

import anisomap
from anisomap import drawing, io
from anisomap.base.defaults import DEFAULT_METHOD, PERMUTATIONS
from anisomap.base.scene import Scene
from anisomap.base.wording import join_items, number, percent
from anisomap.cli import parameters as options
from anisomap.cli.console import Columns, Printer, errors, print_warning, progress
from anisomap.errors import FileError, InputError, import_extra
from anisomap.files.paths import atomic_write, together

_looks = Group("Pictures", sort_key=1)


def simulate_body(
    body: str,
    /,
    *,
    scenario: Annotated[str, Parameter(alias="-s")] = "bombardment",
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    seed: options.Seed = 0,
    frames: options.Count = 2000,
    sensors: str | None = None,
    placement: Annotated[str | None, options.expert] = None,
    parameter: Annotated[list[str] | None, Parameter(alias="-p")] = None,
    runs: Annotated[options.Count, options.expert] = 1,
    picture: Annotated[Path | None, Parameter(group=_looks)] = None,
    video: Annotated[Path | None, Parameter(group=_looks)] = None,
    renderer: Annotated[Literal["drawing", "mujoco"], options.expert] = "drawing",
    view: Annotated[bool, options.expert] = False,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Simulate a recording with known sensor positions.

    Parameters
    ----------
    body
        Name from `anisomap bodies`, or a file: a closed mesh, a MuJoCo model (MJCF), or positions
        of sensors.
    scenario
        Scenario: see `anisomap scenarios`.
    output
        NPZ file to write. Default: BODY-SCENARIO.npz. With several runs, the seed is appended to
        its name.
    frames
        Number of frames to record.
    sensors
        Number of sensors, or a file with their positions in the frame and unit of the body.
    placement
        Places of the sensors of the cylinder: columns (the default), fibonacci or random.
    parameter
        NAME=VALUE, a parameter of the scenario; may be repeated. `anisomap scenarios SCENARIO`
        lists them.
    runs
        Number of recordings, with consecutive seeds, simulated in parallel.
    picture
        File for a figure of body, sensors, contacts and readings: .png, .svg or .pdf.
    video
        File for an animation of the first ten seconds: .gif, or .mp4 if ffmpeg is installed.
    renderer
        Renderer of figure and animation: a drawing with axes, or MuJoCo, which needs EGL.
    view
        Show the run in MuJoCo's viewer.
    """
    from anisomap.cli.outputs import Outputs
    from anisomap.drawing.figures import scenes
    from anisomap.simulation import run_simulation, simulate_runs

    skin = read_body(body, sensors, **({"placement": placement} if placement else {}))
    target = output or Path(f"{skin.name}-{scenario}.npz")
    Outputs(recording=target, picture=picture, others=[video], inputs=[Path(body)])
    if video:
        scenes.check_animation(video)
    settings = {"n_frames": frames, **_parse_parameters(parameter or [])}
    if runs > 1:
        if picture or video or view:
            raise InputError("--picture, --video and --view show one run; leave out --runs")
        seeds = range(seed, seed + runs)
        paths = [target.with_stem(f"{target.stem}-{one}") for one in seeds]
        with progress(f"simulating {runs} runs"), together():
            recordings = simulate_runs(skin, scenario, seeds, **settings)
            for path, recording in zip(paths, recordings, strict=True):
                io.write(recording, path)
        told = (f"recording, seed {one}" for one in seeds)
        printer.files(list(zip(told, paths, strict=True)))
        return
    with progress(f"simulating {frames} frames of {scenario} of {skin.name}") as report_progress:
        simulation = run_simulation(skin, scenario, seed=seed, progress=report_progress, **settings)
    with together():
        io.write(simulation.recording, target)
        files = [("recording", target), *_show(simulation.scene, picture, video, renderer)]
    _print(printer, simulation.recording, skin)
    printer.files(files)
    printer.line(f"\nMap it:\n  anisomap map {target} -o map.csv")
    if view:
        from anisomap.simulation.physics import mujoco_viewer

        try:
            mujoco_viewer.show(simulation.scene)
        except mujoco_viewer.NoScreenError as error:
            print_warning(f"{error}; --picture and --video work without one")


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


def _show(
    scene: Scene, picture: Path | None, video: Path | None, renderer: str
) -> list[tuple[str, Path]]:
    """Draw a scene; MuJoCo renders it if asked to, and if there is a display."""
    from anisomap.drawing.figures import scenes
    from anisomap.simulation.physics import mujoco_viewer

    named = [(kind, path) for kind, path in (("picture", picture), ("video", video)) if path]
    if renderer == "mujoco" and named:
        shown = range(min(scenes.MAX_ANIMATION_FRAMES, scene.n_frames)) if video else range(0)
        try:
            with progress("rendering the scene"):
                images = mujoco_viewer.render(scene, [scenes.busiest_frame(scene), *shown])
        except mujoco_viewer.NoScreenError as error:
            print_warning(f"{error}; using the drawing instead")
        else:
            for kind, path in named:
                scenes.save_pixels(path, images[:1] if kind == "picture" else images[1:])
            return named
    if picture:
        with progress("drawing the scene"):
            drawing.figures.save_figure(scenes.scene_figure(scene), picture)
    if video:
        with progress("drawing the animation") as report:
            scenes.save_animation(scene, video, progress=report)
    return named


_COLUMNS: Columns = {
    "frames": ("frames", str),
    "seconds": ("seconds", number),
    "sensors touched": ("sensors_touched", percent),
    "neighbours touched together": ("neighbours_touched_together", percent),
    "Mantel r": ("mantel_r", lambda each: number(_mean(each), 3)),
}


def coverage(
    body: str = "sphere",
    /,
    *,
    scenario: Annotated[str, Parameter(alias="-s")] = "rubbing",
    frames: list[options.Count] | None = None,
    runs: Annotated[options.Count, options.expert] = 3,
    first_seed: Annotated[options.Amount, options.expert] = 1,
    sensors: str | None = None,
    parameter: Annotated[list[str] | None, Parameter(alias="-p"), options.expert] = None,
    method: options.Method = DEFAULT_METHOD,
    dimensions: Annotated[options.Count, Parameter(alias="-d"), options.expert] = 3,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    picture: options.Picture = None,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Estimate how long a skin must be stimulated: coverage as a function of recording length.

    Parameters
    ----------
    body
        Name, mesh, model or positions, as for `anisomap simulate`.
    scenario
        Scenario: see `anisomap scenarios`.
    frames
        Recording length; may be repeated.
    runs
        Number of seeds to average over.
    first_seed
        Seed of the first run.
    sensors
        Number of sensors, or a file with their positions.
    parameter
        NAME=VALUE, a parameter of the scenario, such as the density of the stimulation; may be
        repeated.
    dimensions
        Number of coordinates.
    output
        CSV file for the table.
    """
    from anisomap.cli.outputs import Outputs
    from anisomap.drawing.figures.charts import coverage_figure
    from anisomap.simulation.coverage import LENGTHS, coverage_curve

    Outputs(picture=picture, others=[output])
    skin = read_body(body, sensors)
    with progress(f"simulating {runs} runs of {scenario} of {skin.name}"):
        curve = coverage_curve(
            skin,
            scenario,
            frames or LENGTHS,
            range(first_seed, first_seed + runs),
            method=method,
            dimensions=dimensions,
            **_parse_parameters(parameter or []),
        )
    records = [
        {
            "frames": int(n_frames),
            "seconds": float(curve.seconds[i]),
            "sensors_touched": float(curve.touched[i].mean()),
            "neighbours_touched_together": float(curve.pairs[i].mean()) / max(curve.n_pairs, 1),
            "mantel_r": curve.mantel_r[i],
        }
        for i, n_frames in enumerate(curve.n_frames)
    ]
    title = f"Coverage of {skin.name} by {scenario}, mean of {runs} runs"
    printer.rows(title, _COLUMNS, records)
    printer.record(body=skin.name, scenario=scenario, runs=runs, coverage=records)
    with together():
        if output:
            rows = [[shown(one[name]) for name, shown in _COLUMNS.values()] for one in records]
            with atomic_write(output) as aside:
                lines = [",".join(cells) for cells in (_COLUMNS, *rows)]
                aside.write_text("\n".join(lines) + "\n", encoding="utf-8")
        if picture:
            shares = {
                "sensors touched": curve.touched,
                "neighbours touched together": curve.pairs / max(curve.n_pairs, 1),
                f"Mantel r of {method}": curve.mantel_r,
            }
            figure = coverage_figure(
                f"{skin.name}, {scenario}", curve.n_frames, curve.rate_hz, shares
            )
            drawing.figures.save_figure(figure, picture)


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean of the values that are known; NaN if none is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def spoil(
    recording: options.RecordingFile,
    /,
    *,
    fault: Annotated[list[str], Parameter(alias="-f")],
    output: Annotated[Path, Parameter(alias="-o")],
    seed: options.Seed = 0,
    printer: options.Printing = options.PRINTER,
) -> None:
    """Inject documented faults into a recording.

    The NPZ file lists every affected sensor and frame, so that fault detectors can be scored.

    Parameters
    ----------
    fault
        KIND:SENSORS,NAME=VALUE, such as dead:s3,s7 or saturating:10%,level=1 or dropped-frames.
        May be repeated; faults are applied in order. `anisomap faults` lists them.
    output
        NPZ file to write.
    """
    from anisomap import route
    from anisomap.cli.outputs import Outputs
    from anisomap.simulation.injection import ALL_SENSORS, inject, injected_faults, parse_fault

    requests = [parse_fault(text) for text in fault]
    Outputs(recording=output, inputs=[recording])
    spoilt = inject(route.read(recording, progress=progress), requests, seed)
    io.write(spoilt, output)
    sensors: defaultdict[str, list[str]] = defaultdict(list)
    frames: defaultdict[str, int] = defaultdict(int)
    for done in injected_faults(spoilt):
        sensors[done.kind].append({ALL_SENSORS: "all", "": "-"}.get(done.sensor, done.sensor))
        frames[done.kind] += sum(stop - start for start, stop in done.spans)
    records = [
        {"fault": kind, "sensors": names, "readings_or_frames": frames[kind]}
        for kind, names in sensors.items()
    ]
    columns: Columns = {
        "fault": ("fault", str),
        "sensors": ("sensors", join_items),
        "readings or frames": ("readings_or_frames", str),
    }
    printer.rows("Injected faults", columns, records)
    printer.record(injected=records)
    printer.files([("recording", output)])


def read_body(body: str, sensors: str | None = None, **options: Any) -> anisomap.simulation.Body:
    """Make a body from its name or file."""
    from anisomap.simulation import BODIES, body_from_points, find_body, load_body
    from anisomap.simulation.imported import MESH_SUFFIXES, MODEL_SUFFIXES

    given: int | Path | None = None
    if sensors is not None:
        given = int(sensors) if sensors.lstrip("-").isdecimal() else Path(sensors)
    if body in BODIES:
        if given is None or isinstance(given, int):
            return find_body(body, given, **options)
        raise InputError(
            f"--sensors must be the number of sensors of the body {body}, which has predefined "
            f"positions, got {sensors}"
        )
    if options:
        raise InputError(
            f"--{next(iter(options))} applies to named bodies only, and {body} is a file"
        )
    path = Path(body)
    if path.suffix.lower() in (*MESH_SUFFIXES, *MODEL_SUFFIXES) and not _contains_only_points(path):
        if isinstance(given, Path):
            found = _positions(given)
            return load_body(path, found.positions, found.names)
        return load_body(path, given)
    if not path.exists():
        raise InputError(
            f"there is no body or file {body!r}; choose from {', '.join(BODIES)}, or give a mesh, "
            "a MuJoCo model or a file of positions"
        )
    found = _positions(path)
    return body_from_points(
        found.positions, names=found.names, name=path.name.split(".")[0], units=found.units
    )


def _contains_only_points(path: Path) -> bool:
    """Return whether a file is a PLY point cloud, without faces, as written for maps."""
    if path.suffix.lower() != ".ply" or not path.is_file():
        return False
    with path.open("rb") as file:
        return b"element face" not in file.read(4096).split(b"end_header")[0]


def _positions(path: Path) -> anisomap.SensorMap:
    found = io.read_map(path)
    if found.dimensions != 3:
        raise InputError(f"{path} must contain positions in 3 dimensions, got {found.dimensions}")
    return found


def _parse_parameters(parameters: list[str]) -> dict[str, Any]:
    """Read ``NAME=VALUE`` pairs."""
    parsed: dict[str, Any] = {}
    for text in parameters:
        name, equals, value = text.partition("=")
        try:
            parsed[name.strip().replace("-", "_")] = (
                int(value) if value.strip().lstrip("+-").isdecimal() else float(value)
            )
        except ValueError as error:
            hint = f"{value!r} is not a number" if equals else "write NAME=VALUE"
            raise InputError(f"--parameter {text!r}: {hint}") from error
    return parsed


def demo(
    *,
    output_dir: Annotated[Path, Parameter(alias="-o")] = Path("demo"),
    frames: options.Count = 2000,
    method: options.Method = DEFAULT_METHOD,
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
