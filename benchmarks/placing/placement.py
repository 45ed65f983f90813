"""Accuracy of placed maps and of comparisons of maps (``python -m benchmarks.placing.placement``).

Fits were tuned on the iCub hexagon and palm, the plantar recording, and simulations of seeds 201 to
203 and 301 to 306; the figures are of the iCub torso and of simulations from seed 401 on. Results
on the torso were seen during development. The errors that are expected of maps are medians over the
real recordings and simulations of seeds 201 to 203 and 211.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap import Recording, SensorMap, align, reconstruct, simulate
from anisomap.errors import InputError
from anisomap.evaluation import compare_maps, median_spacing
from anisomap.numerics.surfaces import Mesh
from anisomap.placement import (
    Anchors,
    Modules,
    Placement,
    modules_by_size,
    place,
    suggest_anchors,
)
from anisomap.simulation import Body, find_body
from benchmarks.harness import options, stream

Points = NDArray[np.float64]
Indices = NDArray[np.intp]

DRAWS = 30
BODIES = ("sphere", "cylinder", "y-shape", "hand", "hemisphere")
FLAT = ("plane", "hexagon")
SEEDS = (401, 402, 403)
HANDS = (
    ("recordings", "icub_hexagon", 2),
    ("recordings", "icub_palm", 2),
    ("recordings", "icub_torso", 2),
    ("recordings", "plantar", 2),
    ("recordings-hard", "insole_L", 2),
    ("recordings-hard", "nao_head", 3),
    ("recordings-hard", "nao_torso", 3),
)
HAND_DRAWS = 100
_MM = 1e-3
_ANCHORS = 4


@dataclass(frozen=True)
class Figure:
    """A measured number.

    subject, measure: What was placed or compared, and what was measured.
    median, worst: Over draws of anchors or faults: the median, and the quantile of 90 % (10 % for
        shares); of what is true or false, the share that is true.
    draws, refused: Number of draws, and of those that were refused.
    """

    subject: str
    measure: str
    median: float
    worst: float
    draws: int
    refused: int = 0


Measured: TypeAlias = tuple[str, float | None]
"""What was measured in one draw, and its value; None if it was refused."""


def figures(subject: str, measured: Iterable[Measured]) -> Iterator[Figure]:
    """Summarise values over draws, by what was measured."""
    values: dict[str, list[float | None]] = {}
    for measure, value in measured:
        values.setdefault(measure, []).append(value)
    for measure, drawn in values.items():
        known = [value for value in drawn if value is not None]
        numbers = np.array(known or [np.nan], dtype=np.float64)
        tail = 0.1 if "share" in measure and "flagged" not in measure else 0.9
        middle, worst = float(np.median(numbers)), float(np.quantile(numbers, tail))
        if all(isinstance(value, bool) for value in known):
            middle = worst = float(numbers.mean())
        yield Figure(subject, measure, middle, worst, len(drawn), len(drawn) - len(known))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write all figures."""
    parser = options(__doc__, "placement.csv", recordings=False)
    parser.add_argument("--shared", type=Path, help="folder with recordings/ and geometry/")
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--bodies", nargs="+", default=BODIES, choices=BODIES)
    chosen = parser.parse_args(arguments)
    stream(chosen.output, _figures(chosen.shared, chosen.draws, chosen.bodies))


def _figures(shared: Path | None, draws: int, bodies: Sequence[str]) -> Iterator[Figure]:
    if shared is not None:
        for name in ("icub_hexagon", "icub_torso"):
            yield from _real(shared, name, draws)
        for folder, name, dimensions in HANDS:
            recording = anisomap.read(shared / folder / f"{name}.npz")
            yield from figures(name, _hands([recording], dimensions))
    for body in bodies:
        yield from figures(body, _on_mesh(body, draws))
    for name, dimensions in (*((body, 3) for body in bodies), *((body, 2) for body in FLAT)):
        made = [simulate(name, "rubbing", n_frames=1200, seed=seed) for seed in SEEDS]
        yield from figures(name, _hands(made, dimensions))


