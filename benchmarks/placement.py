"""Accuracy of placed maps and of comparisons of maps (``python -m benchmarks.placement``).

Fits were tuned on the iCub hexagon and palm, the plantar recording, and simulations of seeds 201 to
203 and 301 to 306; the figures are of the iCub torso and of simulations from seed 401 on. Results
on the torso were seen during development. The errors that are expected of maps are medians over the
real recordings and simulations of seeds 201 to 203 and 211.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap import Recording, SensorMap, align, reconstruct, simulate
from anisomap.errors import InputError
from anisomap.evaluation import compare_maps, median_spacing
from anisomap.placement import (
    Anchors,
    Modules,
    Placement,
    modules_by_size,
    place,
    suggest_anchors,
)
from anisomap.scene import Mesh
from anisomap.simulation import Body, find_body
from benchmarks.harness import options, stream

Result = TypeVar("Result")

DRAWS = 30
BODIES = ("sphere", "cylinder", "y-shape", "torus", "cube", "hand", "tube", "hemisphere")
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
        shares).
    draws, refused: Number of draws, and of those that were refused.
    """

    subject: str
    measure: str
    median: float
    worst: float
    draws: int
    refused: int = 0


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
            yield from _hands(name, [recording], dimensions)
    for body in bodies:
        yield from _on_mesh(body, draws)
    for name, dimensions in (*((body, 3) for body in bodies), ("plane", 2), ("hexagon", 2)):
        made = [simulate(name, "rubbing", n_frames=1200, seed=seed) for seed in SEEDS]
        yield from _hands(name, made, dimensions)


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
    yield from _anchored(name, reconstruct(recording, dimensions=2), truth, modules, draws)
    yield from _two_days(name, (first, second), truth, modules, draws)
    yield from _differences(name, first, second, truth, draws)


def _anchored(
    name: str, whole: SensorMap, truth: NDArray[np.float64], modules: Modules, draws: int
) -> Iterator[Figure]:
    """Place a map by random anchors and by suggested ones, with and without modules."""
    best, pitch = align(whole.positions, truth), median_spacing(truth)
    middle = float(np.median(best.errors)) / pitch
    title = "free map, Procrustes on all sensors: median error (pitches)"
    yield Figure(name, title, middle, float(best.errors.max()) / pitch, 1)

    def rms(placement: Placement, rest: NDArray[np.intp]) -> float:
        return float(np.sqrt(np.mean(_off(placement, truth)[rest] ** 2))) / best.rms

    def median(placement: Placement, rest: NDArray[np.intp]) -> float:
        return float(np.median(_off(placement, truth)[rest])) / pitch

    def within(placement: Placement, rest: NDArray[np.intp]) -> float:
        return float(np.mean((_off(placement, truth) <= placement.map.errors)[rest]))

    suggested = whole.indices(suggest_anchors(whole, _ANCHORS))
    for count in (0, _ANCHORS, 8, 20):
        for given, more in ((None, ""), (modules, " and triangles")):

            def placed(rows: NDArray[np.intp], given: Modules | None = given) -> Placement:
                names = tuple(whole.names[i] for i in rows)
                return place(whole, Anchors(names, truth[rows]), modules=given)

            if count:
                results = list(_draws(placed, truth, count, draws))
            else:
                rest = np.setdiff1d(np.arange(len(truth)), suggested)
                results = [(suggested, rest, placed(suggested))]
            how = f"{count} random anchors" if count else f"{_ANCHORS} suggested anchors"
            for measure, what in (
                (rms, "RMS error over that of Procrustes on all sensors"),
                (median, "median error (pitches)"),
                (within, "share of sensors within their error"),
            ):
                yield _figure(name, f"{how}{more}: {what}", results, measure)


def _two_days(
    name: str,
    days: tuple[SensorMap, SensorMap],
    truth: NDArray[np.float64],
    modules: Modules,
    draws: int,
) -> Iterator[Figure]:
    """Place maps of two halves of a recording by the same anchors."""

    def both_days(rows: NDArray[np.intp]) -> tuple[Placement, Placement]:
        anchors = Anchors(tuple(days[0].names[i] for i in rows), truth[rows])
        one, other = (place(day, anchors, modules=modules) for day in days)
        return one, other

    for count in (_ANCHORS, 8):
        shares = []
        for _, rest, pair in _draws(both_days, truth, count, draws):
            if pair is not None:
                apart = np.linalg.norm(pair[0].map.positions - pair[1].map.positions, axis=1)
                stated = np.hypot(pair[0].map.errors, pair[1].map.errors)
                shares.append(float(np.mean((apart <= stated)[rest])))
        what = f"{count} random anchors and triangles, two days: share within both errors"
        worst = float(np.quantile(shares, 0.1))
        yield Figure(name, what, float(np.median(shares)), worst, draws, draws - len(shares))


