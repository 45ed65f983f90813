"""Frames that a coached hand saves: ``python -m benchmarks.coach -o coach``.

A simulated palm rubs a body in bouts of 2 s. Coached, it rubs the first place that the coach of
`anisomap live` names; blind, it is set down anywhere. The errors of the quick maps of both are
compared at several numbers of frames. Lifting the hand between bouts takes the same time in both.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.evaluation import median_spacing, score
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.health.touch_coverage import ENOUGH_CONTACTS
from anisomap.live.mapping import QuickMapper
from anisomap.live.sources.simulated import BOUT_FRAMES
from anisomap.live.statistics import TouchStatistics
from anisomap.sensor_map import SensorMap
from anisomap.simulation import Body, find_body
from anisomap.simulation.kinematic.guided import GuidedHand
from anisomap.simulation.kinematic.rubbing import RubbingOptions
from anisomap.simulation.options import options_for

BODIES = ("sphere", "hand", "hexagon")
DIMENSIONS = {"hexagon": 2}  # the others are bodies in 3D
SEEDS = range(401, 411)
LENGTHS = (80, 120, 160, 240, 320, 480, 640, 960)
STIMULI = ("palm", "fingertip")
WAYS = ("coached", "blind")
FINGERTIP = 0.3  # x the size of the palm of `RubbingOptions`: it touches a few sensors at once


@dataclass(frozen=True)
class Row:
    """Error of a map.

    Attributes
    ----------
    body, stimulus, way : str
    seed, n_frames : int
    error : float
        RMS error in spacings: see `error_of`.
    touched : float
        Share of the sensors touched.
    """

    body: str
    stimulus: str
    way: str
    seed: int
    n_frames: int
    error: float
    touched: float


def rows_of(body: Body, dimensions: int, stimulus: str, way: str, *, seed: int) -> list[Row]:
    """Rub a body in one way, and map it at several numbers of frames."""
    chosen = options_for(RubbingOptions, body)
    factor = {"palm": 1.0, "fingertip": FINGERTIP}[stimulus]
    size, depth = factor * chosen.hand_size, factor * chosen.press_depth
    options = replace(chosen, hand_size=size, press_depth=depth)
    hand = GuidedHand(body, options, np.random.default_rng(seed))
    statistics = TouchStatistics(body.n_sensors)
    mapper = QuickMapper(body.names, dimensions)
    where: tuple[int, ...] = ()
    found = []
    while statistics.n_frames < max(LENGTHS):
        few = np.minimum(statistics.contacts, ENOUGH_CONTACTS) if way == "coached" else None
        bout = hand.rub(BOUT_FRAMES, where, few)
        statistics.add(bout.astype(np.float64))
        made = mapper.make(statistics)
        if way == "coached":
            where = made.advice.next_sensors
        if statistics.n_frames in LENGTHS:
            error, touched = error_of(made.positions, body), float(statistics.touched.mean())
            found.append(Row(body.name, stimulus, way, seed, statistics.n_frames, error, touched))
    return found


def error_of(positions: NDArray[np.float64], body: Body) -> float:
    """Return the RMS error of a map in spacings.

    A sensor without a place counts as one in the middle of the body.
    """
    centred = body.positions - body.positions.mean(axis=0)
    squares = (centred**2).sum(axis=1) / median_spacing(body.positions) ** 2
    if np.isfinite(positions).all(axis=1).sum() > MIN_SENSORS_COMPARED:
        found = score(SensorMap(positions), body.positions, permutations=0)
        squares[found.sensors] = (found.alignment.errors / found.spacing) ** 2
    return float(np.sqrt(squares.mean()))


def frames_to(rows: Sequence[Row], goal: float) -> float:
    """Return the number of frames after which the median error stays at or below a goal."""
    lengths = sorted({row.n_frames for row in rows})
    medians = [np.median([row.error for row in rows if row.n_frames == n]) for n in lengths]
    below = [n for i, n in enumerate(lengths) if max(medians[i:]) <= goal]
    return below[0] if below else float("nan")


def frames_to_all(rows: Sequence[Row]) -> float:
    """Return the number of frames after which half of the runs or more touched every sensor."""
    lengths = sorted({row.n_frames for row in rows})
    medians = [np.median([row.touched for row in rows if row.n_frames == n]) for n in lengths]
    return next((n for n, share in zip(lengths, medians, strict=True) if share == 1), float("nan"))


def summary(rows: Sequence[Row]) -> list[dict[str, object]]:
    """Compare the frames that both ways take to the error that the blind one ends with."""
    found: list[dict[str, object]] = []
    longest = max(row.n_frames for row in rows)
    for body, stimulus in dict.fromkeys((row.body, row.stimulus) for row in rows):
        chosen = [row for row in rows if (row.body, row.stimulus) == (body, stimulus)]
        ways = {way: [row for row in chosen if row.way == way] for way in WAYS}
        goal = float(np.median([row.error for row in ways["blind"] if row.n_frames == longest]))
        frames = {way: frames_to(ways[way], goal) for way in WAYS}
        found.append(
            {
                "body": body,
                "stimulus": stimulus,
                "goal_in_spacings": round(goal, 3),
                **{f"frames_{way}": frames[way] for way in WAYS},
                "ratio": round(frames["coached"] / frames["blind"], 2),
                **{f"frames_all_touched_{way}": frames_to_all(ways[way]) for way in WAYS},
            }
        )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write the rows, the summary and the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("coach"))
    parser.add_argument("--seeds", type=int, nargs="*", default=list(SEEDS))
    parser.add_argument("--bodies", nargs="*", default=list(BODIES))
    parser.add_argument("--read", type=Path, nargs="*", help="rows of earlier runs, to be joined")
    given = parser.parse_args(arguments)
    given.output.mkdir(exist_ok=True)
    rows = [row for path in given.read or () for row in read(path)]
    for name in () if rows else given.bodies:
        body, dimensions = find_body(name), DIMENSIONS.get(name, 3)
        for stimulus, way, seed in itertools.product(STIMULI, WAYS, given.seeds):
            rows += rows_of(body, dimensions, stimulus, way, seed=seed)
    write(given.output / "coach.csv", [vars(row) for row in rows])
    results = summary(rows)
    write(given.output / "coach-summary.csv", results)
    for result in results:
        print(result)
    draw(rows, given.output / "coach.png")


def read(path: Path) -> list[Row]:
    """Read rows from CSV."""
    with path.open(encoding="utf-8") as stream:
        return [
            Row(
                row["body"],
                row["stimulus"],
                row["way"],
                int(row["seed"]),
                int(row["n_frames"]),
                float(row["error"]),
                float(row["touched"]),
            )
            for row in csv.DictReader(stream)
        ]


def write(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """Write rows as CSV."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the median error over frames, with quartiles."""
    from matplotlib.figure import Figure  # noqa: PLC0415 (takes a second)

    bodies = list(dict.fromkeys(row.body for row in rows))
    figure = Figure(figsize=(3.2 * len(bodies), 5.6), layout="constrained")
    axes = figure.subplots(len(STIMULI), len(bodies), sharex=True, sharey="col", squeeze=False)
    looks = {"coached": ("#0b5394", "-", "o"), "blind": ("#b35000", "--", "s")}
    lengths = sorted({row.n_frames for row in rows})
    for (i, stimulus), (j, body) in itertools.product(enumerate(STIMULI), enumerate(bodies)):
        ax = axes[i, j]
        for way, (colour, line, mark) in looks.items():
            chosen = [r for r in rows if (r.body, r.stimulus, r.way) == (body, stimulus, way)]
            errors = np.array([[r.error for r in chosen if r.n_frames == n] for n in lengths])
            low, middle, high = np.quantile(errors, (0.25, 0.5, 0.75), axis=1)
            ax.plot(lengths, middle, line, marker=mark, color=colour, label=way, markersize=4)
            ax.fill_between(lengths, low, high, color=colour, alpha=0.15)
        ax.set(title=f"{body}, {stimulus}", xscale="log", ylim=(0, None))
        ax.set_xticks(lengths[::2], [str(n) for n in lengths[::2]])
        ax.minorticks_off()
    for ax in axes[-1]:
        ax.set_xlabel("frames")
    for ax in axes[:, 0]:
        ax.set_ylabel("RMS error (spacings)")
    axes[0, 0].legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
