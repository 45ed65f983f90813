"""Figures 5 and 6: the bodies and the scenarios."""

from __future__ import annotations

from anisomap.drawing.figures.scenes import bodies_figure, scene_figure
from anisomap.paper.cases import BOMBARDED, CASES
from anisomap.paper.experiment import Experiment, Outcome, Picture, Settings, Table, Tables
from anisomap.simulation import find_body, run_simulation

_MAX_FRAMES = 400  # enough to find a frame with many contacts
_BODIES = {
    "body": "body",
    "sensors": "number of sensors",
    "reach_m": "distance of the outermost sensor from the centre, m",
    "spacing_m": "median distance between neighbouring sensors, m",
}
_SCENARIOS = {
    "body": "body",
    "scenario": "scenario",
    "seed": "seed of the run",
    "frames": "frames of the run",
    "zeros": "share of readings that are zero",
    "touched": "mean number of sensors with a positive reading per frame",
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
    caption = (
        "Sphere, cylinder (no sensors on its ends), Y-shape and plane. Yellow dots are sensors."
    )
    table = Table("figure-5", "The bodies.", _BODIES, rows)
    return Outcome((Picture("figure-5", caption, figure),), (table,))


def figure_6(settings: Settings, _: Tables) -> Outcome:
    """Draw every scenario."""
    pictures, rows = [], []
    n_frames = min(settings.n_frames, _MAX_FRAMES)
    for case in CASES:
        run = run_simulation(case.body, case.scenario, n_frames=n_frames, seed=settings.seed)
        readings = run.recording.readings
        caption = (
            f"{case.body}, {case.scenario}, seed {settings.seed}: the frame with the most contacts "
            f"of {n_frames}, the body, and all readings."
        )
        pictures.append(Picture(f"figure-6-{case.name}", caption, scene_figure(run.scene)))
        zeros = float((readings == 0).mean())
        touched = float((readings > 0).sum(axis=1).mean())
        rows.append((case.body, case.scenario, settings.seed, n_frames, zeros, touched))
    table = Table("figure-6", "The scenarios.", _SCENARIOS, tuple(rows))
    return Outcome(tuple(pictures), (table,))


EXPERIMENTS = (
    Experiment(
        "figure-5",
        "Figure 5: simulated sensor geometries",
        "60 sensors on a sphere; 60 on a cylinder in 10 columns of 6, none on its ends; 105 on a "
        "Y-shape; 169 on one face of a cuboid in a grid of 13 x 13. The paper gives no lengths; "
        "here each body extends about 1 m from its centre.",
        figure_5,
    ),
    Experiment(
        "figure-6",
        "Figure 6: simulated scenarios",
        "Bombardment: the body is fixed in a box of elastic balls without gravity. Locomotion: a "
        "sphere or a cylinder rolls over uneven ground. Objects in contact with the body are "
        "orange; sensors range from violet (no contact) to yellow (largest reading).",
        figure_6,
        cost=25,
    ),
)
