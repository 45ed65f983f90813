"""Power and false alarms of `anisomap.check_layout`, on recordings with seeded faults.

The layout of each recording is first checked as it is, and corrected by what was found, which is
printed. Then faults of every kind are seeded at 1, 5 and 10 % of the sensors, one kind at a time,
and the result is scored: faults found (more than half of their wrong sensors accused), faults
placed (4 of 5 of their wrong sensors within half a spacing of the right places; 1.5 spacings for
moved patches, which have no place of their own to be assigned to), and right sensors accused.
Sensors that are not tested are neither.
Everything is repeated with the first half of the frames. Faults are drawn from seeds that were not
used for tuning (1 to 300 were).

Usage: ``python -m benchmarks.accuracy.check RECORDING... -o docs/results/check.csv --table
docs/check-table.md``. Scores of other recordings in the CSV file are kept; without a recording,
only the table is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

import anisomap
from anisomap.layout import LayoutCheck, check_layout, module_members
from anisomap.layout.checking import NOT_TESTED
from anisomap.numerics.layout.chance import reading_statistics
from anisomap.numerics.layout.congruence import congruent, symmetries
from anisomap.numerics.layout.evidence import neighbour_spacing
from benchmarks.harness import frame, keyed_table, options, quietly, read_rows, write_rows

FIRST_SEED = 1001
SHARES = (0.01, 0.05, 0.1)
MIN_SWAPPED = 3.0  # spacings
MIN_RUN = 8  # sensors of a shifted cable
MIN_PATCH = 4
MOVED = (4.0, 10.0)  # spacings
Points = NDArray[np.float64]
Groups = list[NDArray[np.intp]]


@dataclass(frozen=True, eq=False)
class Skin:
    """Right positions, and the modules on them."""

    positions: Points
    spacing: float
    members: Groups


@dataclass(frozen=True)
class Result:
    """Score of one check."""

    recording: str
    n_frames: int
    kind: str
    share: float
    seed: int
    faults: int
    found: int
    placed: int
    wrong_sensors: int
    right_sensors: int
    right_accused: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Check all recordings, write the scores and print a summary."""
    parser = options(__doc__, "check.csv", seeds=5, recordings=False)
    parser.add_argument("recordings", type=Path, nargs="*", help="NPZ files with positions")
    parser.add_argument("--kinds", nargs="+", choices=(*LAYOUT_FAULTS, *READING_FAULTS))
    parser.add_argument("--table", type=Path, help="file for a summary in Markdown")
    chosen = parser.parse_args(arguments)
    kinds = chosen.kinds or (*LAYOUT_FAULTS, *READING_FAULTS)
    renewed = {path.stem for path in chosen.recordings}
    results = [r for r in read_rows(chosen.output, Result) if r.recording not in renewed]
    with quietly():
        for path in chosen.recordings:
            for result in checks(path, kinds, range(FIRST_SEED, FIRST_SEED + chosen.seeds)):
                results.append(result)
                write_rows(chosen.output, results)
    text = "\n".join(table(results))
    if chosen.table:
        chosen.table.write_text(text + "\n", encoding="utf-8")
    print(text)