def _real(shared: Path, name: str, draws: int) -> Iterator[Figure]:
    """Place and compare maps of a recording of triangles of the iCub."""
    recording = anisomap.read(shared / "recordings" / f"{name}.npz")
    template = anisomap.read_map(shared / "geometry" / "iit_triangle_10pad.npz")
    truth = np.asarray(recording.positions, dtype=np.float64) * _MM
    modules = modules_by_size(recording.names, 12).with_template(template)
    half = len(recording.readings) // 2
    first, second = (
        reconstruct(Recording(readings, names=recording.names), dimensions=2)
        for readings in (recording.readings[:half], recording.readings[half:])
    )
    whole = reconstruct(recording, dimensions=2)
    yield _free(name, whole, truth)
    yield from figures(name, _anchored(whole, truth, modules, draws))
    yield from figures(name, _two_days((first, second), truth, modules, draws))
    yield from figures(name, _differences(first, second, truth, draws))


def _free(name: str, whole: SensorMap, truth: Points) -> Figure:
    """Fit a map to all true positions: the median and the largest error."""
    errors = align(whole.positions, truth).errors / median_spacing(truth)
    title = "free map, Procrustes on all sensors: median error (pitches)"
    return Figure(name, title, float(np.median(errors)), float(errors.max()), 1)


def _anchored(whole: SensorMap, truth: Points, modules: Modules, draws: int) -> Iterator[Measured]:
    """Place a map by random anchors and by suggested ones, with and without modules."""
    best, pitch = align(whole.positions, truth), median_spacing(truth)
    measures: dict[str, Callable[[Points, Points], Any]] = {
        "RMS error over that of Procrustes on all sensors": lambda off, _: (
            np.sqrt(np.mean(off**2)) / best.rms
        ),
        "median error (pitches)": lambda off, _: np.median(off) / pitch,
        "share of sensors within their error": lambda off, stated: np.mean(off <= stated),
    }
    suggested = whole.indices(suggest_anchors(whole, _ANCHORS))
    for count in (0, _ANCHORS, 8, 20):
        chosen = _draws(truth, count, draws) if count else [suggested]
        how = f"{count} random anchors" if count else f"{_ANCHORS} suggested anchors"
        for rows, (given, more) in product(chosen, ((None, ""), (modules, " and triangles"))):
            found = placed(whole, truth, rows, modules=given)
            for what, measure in measures.items():
                value = None
                if found is not None:
                    off, stated = (
                        np.delete(x, rows) for x in (_off(found, truth), found.map.errors)
                    )
                    value = float(measure(off, stated))
                yield f"{how}{more}: {what}", value


def _two_days(
    days: tuple[SensorMap, SensorMap], truth: Points, modules: Modules, draws: int
) -> Iterator[Measured]:
    """Place maps of two halves of a recording by the same anchors."""
    for count in (_ANCHORS, 8):
        what = f"{count} random anchors and triangles, two days: share within both errors"
        for rows in _draws(truth, count, draws):
            one, other = (placed(day, truth, rows, modules=modules) for day in days)
            if one is None or other is None:
                yield what, None
            else:
                apart = np.linalg.norm(one.map.positions - other.map.positions, axis=1)
                inside = apart <= np.hypot(one.map.errors, other.map.errors)
                yield what, float(np.delete(inside, rows).mean())


def _differences(
    first: SensorMap, second: SensorMap, truth: Points, draws: int
) -> Iterator[Measured]:
    """Compare maps of two halves, with and without exchanged sensors."""
    moved = compare_maps(first, second).moved
    yield "diff of two halves: share flagged", float(np.mean(moved))
    far = 3 * median_spacing(truth)
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        a = int(rng.integers(len(truth)))
        b = int(rng.choice(np.flatnonzero(np.linalg.norm(truth - truth[a], axis=1) > far)))
        positions = second.positions.copy()
        positions[[a, b]] = positions[[b, a]]
        moved = compare_maps(first, SensorMap(positions, names=second.names)).moved
        what = "diff, 2 sensors 3 spacings apart or more exchanged: share named"
        yield what, float(moved[[a, b]].mean())
        what = "diff, 2 sensors exchanged: share of others flagged"
        yield what, float(np.delete(moved, [a, b]).mean())


