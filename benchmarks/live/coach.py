"""Frames that a coached hand saves: ``python -m benchmarks.live.coach -o coach``.

A simulated palm or fingertip rubs a body. Coached, it rubs in bouts of 2 s the first place that the
coach of `anisomap live` names, and its strokes lead to sensors that were never touched; it is off
the skin for 0.3 s before each bout. Uncoached, it rubs without a pause as in the scenario
"rubbing", in which strokes lead to the parts that were rubbed least, as of a person who remembers
them. The errors of the quick maps of both are compared at several numbers of frames.

Rows are written as they are made.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from anisomap.evaluation import median_spacing, score
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.live.quick_map import QuickMapper
from anisomap.live.sources import BOUT_FRAMES
from anisomap.sensor_map import SensorMap
from anisomap.simulation import Body, find_body
from anisomap.simulation.kinematic import TRAVEL_FRAMES, GuidedHand, RubbingOptions
from anisomap.simulation.options import options_for
from benchmarks.harness import frame, options, stream, write_rows

BODIES = ("sphere", "hand", "hexagon")
DIMENSIONS = {"hexagon": 2}  # the others are bodies in 3D
SEEDS = range(401, 411)
LENGTHS = (80, 120, 160, 200, 240, 280, 320, 400, 480, 560, 640, 800, 960)
TICKS = (80, 160, 320, 640)  # of the figure
STIMULI = ("palm", "fingertip")
WAYS = ("coached", "uncoached")
FINGERTIP = 0.3  # x the size of the palm of `RubbingOptions`: it touches a few sensors at once


@dataclass(frozen=True)
class Row:
    """Error of a map.

    error: RMS error in spacings: see `error_of`.
    touched: Share of the sensors touched.
    """

    body: str
    stimulus: str
    way: str
    seed: int
    n_frames: int
    error: float
    touched: float


def rows_of(name: str, stimulus: str, seed: int, way: str) -> Iterator[Row]:
    """Rub a body in one way, and map it at several numbers of frames."""
    body = find_body(name)
    hand = hand_on(body, stimulus, seed)
    mapper = QuickMapper(body.names, DIMENSIONS.get(name, 3))
    path = uncoached(hand, max(LENGTHS)) if way == "uncoached" else np.empty((0, 0), np.float32)
    where: tuple[int, ...] = ()
    touched = np.zeros(body.n_sensors, dtype=bool)
    while (n_frames := mapper.sample.n_frames) < max(LENGTHS):
        if way == "uncoached":
            part = path[n_frames : n_frames + BOUT_FRAMES]
        else:
            part = hand.rub(BOUT_FRAMES, where, touched.astype(np.intp))
        mapper.add(part.astype(np.float64))
        if way == "uncoached" and mapper.sample.n_frames not in LENGTHS:
            continue
        made = mapper.make()
        where, touched = made.advice.next_sensors, made.contacts > 0
        if made.n_frames in LENGTHS:
            error, share = error_of(made.positions, body), float(touched.mean())
            yield Row(name, stimulus, way, seed, made.n_frames, error, share)


def hand_on(body: Body, stimulus: str, seed: int) -> GuidedHand:
    """Return a hand of the size of a stimulus."""
    chosen = options_for(RubbingOptions, body)
    factor = {"palm": 1.0, "fingertip": FINGERTIP}[stimulus]
    size, depth = factor * chosen.hand_size, factor * chosen.press_depth
    resized = replace(chosen, hand_size=size, press_depth=depth)
    return GuidedHand(body, resized, np.random.default_rng(seed))


def uncoached(hand: GuidedHand, n_frames: int) -> NDArray[np.float32]:
    """Rub along one path; the hand is on the skin from the first frame on."""
    return hand.rub(TRAVEL_FRAMES + n_frames)[TRAVEL_FRAMES:]


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


def frames_until(reached: Any) -> float:
    """Return the number of frames from which on a goal is reached, a series by this number."""
    lasting = reached.index[reached[::-1].cummin()[::-1]]
    return int(lasting[0]) if len(lasting) else float("nan")


@dataclass(frozen=True)
class Goal:
    """Frames that both ways take to a goal, which is an error in spacings or none."""

    body: str
    stimulus: str
    goal: str
    spacings: float | str
    coached: float
    uncoached: float
    ratio: float


def summary(rows: Sequence[Row]) -> list[Goal]:
    """Compare the frames after which half of the runs of both ways have reached a goal.

    The goals are to touch every sensor, an error of 1 spacing, and the error that the uncoached
    hand ends with.
    """
    found: list[Goal] = []
    medians = frame(rows).groupby(["body", "stimulus", "way", "n_frames"])[["error", "touched"]]
    medians = medians.median()
    for body, stimulus in dict.fromkeys((row.body, row.stimulus) for row in rows):
        ways = [medians.loc[body, stimulus, way] for way in WAYS]
        last = float(ways[1].error.iloc[-1])
        for goal, spacings, reached in (
            ("every sensor touched", "", [way.touched == 1 for way in ways]),
            ("error of 1 spacing", 1.0, [way.error <= 1 for way in ways]),
            ("last error", round(last, 3), [way.error <= last for way in ways]),
        ):
            coached, uncoached = map(frames_until, reached)
            ratio = round(coached / uncoached, 2)
            found.append(Goal(body, stimulus, goal, spacings, coached, uncoached, ratio))
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write the rows, the summary and the figure."""
    parser = options(__doc__, "coach", recordings=False)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(SEEDS))
    parser.add_argument("--bodies", nargs="*", default=list(BODIES))
    given = parser.parse_args(arguments)
    runs = itertools.product(given.bodies, STIMULI, given.seeds, WAYS)
    found = itertools.chain.from_iterable(rows_of(*run) for run in runs)
    rows = stream(given.output / "coach.csv", found)
    results = summary(rows)
    write_rows(given.output / "coach-summary.csv", results)
    print(*results, sep="\n")
    draw(rows, given.output / "coach.png")


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the median error over frames, with quartiles."""
    bodies = list(dict.fromkeys(row.body for row in rows))
    figure = Figure(figsize=(3.2 * len(bodies), 5.6), layout="constrained")
    axes = figure.subplots(len(STIMULI), len(bodies), sharex=True, sharey="col", squeeze=False)
    looks = {"coached": ("#0b5394", "-", "o"), "uncoached": ("#b35000", "--", "s")}
    every = frame(rows).groupby(["body", "stimulus", "way", "n_frames"]).error
    quartiles = every.quantile([0.25, 0.5, 0.75]).unstack()
    for (i, stimulus), (j, body) in itertools.product(enumerate(STIMULI), enumerate(bodies)):
        ax = axes[i, j]
        for way, (colour, line, mark) in looks.items():
            errors = quartiles.loc[body, stimulus, way]
            low, middle, high = (errors[share] for share in errors)
            lengths = errors.index
            ax.plot(lengths, middle, line, marker=mark, color=colour, label=way, markersize=4)
            ax.fill_between(lengths, low, high, color=colour, alpha=0.15)
        ax.set(title=f"{body}, {stimulus}", xscale="log")
        ax.set_xticks(TICKS, [str(n) for n in TICKS])
        ax.minorticks_off()
    for ax in axes[-1]:
        ax.set(xlabel="frames", ylim=(0, None))  # of the column
    for ax in axes[:, 0]:
        ax.set_ylabel("RMS error (spacings)")
    axes[0, 0].legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
