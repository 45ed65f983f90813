"""Calibration of the ellipses of maps (``make uncertainty``).

Several recordings of each simulated skin are mapped. For each map, the best guess of where it would
be without chance is the mean of the maps of the other recordings: the ellipses of 95 % should hold
95 % of the positions of that mean. Real skins have one recording; its halves, of alternating
twentieths of the frames, are mapped, and the difference of both maps is compared with the sum of
both covariances. Ellipses were tuned on seeds 201 to 212; other seeds are used here.

The rival is the idea of ``bootmds`` of R's smacof (Jacoby & Armstrong 2014,
doi:10.1111/ajps.12056): metric MDS of ``sqrt(1 - r)`` for resamples of single frames, aligned by
Procrustes, and the covariance of their positions. It is judged by the mean of its own maps.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap.covariance_ellipses import radius
from anisomap.diagnosis.diagnostics import estimate_uncertainty
from anisomap.evaluation import median_spacing
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.reliability.split_half import split_blocks
from anisomap.numerics.scaling.multidimensional_scaling import smacof
from anisomap.numerics.similarity.correlation import pearson
from benchmarks.harness import files_in, heading, line, options, quietly, write_rows

SKINS = (
    ("sphere", "bombardment"),
    ("y-shape", "bombardment"),
    ("sphere", "locomotion"),
    ("cube", "rubbing"),
    ("torus", "rubbing"),
)
FIRST_SEED, SEEDS = 501, 5
FRAMES = 1000
OURS, RIVAL = "blocks", "bootmds"
N_RIVAL = 40
"""Resamples of the rival."""

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Judged:
    """One map: its error by chance, what was expected, and the share inside its ellipses."""

    recording: str
    n_frames: int
    method: str
    error: float
    expected: float
    inside: float
    seconds_of_map: float
    seconds: float


@dataclass(frozen=True)
class _Made:
    """A map with its covariances, and the time that both took."""

    positions: Points
    covariances: Points
    seconds_of_map: float
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings, and write the table and all results."""
    parser = options(__doc__, "uncertainty", seeds=SEEDS, first_seed=FIRST_SEED)
    parser.add_argument("--frames", type=int, default=FRAMES)
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    results: list[Judged] = []
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    with quietly():
        for skin in (*(SKINS if seeds else ()), *files_in(chosen.recordings)):
            results += (
                judge_recording(skin)
                if isinstance(skin, Path)
                else judge_skin(skin[0], skin[1], chosen.frames, seeds)
            )
            print(skin, flush=True)
            # An interrupted run leaves what it has.
            text = table(results)
            (chosen.output / "uncertainty-table.md").write_text(text, encoding="utf-8")
            write_rows(chosen.output / "uncertainty.csv", results)
    print(table(results))


def judge_skin(body: str, scenario: str, n_frames: int, seeds: Sequence[int]) -> Iterator[Judged]:
    """Judge the maps of several recordings of a simulated skin by the mean of the others."""
    runs = [anisomap.simulate(body, scenario, n_frames=n_frames, seed=seed) for seed in seeds]
    truth = np.asarray(runs[0].positions)
    for method, make in ((OURS, blocks), (RIVAL, bootmds)):
        made = [found for run in runs if (found := make(run, 3)) is not None]
        aligned = np.array([_aligned(one.positions, truth) for one in made])
        for i, one in enumerate(made):
            others = np.delete(aligned, i, axis=0)
            # The mean of n other maps has errors itself, of a variance of 1 / n.
            factor = 1 / math.sqrt(1 + 1 / len(others))
            error = factor * (_aligned(others.mean(axis=0), one.positions) - one.positions)
            yield _judged(f"{body}, {scenario}", n_frames, method, one, error)


