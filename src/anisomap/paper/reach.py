"""Scores of methods by the reach of contacts and the number of contacts of each sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist, squareform

from anisomap import io
from anisomap.base import DEFAULT_METHOD
from anisomap.drawing.figures.charts import METHOD_LOOKS, CurvePanel, MethodLook, curves_figure
from anisomap.errors import InputError
from anisomap.evaluation import mantel, median_spacing
from anisomap.method.pipeline import reconstruct
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.paper.cases import METHODS, true_positions
from anisomap.paper.experiment import Picture, Row, Settings, Table, Tables, by, experiment
from anisomap.paper.map_scores import estimate
from anisomap.recording import Recording
from anisomap.simulation import find_body
from anisomap.simulation.body import Body

COMPARED = (*METHODS, DEFAULT_METHOD)
REACHES = (0.8, 0.9, 1.0, 1.15, 1.3, 1.6, 2.0, 3.0)  # in spacings
CONTACTS = (10, 30, 100, 300)  # of each sensor
_BODIES = (("sphere", 60), ("cylinder", 60), ("plane", 64))
_MARGIN = 0.5  # between the outer sensors and the edge of the plane, in spacings
_HALF = 0.808  # distance of two discs of radius 1 that share half of their area
_BIN = 0.25  # width of bins of distances, in spacings
_RECORDINGS = ("icub_hexagon", "icub_palm", "icub_torso", "plantar")
_LONGEST = 8000  # maximum frames of a real recording for a map, evenly chosen
_DEFAULT_LOOK = MethodLook("the default", "#000000", "v")

_SCORES = {
    "body": "body",
    "reach": "largest distance from a contact at which a sensor reads it, in spacings",
    "contacts": "contacts of each sensor",
    "seed": "seed",
    "method": "method",
    "mantel_r": "Mantel r of the map in 3D",
}
REACH_COLUMNS = {key: _SCORES[key] for key in ("body", "reach", "contacts")} | {
    f"{method}{suffix}": f"{meaning} Mantel r of {method}"
    for method in COMPARED
    for suffix, meaning in (("", "mean"), (" low", "lower end of the 95 % interval of the mean"),
                            (" high", "upper end of the interval of the mean"))
}  # fmt: skip
PLACE_COLUMNS = {
    "recording": "real recording",
    "sensors": "number of sensors",
    "reach": "reach in spacings, from how the chance of a common touch falls with distance",
    "contacts": "contacts of each sensor, median",
    "zeros": "share of readings at rest",
    **{method: f"Mantel r of {method} in 2D" for method in COMPARED},
}


def touch(body: Body, reach: float, contacts: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Simulate readings of random contacts, (T, N), without physics; on average one at a time.

    reach: In spacings. contacts: Number for each sensor.
    """
    far = reach * body.spacing
    share = float((cdist(_places(body, 4000, rng), body.positions) < far).mean())
    n_contacts = round(contacts / share)
    frames = rng.integers(n_contacts, size=n_contacts)
    readings = np.zeros((n_contacts, body.n_sensors))
    depths = np.maximum(far - cdist(_places(body, n_contacts, rng), body.positions), 0)
    np.maximum.at(readings, frames, depths)
    return readings


