"""``anisomap simulate``: a recording of a simulated skin, with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter
from cyclopts.validators import Number

from anisomap import io
from anisomap.cli import bodies
from anisomap.cli.console import console, number, percent, progress, show_facts, show_table, warn
from anisomap.drawing import figures
from anisomap.drawing.figures import stage
from anisomap.errors import InputError
from anisomap.files import check_distinct
from anisomap.scene import Scene
from anisomap.simulation import Body, Simulation, mujoco_viewer, run_simulation, simulate_runs

_looks = Group("Looks", sort_key=1)


def simulate_body(
    body: str,
    /,
    *,
    scenario: Annotated[str, Parameter(alias="-s")] = "bombardment",
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 1,
    frames: Annotated[int, Parameter(validator=Number(gte=1))] = 2000,
    sensors: str | None = None,
    parameter: Annotated[list[str] | None, Parameter(alias="-p", negative=())] = None,
    runs: Annotated[int, Parameter(validator=Number(gte=1))] = 1,
    picture: Annotated[Path | None, Parameter(group=_looks)] = None,
    video: Annotated[Path | None, Parameter(group=_looks)] = None,
    renderer: Annotated[Literal["drawing", "mujoco"], Parameter(group=_looks)] = "drawing",
    view: Annotated[bool, Parameter(group=_looks, negative=())] = False,
) -> None:
    """Make a recording whose truth is known.

    Parameters
    ----------
    body
        A name that `anisomap bodies` lists, or a file: a closed mesh, a MuJoCo model (MJCF), or
        positions of sensors.
    scenario
        What happens to it: see `anisomap scenarios`.
    output
        NPZ file to write; BODY-SCENARIO.npz unless given. With several runs, the seed is added to
        its name.
    seed
        Same seed, same recording.
    frames
        Frames to record.
    sensors
        How many sensors, or a file with their positions, in the frame and unit of the body.
    parameter
        NAME=VALUE, a parameter of the scenario; may be repeated. `anisomap scenarios SCENARIO`
        tells them all.
    runs
        Make so many recordings, of this seed and those that follow, in parallel over the cores.
    picture
        Draw the body, its sensors, what touches them and what they read: .png, .svg or .pdf.
    video
        Draw the first ten seconds of frames as an animation: .gif, or .mp4 if there is ffmpeg.
    renderer
        Who makes picture and video: a drawing with axes, or MuJoCo, which needs EGL.
    view
        Watch the run in MuJoCo's window.
    """
    skin = bodies.find(body, sensors)
    target = output or Path(f"{skin.name}-{scenario}.npz")
    _check_outputs(target, picture, video, body)
    settings = {"n_frames": frames, **bodies.parse_parameters(parameter or [])}
    if runs > 1:
        if picture or video or view:
            raise InputError("a picture, video or view is of one run: leave --runs out")
        _simulate_many(skin, scenario, range(seed, seed + runs), target, settings)
        return
    with progress(f"simulating {frames} frames of {scenario} of {skin.name}") as tell:
        simulation = run_simulation(skin, scenario, seed=seed, progress=tell, **settings)
        io.write(simulation.recording, target)
    _tell(simulation, skin)
    files = [("recording", target)]
    files += _show(simulation.scene, picture, video, renderer)
    show_table("Files", ("what", "where"), [(what, str(path)) for what, path in files])
    console.print(f"\nMap it:\n  anisomap map {target} -o map.csv", markup=False, soft_wrap=True)
    if view:
        _view(simulation.scene)


def _check_outputs(target: Path, picture: Path | None, video: Path | None, body: str) -> None:
    check_distinct([path for path in (target, picture, video) if path], [Path(body)])
    io.check_writable(target)
    if target.suffix.lower() != ".npz":
        raise InputError(f"a recording is written as NPZ, so {target} must end in .npz")
    if picture:
        figures.check_writable(picture)
    if video:
        stage.check_animation(video)


def _simulate_many(
    skin: Body, scenario: str, seeds: range, target: Path, settings: dict[str, Any]
) -> None:
    with progress(f"simulating {len(seeds)} runs"):
        runs = simulate_runs(skin, scenario, seeds, **settings)
        rows = []
        for seed, recording in zip(seeds, runs, strict=True):
            path = target.with_stem(f"{target.stem}-{seed}")
            io.write(recording, path)
            rows.append((f"recording, seed {seed}", str(path)))
    show_table("Files", ("what", "where"), rows)


def _tell(simulation: Simulation, skin: Body) -> None:
    recording = simulation.recording
    readings = recording.readings
    facts = {
        "body": f"{skin.name}, {skin.n_sensors} sensors, of which neighbours are "
        f"{number(skin.spacing, 3)}{skin.units and ' ' + skin.units} apart",
        "frames": f"{recording.n_frames} at {number(recording.rate_hz)} Hz",
        "readings": f"up to {number(float(readings.max()))}, {percent((readings == 0).mean())} "
        "zeros",
        "never touched": f"{int((~recording.varying()).sum())} sensors",
    }
    told = {"body", "scenario", "anisomap", "mujoco"}
    facts |= {
        name.replace("_", " "): number(value) if isinstance(value, float) else str(value)
        for name, value in recording.metadata.items()
        if name not in told
    }
    show_facts(recording.source, facts)


def _show(
    scene: Scene, picture: Path | None, video: Path | None, renderer: str
) -> list[tuple[str, Path]]:
    if renderer == "mujoco" and (picture or video) and _rendered(scene, picture, video):
        pass
    else:
        if picture:
            with progress("drawing the scene"):
                figures.save_figure(stage.scene_figure(scene), picture)
        if video:
            with progress("drawing the animation") as tell:
                stage.save_animation(scene, video, progress=tell)
    named = (("picture", picture), ("video", video))
    return [(what, path) for what, path in named if path is not None]


def _rendered(scene: Scene, picture: Path | None, video: Path | None) -> bool:
    """Let MuJoCo make the pictures, if it can."""
    frames = range(min(stage.LONGEST_ANIMATION, scene.n_frames)) if video else range(0)
    try:
        with progress("rendering the scene"):
            images = mujoco_viewer.render(scene, [stage.busiest_frame(scene), *frames])
    except mujoco_viewer.NoScreenError as error:
        warn(f"{error}; drawn instead")
        return False
    if picture:
        stage.save_pixels(picture, images[:1])
    if video:
        stage.save_pixels(video, images[1:])
    return True


def _view(scene: Scene) -> None:
    try:
        mujoco_viewer.show(scene)
    except mujoco_viewer.NoScreenError as error:
        warn(f"{error}; --picture and --video need none")