def judge_recording(path: Path) -> Iterator[Judged]:
    """Judge the maps of the halves of a real recording by each other."""
    recording = anisomap.read(path)
    positions = np.asarray(recording.positions)
    dimensions = 2 if positions.shape[1] == 2 or np.ptp(positions[:, 2]) == 0 else 3
    halves = [
        anisomap.Recording(recording.readings[frames])
        for frames in split_blocks(recording.n_frames)
    ]
    kept = np.logical_and(*(half.varying() for half in halves))
    for method, make in ((OURS, blocks), (RIVAL, bootmds)):
        first, second = (make(half.select(kept), dimensions) for half in halves)
        if first is None or second is None:
            continue
        fit = fit_similarity(second.positions, first.positions)
        error = fit.apply(second.positions) - first.positions
        turn = fit.scale * fit.rotation
        both = first.covariances + turn @ second.covariances @ turn.T
        # Half of the sum of both covariances is that of one map, as is the error over sqrt(2).
        one = replace(first, covariances=both / 2)
        yield _judged(path.stem, recording.n_frames // 2, method, one, error / math.sqrt(2))


def blocks(recording: anisomap.Recording, dimensions: int) -> _Made | None:
    """Map a recording by the default method, with covariances; None if not all are known."""
    begun = time.process_time()
    made = anisomap.reconstruct(recording, dimensions=dimensions)
    mapped = time.process_time()
    found = estimate_uncertainty(made, recording)[0]
    ended = time.process_time()
    if found is None or not np.isfinite(found).all():
        return None
    return _Made(made.positions, found, mapped - begun, ended - mapped)


def bootmds(recording: anisomap.Recording, dimensions: int) -> _Made:
    """Map a recording as ``smacof::bootmds`` does, with the covariances of its resamples."""
    rng = np.random.default_rng(0)
    readings = np.asarray(recording.readings, dtype=np.float64)

    def scaled(frames: NDArray[np.float64], start: Points | None = None) -> Points:
        distances = np.sqrt(np.maximum(1 - pearson(frames), 1e-6))
        np.fill_diagonal(distances, 0)
        return np.asarray(smacof(distances, dimensions=dimensions, start=start).positions)

    begun = time.process_time()
    positions = scaled(readings)
    mapped = time.process_time()
    drawn = rng.integers(0, len(readings), (N_RIVAL, len(readings)))
    maps = np.array([scaled(readings[frames], positions) for frames in drawn])
    aligned = np.array([_aligned(one, positions) for one in maps])
    deviations = aligned - aligned.mean(axis=0)
    found = np.einsum("rni,rnj->nij", deviations, deviations) / (N_RIVAL - 1)
    return _Made(positions, found, mapped - begun, time.process_time() - mapped)


def table(results: Sequence[Judged]) -> str:
    """Return a table of the ellipses of each skin, and of all."""
    header = ["skin", "frames", "maps", "error", "expected", "inside", "bootmds: error"]
    header += ["expected", "inside"]
    lines = heading(header)
    for name in [*dict.fromkeys(result.recording for result in results), ""]:
        chosen = [result for result in results if name in ("", result.recording)]
        ours, rival = ([r for r in chosen if r.method == m] for m in (OURS, RIVAL))
        if not ours:
            continue
        figures = [
            f"{value:{form}}"
            for group in (ours, rival)
            for value, form in (
                (_rms(r.error for r in group), ".2f"),
                (_rms(r.expected for r in group), ".2f"),
                (float(np.mean([r.inside for r in group])), ".0%"),
            )
        ]
        frames = str(ours[0].n_frames) if name else ""
        lines.append(line([name or "**all**", frames, str(len(ours)), *figures]))
    ours = [result for result in results if result.method == OURS]
    ratio = np.median([result.seconds / result.seconds_of_map for result in ours])
    lines += ["", f"The covariances take {ratio:.1f} times as long as the map (median, one core)."]
    return "\n".join(lines) + "\n"


def _judged(name: str, n_frames: int, method: str, made: _Made, error: Points) -> Judged:
    spread = made.covariances
    spacing = median_spacing(made.positions)
    ridge = 1e-9 * np.trace(spread, axis1=1, axis2=2).mean() * np.eye(spread.shape[1])
    distances = np.einsum("ni,nij,nj->n", error, np.linalg.inv(spread + ridge), error)
    return Judged(
        recording=name,
        n_frames=n_frames,
        method=method,
        error=math.sqrt(np.square(error).sum(axis=1).mean()) / spacing,
        expected=math.sqrt(np.trace(spread, axis1=1, axis2=2).mean()) / spacing,
        inside=float(np.mean(distances < radius(error.shape[1]) ** 2)),
        seconds_of_map=made.seconds_of_map,
        seconds=made.seconds,
    )


def _aligned(source: Points, target: Points) -> Points:
    return fit_similarity(source, target).apply(source)


def _rms(values: Iterator[float]) -> float:
    found = np.array(list(values))
    return float(np.sqrt(np.mean(found**2))) if found.size else math.nan


if __name__ == "__main__":
    main()