def _places(body: Body, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw places evenly on the side of the body with sensors, (n, 3)."""
    low, high = body.positions.min(axis=0), body.positions.max(axis=0)
    if body.name == "sphere":
        places = rng.standard_normal((n, 3))
        return np.asarray(high.max() * places / np.linalg.norm(places, axis=1, keepdims=True))
    margin = _MARGIN * body.spacing
    if body.name == "cylinder":
        angle = rng.uniform(0, 2 * np.pi, n)
        around = np.linalg.norm(body.positions[0, :2]) * np.array([np.cos(angle), np.sin(angle)])
        return np.column_stack([*around, rng.uniform(low[2] - margin, high[2] + margin, n)])
    return rng.uniform(low - margin * (high > low), high + margin * (high > low), (n, 3))


def reach_of(active: NDArray[np.bool_], positions: NDArray[np.float64]) -> float:
    """Estimate the reach of contacts in spacings. active (T, N), positions (N, k).

    The probability that a sensor is touched with another decreases with their distance, from 1 to
    the value of far sensors. It is halfway at the distance at which two discs of the radius of the
    reach share half of their area, for any number of simultaneous contacts.
    """
    on = active.astype(np.float64)
    together = on.T @ on
    times = np.diagonal(together)[:, None]
    chances, rest = together / np.maximum(times, 1), on.mean(axis=0)
    excess = squareform((chances - rest) / (1 - rest), checks=False)
    apart = pdist(positions) / median_spacing(positions)
    edges = np.arange(0.5 * _BIN, apart.max() + _BIN, _BIN)
    bins = np.digitize(apart, edges)
    distance, height = [0.0], [1.0]
    for each in np.unique(bins):
        distance.append(float(apart[bins == each].mean()))
        height.append(float(excess[bins == each].mean()))
        if height[-1] < 0.5:
            break
    half = np.interp(-0.5, -np.array(height[-2:]), distance[-2:])
    return float(half) / _HALF


def _score(recording: Recording, dimensions: int) -> dict[str, float]:
    """Return Mantel r by method; NaN if contacts are too few for a map of all sensors."""
    truth, found = true_positions(recording, dimensions), {}
    for method in COMPARED:
        found[method] = float("nan")
        try:
            made = reconstruct(recording, method, dimensions)
        except InputError:
            continue
        placed = made.placed & (made.component == 0)
        if placed.sum() > len(truth) / 2:
            found[method] = mantel(made.positions[placed], truth[placed], permutations=0).r
    return found


@experiment(
    "reach",
    "Reach of a contact against contacts per sensor",
    "The paper prefers r-ANISOMAP. Here the methods of the paper and the default of anisomap map "
    "skins that differ in two numbers: how far a contact is felt, in distances between neighbours, "
    "and how often each sensor is touched. Contacts are random places on the surface, one at a "
    "time in the mean, and a sensor reads how much nearer than the reach the nearest one is: no "
    "physics, no noise, and no frame that resembles the one before. Sphere and cylinder have 60 "
    "sensors, the plane 64; maps are in 3D.\n\nThe reach of real recordings is estimated from how "
    "the chance that two sensors are touched together falls with their distance.",
    cost=1500,
)
def reach_diagram(settings: Settings, _: Tables) -> Iterator[Picture | Table]:
    """Score all methods by reach and contacts, and locate real recordings in the diagram."""
    step = 3 if settings.quick else 1
    reaches, all_contacts = REACHES[::step], CONTACTS[::step]
    rows: list[Row] = []
    for body in (find_body(*each) for each in _BODIES):
        for reach, contacts, seed in product(reaches, all_contacts, settings.seeds):
            rng = np.random.default_rng([seed, contacts, round(100 * reach)])
            recording = Recording(touch(body, reach, contacts, rng), positions=body.positions)
            for method, r in _score(recording, 3).items():
                rows.append((body.name, reach, contacts, seed, method, r))
    scores = Table("reach-scores", "Scores of all maps.", _SCORES, rows, shown=False)
    means: list[Row] = []
    panels: list[CurvePanel] = []
    for body_name, of_body in by(scores.records(), "body").items():
        for contacts, of_contacts in by(of_body, "contacts").items():
            curves: dict[str, list[list[float]]] = {method: [] for method in COMPARED}
            for reach, found in by(of_contacts, "reach").items():
                cells: list[float] = []
                for method, each in by(found, "method").items():
                    runs = np.array([row["mantel_r"] for row in each])
                    curves[method].append(runs.tolist())
                    mean = estimate(runs)
                    cells += [mean.value, mean.low, mean.high]
                means.append((body_name, reach, contacts, *cells))
            title = f"{body_name}, {contacts} contacts per sensor"
            arrays = {method: np.array(values) for method, values in curves.items()}
            panels.append(CurvePanel(title, np.array(reaches), arrays))
    caption = (
        "Mantel r by the reach of a contact; dots: runs (seeds "
        f"{settings.seeds[0]} to {settings.seeds[-1]}), lines: means."
    )
    looks = {**METHOD_LOOKS, DEFAULT_METHOD: _DEFAULT_LOOK}
    title = "Which method maps which skin"
    figure = curves_figure(title, panels, x_label="reach of a contact, in spacings", looks=looks)
    yield Picture("reach", caption, figure)
    yield Table("reach", "Mean Mantel r.", REACH_COLUMNS, means)
    yield scores
    folder = settings.recordings or Path()
    paths = [folder / f"{name}.npz" for name in _RECORDINGS]
    places = [_place(path) for path in paths if settings.recordings and path.is_file()]
    if places:
        yield Table("reach-recordings", "Where real recordings lie.", PLACE_COLUMNS, places)


def _place(path: Path) -> Row:
    """Measure reach and contacts of a real recording, and map it."""
    recording = io.read(path)
    recording = recording.select(recording.varying())
    active = estimate_rest(recording.readings).active(recording.readings)
    starts = (active[1:] & ~active[:-1]).sum(axis=0)
    step = -(-recording.n_frames // _LONGEST)
    thinned = replace(recording, readings=recording.readings[::step])
    scores = _score(thinned.select(thinned.varying()), 2)
    reach = reach_of(active, true_positions(recording))
    measured = reach, float(np.median(starts)), 1 - float(active.mean())
    return (path.stem, recording.n_sensors, *measured, *scores.values())
