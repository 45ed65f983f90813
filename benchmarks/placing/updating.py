"""Accuracy of updated maps (``python -m benchmarks.placing.updating``).

The first half of a recording lacks a tenth of the sensors, chosen at random; the map of it is
updated by the second half, in which all sensors are connected. No constant of an update was tuned
on these recordings, but results on them were seen during development. Simulations have seeds from
401 on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap import Recording, SensorMap, align, gather_evidence, reconstruct, simulate, update_map
from anisomap.evaluation import median_spacing
from benchmarks.harness import options, stream
from benchmarks.placing.placement import Figure, Measured, figures, placed

REAL = {"icub_hexagon": 2, "icub_palm": 3, "icub_torso": 2, "plantar": 2}
SIMULATED = {"plane": 2, "sphere": 3, "cylinder": 3}
SEED = 401
DRAWS = 5
_FRAMES = 2400
_ANCHORS = 8
_FAR = 3  # spacings between sensors that are exchanged


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write all figures."""
    parser = options(__doc__, "updating.csv", recordings=False)
    parser.add_argument("--shared", type=Path, help="folder with recordings/")
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--only", nargs="+", default=[*REAL, *SIMULATED])
    chosen = parser.parse_args(arguments)
    names = [name for name in chosen.only if chosen.shared is not None or name not in REAL]
    found = (_updates(name, chosen.shared, chosen.draws) for name in names)
    stream(chosen.output, chain.from_iterable(found))


def _updates(name: str, shared: Path | None, draws: int) -> Iterator[Figure]:
    if name in REAL and shared is not None:
        recording = anisomap.read(shared / "recordings" / f"{name}.npz")
    else:
        recording = simulate(name, "rubbing", n_frames=_FRAMES, seed=SEED)
    dimensions = {**REAL, **SIMULATED}[name]
    truth = np.asarray(recording.positions, dtype=np.float64)[:, :dimensions]
    whole = reconstruct(Recording(recording.readings, names=recording.names), dimensions=dimensions)
    measured = (_update(recording, whole, truth, draw) for draw in range(draws))
    yield from figures(name, chain.from_iterable(measured))


def _update(
    recording: Recording, whole: SensorMap, truth: NDArray[np.float64], draw: int
) -> Iterator[Measured]:
    dimensions, spacing = whole.dimensions, median_spacing(truth)
    rng = np.random.default_rng(draw)
    n_sensors, half = recording.n_sensors, recording.n_frames // 2
    fresh = np.sort(rng.choice(n_sensors, n_sensors // 10, replace=False))
    old = np.setdiff1d(np.arange(n_sensors), fresh)
    first = Recording(recording.readings[:half, old], names=tuple(recording.names[i] for i in old))
    readings = np.array(recording.readings[half:])
    second = Recording(readings, names=recording.names)
    made = reconstruct(first, dimensions=dimensions)
    evidence = gather_evidence(first, dimensions=dimensions)
    found = update_map(made, evidence, second)
    updated = _ordered(found.map, recording.names)
    for title, one in (("the update", updated), ("a map of everything", whole)):
        off = align(one.positions, truth).errors / spacing
        yield f"new sensors: RMS error in {title} (spacings)", _rms(off[fresh])
        yield f"all sensors: RMS error in {title} (spacings)", _rms(off)
    apart = align(updated.positions, whole.positions).errors
    unit = median_spacing(whole.positions)
    yield (
        "new sensors: distance between both maps (spacings, median)",
        float(np.median(apart[fresh]) / unit),
    )
    yield "share of unchanged sensors accused", len(found.moved) / len(old)
    known = rng.choice(len(old), _ANCHORS, replace=False)
    if (placement := placed(made, truth[old], known)) is not None:
        carried = _ordered(update_map(placement.map, evidence, second).map, recording.names)
        inside = np.linalg.norm(carried.positions - truth, axis=1) <= carried.errors
        what = f"{_ANCHORS} random anchors, updated: share of new sensors within their error"
        yield what, float(inside[fresh].mean())
    a = int(rng.choice(old))
    far = old[np.linalg.norm(truth[old] - truth[a], axis=1) > _FAR * spacing]
    b = int(rng.choice(far))
    readings[:, [a, b]] = readings[:, [b, a]]
    moved = update_map(made, evidence, Recording(readings, names=recording.names)).moved
    pair = {recording.names[a], recording.names[b]}
    yield (
        f"2 sensors {_FAR} spacings apart or more exchanged: share named",
        len(pair & set(moved)) / 2,
    )
    yield "2 sensors exchanged: share of others accused", len(set(moved) - pair) / len(old)


def _ordered(sensor_map: SensorMap, names: Sequence[str]) -> SensorMap:
    return sensor_map.select([sensor_map.names.index(name) for name in names])


def _rms(lengths: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(lengths**2)))


if __name__ == "__main__":
    main()