def _on_mesh(name: str, draws: int) -> Iterator[Measured]:
    """Place maps of a simulated body on its mesh, by 3 anchors."""
    body = find_body(name)
    mesh = outline(body)
    for seed in SEEDS:
        recording = simulate(name, "rubbing", n_frames=1200, seed=seed)
        truth = np.asarray(recording.positions, dtype=np.float64)
        made = reconstruct(Recording(recording.readings, names=recording.names), dimensions=3)
        mirrored = align(made.positions[made.placed], truth[made.placed]).reflected
        for rows in _draws(truth, 3, draws // len(SEEDS) + 1):
            found, off, right = placed(made, truth, rows, mesh=mesh), None, None
            if found is not None:
                off = float(np.nanmedian(np.delete(_off(found, truth), rows))) / body.spacing
                right = bool(found.map.mirrored == mirrored)
            yield "mesh and 3 anchors: median error (spacings)", off
            yield "mesh and 3 anchors: share of the right hand where placed", right


def _hands(recordings: Sequence[Recording], dimensions: int) -> Iterator[Measured]:
    """Tell whether random anchors decide the hand wrongly, in the plane or in space."""
    for recording in recordings:
        whole = reconstruct(
            Recording(recording.readings, names=recording.names), dimensions=dimensions
        )
        here = np.flatnonzero(whole.component == 0)
        truth = np.asarray(recording.positions, dtype=np.float64)[here] * _MM
        part = SensorMap(whole.positions[here], distorted=whole.distorted)
        right = align(part.positions, truth).aligned
        for count in (3, 4, 5):
            for rows in _draws(truth, count, HAND_DRAWS):
                found = placed(part, truth, rows)
                wrong = None if found is None else not _same_hand(found.map.positions, right, rows)
                yield f"{count} random anchors: share of wrong hands where placed", wrong


def _same_hand(placed: Points, right: Points, anchors: Indices) -> bool:
    """Compare the hands of two images of one map, in its plane if it is flat."""
    one, other = (np.delete(p, anchors, axis=0) for p in (placed, right))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    _, widths, axes = np.linalg.svd(other, full_matrices=False)
    axes = axes[widths > 1e-9 * widths[0]]
    return bool(np.linalg.det((one @ axes.T).T @ (other @ axes.T)) > 0)


def _draws(truth: Points, count: int, draws: int) -> Iterator[Indices]:
    """Draw random anchors, of which there are `count` in each draw."""
    for draw in range(draws):
        yield np.random.default_rng(draw).choice(len(truth), count, replace=False)


def placed(made: SensorMap, truth: Points, rows: Indices, **options: Any) -> Placement | None:
    """Place a map by the true positions of some sensors; None if it is refused."""
    try:
        return place(made, Anchors(tuple(made.names[i] for i in rows), truth[rows]), **options)
    except InputError:
        return None


def _off(placement: Placement, truth: Points) -> Points:
    return np.asarray(np.linalg.norm(placement.map.positions - truth, axis=1))


def outline(body: Body) -> Mesh:
    """Return the surface of a body without the parts of solids inside others."""
    vertices, faces, start = [], [], 0
    for i, solid in enumerate(body.solids):
        shape = solid.outline
        centres = shape.vertices[shape.faces].mean(axis=1)
        outside = np.ones(len(centres), dtype=bool)
        for j, other in enumerate(body.solids):
            if i != j:
                outside &= other.distance(centres) > 0
        vertices.append(shape.vertices)
        faces.append(shape.faces[outside] + start)
        start += len(shape.vertices)
    return Mesh(np.vstack(vertices), np.vstack(faces))


if __name__ == "__main__":
    main()