def _differences(
    name: str, first: SensorMap, second: SensorMap, truth: NDArray[np.float64], draws: int
) -> Iterator[Figure]:
    """Compare maps of two halves, with and without exchanged sensors."""
    accused = float(np.mean(compare_maps(first, second).moved))
    yield Figure(name, "diff of two halves: share accused", accused, accused, 1)
    far = 3 * median_spacing(truth)
    named, false = [], []
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        a = int(rng.integers(len(truth)))
        b = int(rng.choice(np.flatnonzero(np.linalg.norm(truth - truth[a], axis=1) > far)))
        positions = second.positions.copy()
        positions[[a, b]] = positions[[b, a]]
        moved = compare_maps(first, SensorMap(positions, names=second.names)).moved
        named.append(float(moved[[a, b]].mean()))
        false.append(float(np.delete(moved, [a, b]).mean()))
    yield Figure(name, "diff, 2 sensors 3 spacings apart or more exchanged: share named",
                 float(np.mean(named)), float(np.quantile(named, 0.1)), draws)  # fmt: skip
    yield Figure(name, "diff, 2 sensors exchanged: share of others accused",
                 float(np.mean(false)), float(np.quantile(false, 0.9)), draws)  # fmt: skip


def _on_mesh(name: str, draws: int) -> Iterator[Figure]:
    """Place maps of a simulated body on its mesh, by 3 anchors."""
    body = find_body(name)
    mesh = outline(body)
    results: list[tuple[NDArray[np.intp], NDArray[np.intp], Placement | None]] = []
    right, count = 0, draws // len(SEEDS) + 1
    medians = []
    for seed in SEEDS:
        recording = simulate(name, "rubbing", n_frames=1200, seed=seed)
        truth = np.asarray(recording.positions, dtype=np.float64)
        made = reconstruct(Recording(recording.readings, names=recording.names), dimensions=3)
        mirrored = align(made.positions[made.placed], truth[made.placed]).reflected

        def with_mesh(
            rows: NDArray[np.intp], made: SensorMap = made, truth: NDArray[np.float64] = truth
        ) -> Placement:
            anchors = Anchors(tuple(made.names[i] for i in rows), truth[rows])
            return place(made, anchors, mesh=mesh)

        for rows, rest, placement in _draws(with_mesh, truth, 3, count):
            results.append((rows, rest, placement))
            if placement is not None:
                right += placement.map.mirrored == mirrored
                medians.append(float(np.nanmedian(_off(placement, truth)[rest])) / body.spacing)
    refused = sum(placement is None for _, _, placement in results)
    done = len(results) - refused
    if done:
        yield Figure(name, "mesh and 3 anchors: median error (spacings)",
                     float(np.median(medians)), float(np.quantile(medians, 0.9)),
                     len(results), refused)  # fmt: skip
    share = right / done if done else float("nan")
    yield Figure(name, "mesh and 3 anchors: share of the right hand where placed",
                 share, share, len(results), refused)  # fmt: skip


def _hands(name: str, recordings: Sequence[Recording], dimensions: int) -> Iterator[Figure]:
    """Count the hands that random anchors decide wrongly, in the plane or in space."""
    maps = [
        reconstruct(Recording(r.readings, names=r.names), dimensions=dimensions) for r in recordings
    ]
    for count in (3, 4, 5):
        wrong = refused = 0
        for whole, recording in zip(maps, recordings, strict=True):
            here = np.flatnonzero(whole.component == 0)
            truth = np.asarray(recording.positions, dtype=np.float64)[here] * _MM
            part = SensorMap(whole.positions[here], uneven=whole.uneven)
            right = align(part.positions, truth).aligned

            def placed(
                rows: NDArray[np.intp], part: SensorMap = part, truth: NDArray[np.float64] = truth
            ) -> Placement:
                return place(part, Anchors(tuple(part.names[i] for i in rows), truth[rows]))

            for rows, _, placement in _draws(placed, truth, count, HAND_DRAWS):
                refused += placement is None
                if placement is not None:
                    wrong += not _same_hand(placement.map.positions, right, rows)
        draws = HAND_DRAWS * len(maps)
        done = draws - refused
        share = wrong / done if done else 0.0
        title = f"{count} random anchors: share of wrong hands where placed"
        yield Figure(name, title, share, share, draws, refused)


def _same_hand(
    placed: NDArray[np.float64], right: NDArray[np.float64], anchors: NDArray[np.intp]
) -> bool:
    """Compare the hands of two images of one map, in its plane if it is flat.

    Anchors are not on the map, but where they were measured.
    """
    one, other = (np.delete(p, anchors, axis=0) for p in (placed, right))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    _, widths, axes = np.linalg.svd(other, full_matrices=False)
    axes = axes[widths > 1e-9 * widths[0]]
    return bool(np.linalg.det((one @ axes.T).T @ (other @ axes.T)) > 0)


def _draws(
    make: Callable[[NDArray[np.intp]], Result], truth: NDArray[np.float64], count: int, draws: int
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], Result | None]]:
    """Yield random anchors, the other sensors, and what was made of them; None if refused."""
    for draw in range(draws):
        rows = np.random.default_rng(draw).choice(len(truth), count, replace=False)
        rest = np.setdiff1d(np.arange(len(truth)), rows)
        try:
            yield rows, rest, make(rows)
        except InputError:
            yield rows, rest, None


def _figure(
    subject: str,
    measure: str,
    results: Sequence[tuple[NDArray[np.intp], NDArray[np.intp], Placement | None]],
    compute: Callable[[Placement, NDArray[np.intp]], float],
) -> Figure:
    values = [compute(placement, rest) for _, rest, placement in results if placement is not None]
    tail = 0.1 if "share" in measure else 0.9
    return Figure(
        subject,
        measure,
        float(np.median(values)) if values else float("nan"),
        float(np.quantile(values, tail)) if values else float("nan"),
        len(results),
        len(results) - len(values),
    )


def _off(placement: Placement, truth: NDArray[np.float64]) -> NDArray[np.float64]:
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
