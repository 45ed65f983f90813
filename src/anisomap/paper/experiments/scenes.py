"""Figures 5 and 6: the bodies and the scenarios."""

from __future__ import annotations

from anisomap.drawing.figures.scenes import bodies_figure, scene_figure
from anisomap.paper.experiment import Experiment, Outcome, Picture, Settings, Table, Tables
from anisomap.paper.runs import BOMBARDED, CASES
from anisomap.simulation import find_body, run_simulation

_FEW_FRAMES = 400
_BODIES = {
    "body": "body",
    "sensors": "number of sensors",
    "reach_m": "distance from the middle to the outermost sensor, m",
    "spacing_m": "median distance between neighbouring sensors, m",
}
_SCENES = {
    "body": "body",
    "scenario": "what happens to it",
    "seed": "seed of the run",
    "frames": "frames of the run",
    "zeros": "share of the readings that are zero",
    "touched": "mean number of sensors that read something in a frame",
}


def figure_5(settings: Settings, _: Tables) -> Outcome:
    """Draw the four bodies."""
    bodies = [find_body(case.body) for case in BOMBARDED]
    scenes = [
        run_simulation(body, "bombardment", n_frames=1, seed=settings.seed).scene for body in bodies
    ]
    figure = bodies_figure(
        "Figure 5. The bodies and their sensors",
        scenes,
        [f"{body.name}, {body.n_sensors} sensors" for body in bodies],
    )
    rows = tuple((body.name, body.n_sensors, body.reach, body.spacing) for body in bodies)
    caption = "Sphere, cylinder (none on the ends), Y-shape and plane; yellow dots are sensors."
    table = Table("figure-5", "The bodies.", _BODIES, rows)
    return Outcome((Picture("figure-5", caption, figure),), (table,))


def figure_6(settings: Settings, _: Tables) -> Outcome:
    """Draw every scenario with its body."""
    pictures, rows = [], []
    n_frames = min(settings.n_frames, _FEW_FRAMES)
    for case in CASES:
        run = run_simulation(case.body, case.scenario, n_frames=n_frames, seed=settings.seed)
        readings = run.recording.readings
        caption = (
            f"{case.body}, {case.scenario}, seed {settings.seed}: the frame in which most sensors "
            f"are touched, of {n_frames}; the body alone; and all readings."
        )
        pictures.append(Picture(f"figure-6-{case.name}", caption, scene_figure(run.scene)))
        rows.append(
            (
                case.body,
                case.scenario,
                settings.seed,
                n_frames,
                float((readings == 0).mean()),
                float((readings > 0).sum(axis=1).mean()),
            )
        )
    return Outcome(tuple(pictures), (Table("figure-6", "The scenes.", _SCENES, tuple(rows)),))


EXPERIMENTS = (
    Experiment(
        "figure-5",
        "Figure 5: simulated sensor geometries",
        "60 sensors on a sphere; 60 in 10 columns of 6 on a cylinder, none on its ends; 105 on a "
        "Y-shape; 169 in a grid of 13 by 13 on one face of a cuboid. The paper gives no lengths: "
        "here a body reaches to about 1 m.",
        figure_5,
    ),
    Experiment(
        "figure-6",
        "Figure 6: simulated scenarios",
        "Bombardment: the body is fixed in a box without gravity, full of elastic balls. "
        "Locomotion: a sphere or a cylinder rolls over uneven ground. Orange is what touches the "
        "body; sensors are violet at rest and yellow where they read most.",
        figure_6,
        cost=25,
    ),
)
