"""Figures 1, 4 to 7 and S1 to S4: the bodies, their scenarios, and their maps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from anisomap.drawing.figures.maps import gallery_figure
from anisomap.drawing.figures.scenes import bodies_figure, scene_figure
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.paper.cases import BOMBARDED, CASES, METHODS, Case
from anisomap.paper.experiment import Picture, Row, Settings, Table, Tables, experiment, mean_by
from anisomap.paper.map_scores import SCORE_COLUMNS, draw_run
from anisomap.paper.shapes import sphericity
from anisomap.simulation import run_simulation

_NOTE = (
    "A sensor has the same colour in all panels; lines join true neighbours. Maps are aligned with "
    "the true positions by rotation, scale and reflection."
)
_CYLINDER = ("mantel_r", "axial_scale", "local_axial_scale", "order_around", "order_along")
AXIAL_COLUMNS = {
    "scenario": "scenario of the cylinder",
    "method": "method",
    **{name: f"{SCORE_COLUMNS[name]}; mean over the runs" for name in _CYLINDER},
}
ROUNDNESS_COLUMNS = {
    "body": "bombarded body",
    "truth": "sphericity of the true positions",
    **{method: f"mean sphericity of the maps by {method}" for method in METHODS},
}


def _maps_of_bodies(
    name: str, title: str, bodies: tuple[str, ...], method: str, settings: Settings
) -> Picture:
    """Draw the true positions of bombarded bodies, and below these the maps by one method."""
    truths, maps, seeds = [], [], {}
    for case in map(Case, bodies):
        seeds[case.body] = settings.picked_seed(case.name)
        (truth, shown), _ = draw_run(
            case.record(settings, seeds[case.body]), settings, methods=[method]
        )
        truths.append(replace(truth, title=case.body))
        maps.append(shown)
    picked = ", ".join(f"{body} {seed}" for body, seed in seeds.items())
    caption = f"Typical maps by {method}. Randomly picked seeds: {picked}."
    return Picture(name, caption, gallery_figure(title, [*truths, *maps], len(bodies), _NOTE))


def _maps_by_all_methods(name: str, title: str, case: Case, settings: Settings) -> Picture:
    """Draw the true positions and the maps of a randomly picked run, in a row."""
    seed = settings.picked_seed(case.name)
    panels, _ = draw_run(case.record(settings, seed), settings)
    caption = f"Maps of {case.body}, {case.scenario}, by all methods. Randomly picked seed: {seed}."
    figure = gallery_figure(f"{title}, {case.scenario}, seed {seed}", panels, 5, _NOTE)
    return Picture(name, caption, figure)


@experiment(
    "figure-1",
    "Figure 1: typical reconstructions by r-ANISOMAP",
    "The paper shows one randomly chosen reconstruction of each body (cylinder, plane, "
    "Y-shape and sphere) after 2,000 frames of bombardment by small balls.",
    cost=20,
)
def figure_1(settings: Settings, _: Tables) -> Iterator[Picture]:
    """Draw the maps of the four bodies by r-ANISOMAP."""
    title = "Figure 1. Maps of bombarded bodies by r-ANISOMAP (bottom) and true positions (top)"
    bodies = ("cylinder", "plane", "y-shape", "sphere")
    yield _maps_of_bodies("figure-1", title, bodies, "r-anisomap", settings)


def supplementary_figure(
    number: str, body: str, settings: Settings, _: Tables
) -> Iterator[Picture]:
    """Draw the maps of one bombarded body by all methods."""
    name, title = f"figure-{number.lower()}", f"Figure {number}. {body}"
    yield _maps_by_all_methods(name, title, Case(body), settings)


for _number, _body in (("S1", "cylinder"), ("S2", "plane"), ("S3", "y-shape"), ("S4", "sphere")):
    experiment(
        f"figure-{_number.lower()}",
        f"Figure {_number}: {_body}, bombardment, all methods",
        f"The randomly picked run of the {_body}, reconstructed by each of the four methods.",
        cost=12,
    )(partial(supplementary_figure, _number, _body))


@experiment(
    "figure-4",
    "Figure 4: the rolling cylinder",
    "A cylinder touches the ground along a line parallel to its axis, so that the sensors on "
    "this line have similar readings. In the paper, all methods mapped the rolling cylinder "
    "relatively poorly: the maps were compressed along the axis, and their topology was "
    "reasonable.\n\nTwo scales measure the compression here: the axial scale of the map relative "
    "to its radial scale, and the local one, the distance of axial neighbours relative to "
    "circumferential neighbours. Maps with a scale below 1 are compressed. Two orders measure the "
    "topology, independently of the compression: the order of the lines around the axis, and the "
    "order of the sensors along each line. The bombarded cylinder is the control.",
    needs=("runs-cylinder-locomotion", "runs-cylinder-bombardment"),
)
def figure_4(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw the rolling cylinder; measure the axial compression when it rolls or is bombarded."""
    rolling = Case("cylinder", "locomotion")
    yield _maps_by_all_methods("figure-4", "Figure 4. Cylinder", rolling, settings)
    rows: list[Row] = []
    for case in (rolling, Case("cylinder")):
        means = [mean_by(_scores(tables, case), "method", name) for name in _CYLINDER]
        rows += [(case.scenario, method, *(mean[method] for mean in means)) for method in METHODS]
    caption = "Mean axial scale and order of the maps of the cylinder."
    yield Table("figure-4", caption, AXIAL_COLUMNS, rows)