def checks(path: Path, kinds: Sequence[str], seeds: range) -> Iterator[Result]:
    """Score checks of one recording: all frames and half of them, every kind, share and seed."""
    whole = anisomap.read(path)
    layout = anisomap.SensorMap(np.asarray(whole.positions), names=whole.names, units=whole.units)
    corrected = None
    for n_frames in (whole.n_frames, whole.n_frames // 2):
        recording = replace(whole, readings=whole.readings[:n_frames], times=None)
        # The correlations, most of the work, are the same for every stated layout.
        statistics = reading_statistics(recording.readings, np.random.default_rng(0))
        untouched = check_layout(layout, recording, statistics=statistics)
        print(f"{path.stem}, {n_frames} frames, untouched: {untouched}")
        for finding in untouched.findings:
            print(f"  {finding.kind}: {finding.explanation}")
        corrected = corrected or untouched.corrected
        positions = corrected.positions
        skin = Skin(positions, neighbour_spacing(positions), module_members(corrected))
        for kind in kinds:
            for share in SHARES:
                rows = []
                for seed in seeds if kind in LAYOUT_FAULTS else seeds[:1]:
                    rng = np.random.default_rng(seed)
                    if kind in LAYOUT_FAULTS:
                        stated, groups = LAYOUT_FAULTS[kind](skin, share, rng)
                        found = check_layout(
                            replace(corrected, positions=stated), recording, statistics=statistics
                        )
                        counts = score_places(found, skin, groups, kind)
                    else:
                        spoilt, groups = READING_FAULTS[kind](recording, share, rng)
                        found = check_layout(corrected, spoilt)
                        counts = score_sensors(found, groups)
                    rows.append(Result(path.stem, n_frames, kind, share, seed, *counts))
                    yield rows[-1]
                print(" ", *cells(frame(rows)).values(), flush=True)


def score_places(
    found: LayoutCheck, skin: Skin, groups: Groups, kind: str
) -> tuple[int, int, int, int, int, int]:
    """Count faults, those found and placed, and wrong and right sensors; and accused right ones."""
    tested = np.array(found.status) != NOT_TESTED
    wrong = (found.layout.positions != skin.positions).any(axis=1) & tested
    tolerance = (1.5 if kind == "moved" else 0.5) * skin.spacing
    right = np.linalg.norm(found.corrected.positions - skin.positions, axis=1) <= tolerance
    faults = [group[wrong[group]] for group in groups if wrong[group].any()]
    accused = [bool(found.accused[group].mean() > 0.5) for group in faults]
    placed = [bool(right[group].mean() >= 0.8) for group in faults]
    return (
        len(faults),
        sum(accused),
        sum(placed),
        int(wrong.sum()),
        *_of_right(found, tested & ~wrong),
    )


def score_sensors(found: LayoutCheck, groups: Groups) -> tuple[int, int, int, int, int, int]:
    """Count faulty sensors, those found (each is one fault), and accused right ones.

    Of a sensor and its copy, either may be accused.
    """
    accused = [bool(found.accused[group].any()) for group in groups]
    right = np.ones(len(found.accused), dtype=bool)
    right[np.concatenate(groups)] = False
    n_found = sum(accused)
    return len(groups), n_found, n_found, len(groups), *_of_right(found, right)


def _of_right(found: LayoutCheck, right: NDArray[np.bool_]) -> tuple[int, int]:
    return int(right.sum()), int((found.accused & right).sum())


def cycle(
    skin: Skin, share: float, rng: np.random.Generator, most: int = 5
) -> tuple[Points, Groups]:
    """Permute 3 to `most` sensors that are 3 spacings apart and more; 2 exchanges pairs."""
    stated = skin.positions.copy()
    distances = cdist(stated, stated) / skin.spacing
    free = np.ones(len(stated), dtype=bool)
    groups: Groups = []
    wanted = max(2, round(share * len(stated)))
    while sum(map(len, groups)) < wanted:
        chosen = [int(rng.choice(np.flatnonzero(free)))]
        length = int(rng.integers(3, most + 1)) if most > 2 else 2
        while len(chosen) < length:
            far = free & (distances[chosen] >= MIN_SWAPPED).all(axis=0)
            chosen.append(int(rng.choice(np.flatnonzero(far))))
        group = np.array(chosen)
        stated[group] = skin.positions[np.roll(group, 1)]
        free[group] = False
        groups.append(group)
    return stated, groups


def shifted(skin: Skin, share: float, rng: np.random.Generator) -> tuple[Points, Groups]:
    """Give each of a run of consecutive sensors the place of the next, or of the previous."""
    n_sensors = len(skin.positions)
    length = max(MIN_RUN, round(share * n_sensors))
    start = int(rng.integers(0, n_sensors - length + 1))
    run = np.arange(start, start + length)
    stated = skin.positions.copy()
    stated[run] = skin.positions[np.roll(run, int(rng.choice((-1, 1))))]
    return stated, [run]


def turned(
    skin: Skin, share: float, rng: np.random.Generator, *, reflected: bool = False
) -> tuple[Points, Groups]:
    """Rotate modules on their own places, or reflect them."""
    stated = skin.positions.copy()
    groups: Groups = []
    for k in rng.permutation(len(skin.members)):
        inside = skin.members[k]
        images = [s.order for s in symmetries(stated[inside]) if s.reflected == reflected]
        if images:
            stated[inside] = skin.positions[inside][images[int(rng.integers(len(images)))]]
            groups.append(inside)
        if sum(map(len, groups)) >= share * len(stated):
            break
    return stated, groups


def exchanged(skin: Skin, share: float, rng: np.random.Generator) -> tuple[Points, Groups]:
    """Exchange pairs of modules of one shape, each rotated at random."""
    stated = skin.positions.copy()
    groups: Groups = []
    left = [skin.members[k] for k in rng.permutation(len(skin.members))]
    while left and sum(map(len, groups)) < share * len(stated):
        one = left.pop()
        shape = skin.positions[one]
        alike = [k for k, other in enumerate(left) if congruent(shape, skin.positions[other])]
        if not alike:
            continue
        other = left.pop(alike[0])
        for sensors, slot in ((one, other), (other, one)):
            places = skin.positions[slot]
            turns = [s.order for s in symmetries(places) if not s.reflected]
            orders = [np.arange(len(slot)), *turns]
            stated[sensors] = places[orders[int(rng.integers(len(orders)))]]
            groups.append(sensors)
    return stated, groups


def moved(skin: Skin, share: float, rng: np.random.Generator) -> tuple[Points, Groups]:
    """Translate a patch of neighbouring sensors by 4 to 10 spacings, in any direction."""
    n_sensors, dimensions = skin.positions.shape
    count = max(MIN_PATCH, round(share * n_sensors))
    centre = skin.positions[int(rng.integers(n_sensors))]
    patch = np.argsort(np.linalg.norm(skin.positions - centre, axis=1))[:count]
    direction = rng.normal(size=dimensions)
    length = rng.uniform(*MOVED) * skin.spacing
    stated = skin.positions.copy()
    stated[patch] += length * direction / np.linalg.norm(direction)
    return stated, [patch]


def dead(
    recording: anisomap.Recording, share: float, rng: np.random.Generator
) -> tuple[anisomap.Recording, Groups]:
    """Set sensors to a constant."""
    sensors = _some(recording.n_sensors, share, rng)
    readings = np.array(recording.readings)
    readings[:, sensors] = 0
    return replace(recording, readings=readings), [np.array([i]) for i in sensors]


def doubled(
    recording: anisomap.Recording, share: float, rng: np.random.Generator
) -> tuple[anisomap.Recording, Groups]:
    """Replace the readings of sensors by those of others."""
    sensors = _some(recording.n_sensors, share, rng)
    sources = rng.choice(np.setdiff1d(np.arange(recording.n_sensors), sensors), len(sensors), False)
    readings = np.array(recording.readings)
    readings[:, sensors] = recording.readings[:, sources]
    pairs = zip(sensors.tolist(), sources.tolist(), strict=True)
    return replace(recording, readings=readings), [np.array(pair) for pair in pairs]


def _some(n_sensors: int, share: float, rng: np.random.Generator) -> NDArray[np.intp]:
    return rng.choice(n_sensors, max(1, round(share * n_sensors)), replace=False)


LAYOUT_FAULTS: dict[str, Callable[[Skin, float, np.random.Generator], tuple[Points, Groups]]] = {
    "swapped": partial(cycle, most=2),
    "cycle": cycle,
    "shifted": shifted,
    "turned": turned,
    "mirrored": partial(turned, reflected=True),
    "exchanged": exchanged,
    "moved": moved,
}
READING_FAULTS: dict[
    str,
    Callable[[anisomap.Recording, float, np.random.Generator], tuple[anisomap.Recording, Groups]],
] = {"dead": dead, "doubled": doubled}


def table(results: Sequence[Result]) -> list[str]:
    """Return a table in Markdown: one row per recording, number of frames and kind."""
    order = [*LAYOUT_FAULTS, *READING_FAULTS]
    groups = frame(results).groupby(["recording", "n_frames", "kind"])
    ordered = sorted(groups, key=lambda one: (one[0][0], -one[0][1], order.index(one[0][2])))
    lines = (
        {"recording": name, "frames": f"{n_frames:,}", **cells(rows)}
        for (name, n_frames, _), rows in ordered
    )
    return [*keyed_table(lines)]


def cells(rows: Any) -> dict[str, object]:
    """Return the cells of some results, a data frame, taken together."""
    low, high = rows.share.min(), rows.share.max()
    faults = rows.faults.sum()
    accused = rows.right_accused.sum() / max(1, rows.right_sensors.sum())
    return {
        "fault": rows.kind.iloc[0],
        "share": f"{low:.0%}" if low == high else f"{low:.0%} to {high:.0%}",
        "faults": faults,
        **{name: f"{rows[name].sum() / max(1, faults):.1%}" for name in ("found", "placed")},
        "right sensors accused": f"{accused:.2%}",
    }


if __name__ == "__main__":
    main()