@experiment(
    "figure-7",
    "Figure 7: spherisation by information distance",
    "Unrelated sensors all have about the same information distance, which cannot be "
    "represented in few dimensions. According to the paper, the maps therefore tend towards a "
    "sphere. The sphericity measures this: a sphere and a plane are fitted to the map, and the RMS "
    "distance of the sensors from the plane minus that from the sphere is taken, relative to what "
    "a whole sphere has: 1 for a sphere, 0 for a plane.",
    needs=tuple(f"runs-{case.name}" for case in BOMBARDED),
)
def figure_7(settings: Settings, tables: Tables) -> Iterator[Picture | Table]:
    """Draw maps by information distance; measure the sphericity of all maps."""
    title = "Figure 7. Maps by information distance (bottom) and true positions (top)"
    bodies = ("cylinder", "y-shape", "plane")
    yield _maps_of_bodies("figure-7", title, bodies, "information-distance", settings)
    rows: list[Row] = []
    for body in bodies:
        scores = [row for row in _scores(tables, Case(body)) if row["dimensions"] == 3]
        means, truth = mean_by(scores, "method", "sphericity"), Case(body).shape(settings).positions
        rows.append((body, sphericity(truth), *(means[method] for method in METHODS)))
    yield Table("figure-7", "Sphericity of the maps.", ROUNDNESS_COLUMNS, rows)


def _scores(tables: Tables, case: Case) -> list[Mapping[str, Any]]:
    """Return the scores of all maps with the default number of bins."""
    rows = tables[f"scores-{case.name}"].records()
    return [row for row in rows if row["bins"] == DEFAULT_BINS]


_MAX_FRAMES = 400  # sufficient for a frame with many contacts


@experiment(
    "figure-5",
    "Figure 5: simulated sensor geometries",
    "60 sensors on a sphere; 60 on a cylinder in 10 columns of 6, none on its ends; 105 on a "
    "Y-shape; 169 on one face of a cuboid in a grid of 13 x 13. The paper gives no lengths; "
    "here each body extends about 1 m from its centre.",
)
def figure_5(settings: Settings, _: Tables) -> Iterator[Picture]:
    """Draw the four bodies."""
    bodies = [case.shape(settings) for case in BOMBARDED]
    scenes = [
        run_simulation(body, "bombardment", n_frames=1, seed=settings.seed).scene for body in bodies
    ]
    labels = [f"{body.name}, {body.n_sensors} sensors" for body in bodies]
    figure = bodies_figure("Figure 5. The bodies and their sensors", scenes, labels)
    caption = (
        "Sphere, cylinder (no sensors on its ends), Y-shape and plane. Yellow dots are sensors."
    )
    yield Picture("figure-5", caption, figure)


@experiment(
    "figure-6",
    "Figure 6: simulated scenarios",
    "Bombardment: the body is fixed in a box of elastic balls without gravity. Locomotion: a "
    "sphere or a cylinder rolls over uneven ground. Balls are orange; sensors range from violet "
    "(no contact) to yellow (largest reading).",
    cost=25,
)
def figure_6(settings: Settings, _: Tables) -> Iterator[Picture]:
    """Draw every scenario."""
    n_frames = min(settings.n_frames, _MAX_FRAMES)
    for case in CASES:
        body, parameters = case.shape(settings), case.parameters(settings)
        run = run_simulation(body, case.scenario, n_frames, settings.seed, **parameters)
        caption = (
            f"{case.body}, {case.scenario}, seed {settings.seed}: the frame with the most contacts "
            f"of {n_frames}, the body, and all readings."
        )
        yield Picture(f"figure-6-{case.name}", caption, scene_figure(run.scene))
