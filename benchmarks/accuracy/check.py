"""How well `anisomap.check_layout` names seeded faults: real layouts of triangles, thinned frames.

The layout of each recording is checked as it is, with all frames, and corrected by what was found,
which is printed. Then the corrected layout is spoilt by each of `FAULTS` and checked against every
frame, every fourth and every sixteenth. Counted are wrong modules that are named (half of their
displaced sensors are flagged, or more), wrong modules that are corrected (to half a spacing in the
median), and right modules of which any sensor is flagged; for exchanged sensors, sensors.

Usage: ``python -m benchmarks.accuracy.check RECORDING=LAYOUT ... --template TRIANGLE -o
docs/results/check.csv --table docs/development/check-table.md``. Scores of other recordings and of
other thinnings in the CSV file are kept; without a recording, only the table is written.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.stats import beta

import anisomap
from anisomap.layout import LayoutCheck, check_layout, find_modules, reading_statistics
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement import Modules
from benchmarks.harness import frame, keyed_table, options, quietly, read_rows, write_rows

THINNED = (1, 4, 16)
PATCH = 5  # modules
SHIFT = (3.0, 8.0)  # spacings of pads by which a patch is shifted
WRONG = 0.05  # of the sensors
TRIES = 300
IN_THE_WAY = 0.1  # share of the pads of a patch that may come nearer to others than GAP
GAP = 0.6  # of the spacing of pads
REACH = 2.6  # spacings of pads up to which a patch borders on others
BOARD = 16  # modules
SIZE = 12  # channels of a module
ENOUGH = 10  # contacts of the median sensor
Points = NDArray[np.float64]
Placed = dict[int, Points]
"""Stated places of wrong modules; of wrong sensors, one each."""


@dataclass(frozen=True)
class Result:
    """Score of one check.

    contacts: Median number of contacts of a sensor.
    """

    recording: str
    layout: str
    dimensions: int
    thinned: int
    contacts: int
    kind: str
    seed: int
    wrong: int
    named: int
    corrected: int
    right: int
    flagged: int
    verdict: str
    seconds: float


@dataclass(frozen=True)
class Skin:
    """A right layout of rigid modules.

    members: Sensors of each module, by pad.
    flat: Their pads about the middle of the template.
    frames (M, 2, k), origins (M, k): Axes and middle of each module.
    numbers (M,): Of each module, absent ones included.
    """

    positions: Points
    members: list[NDArray[np.intp]]
    flat: list[Points]
    frames: Points
    origins: Points
    numbers: NDArray[np.intp]
    pitch: float

    @classmethod
    def of(cls, layout: anisomap.SensorMap, modules: Modules) -> Skin:
        """Fit the template to the places of each module; pads on other places do not count."""
        template = modules.template[:, :2]
        members, frames, origins = [], [], []
        k = layout.dimensions
        pitch = float(np.median(np.sort(cdist(template, template), axis=1)[:, 1]))
        for m in range(modules.n_modules):
            inside = modules.members(m)
            source = np.pad(template[modules.pads[inside]], ((0, 0), (0, k - 2)))
            places = layout.positions[inside]
            fit = fit_similarity(source, places, scaling=False, reflection=None)
            near = np.linalg.norm(fit.apply(source) - places, axis=1) <= 1.5 * pitch
            members.append(inside[near])
            frames.append(fit.rotation.T[:2])
            origins.append(fit.translation)
        flat = [template[modules.pads[inside]] for inside in members]
        numbers = np.array([int(label.split("-")[0]) // SIZE for label in modules.labels])
        return cls(
            layout.positions, members, flat, np.array(frames), np.array(origins), numbers, pitch,
        )  # fmt: skip

    def places(self, module: int, slot: int, angle: float = 0, hand: int = 1) -> Points:
        """Return the places of a module in a slot, mirrored and turned about the middle."""
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        turned = self.flat[module] * [hand, 1] @ np.array([[cos, sin], [-sin, cos]])
        return np.asarray(turned @ self.frames[slot] + self.origins[slot])

    def near(self, rng: np.random.Generator, count: int) -> list[int]:
        """Return adjacent modules, fewer than the others adjacent to them; none if too few are."""
        apart = cdist(self.origins, self.origins)
        np.fill_diagonal(apart, np.inf)
        graph: Any = csr_array(apart <= 1.5 * np.median(apart.min(axis=1)))
        label = connected_components(graph, directed=False)[1]
        large = np.flatnonzero(np.bincount(label)[label] > 2 * count)
        if not large.size:
            return []
        first = int(rng.choice(large))
        away = np.where(label == label[first], apart[first], np.inf)
        away[first] = 0
        return [int(m) for m in np.argsort(away, kind="stable")[:count]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Check all recordings, write the scores and print a summary."""
    parser = options(__doc__, "check.csv", seeds=2, first_seed=5001, recordings=False)
    parser.add_argument("pairs", nargs="*", help="recordings and their layouts, A.npz=B.csv")
    parser.add_argument("--thinned", type=int, nargs="+", default=THINNED, help="every n-th frame")
    parser.add_argument("--template", type=Path, help="file of the pads of a module")
    parser.add_argument("--table", type=Path, help="file for a summary in Markdown")
    chosen = parser.parse_args(arguments)
    pairs = [tuple(map(Path, pair.split("="))) for pair in chosen.pairs]
    renewed = {(one.stem, layout.stem, n) for one, layout in pairs for n in chosen.thinned}
    results = [
        r
        for r in read_rows(chosen.output, Result)
        if (r.recording, r.layout, r.thinned) not in renewed
    ]
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    with quietly():
        for recording, layout in pairs:
            template = anisomap.read_map(chosen.template)
            for result in checks(recording, layout, template, seeds, chosen.thinned):
                results.append(result)
                write_rows(chosen.output, results, digits=3)
    text = "\n".join(table(results))
    if chosen.table:
        chosen.table.write_text(text + "\n", encoding="utf-8")
    print(text)


def checks(
    path: Path,
    layout_path: Path,
    template: anisomap.SensorMap,
    seeds: range,
    thinnings: Sequence[int],
) -> Iterator[Result]:
    """Score checks of one recording against its layout: all thinnings, faults and seeds."""
    whole = anisomap.read(path)
    stated = anisomap.read_map(layout_path)
    modules = find_modules(stated, SIZE).with_template(template)
    untouched = check_layout(stated, whole, modules=modules)
    print(f"{path.stem} against {layout_path.stem}: {untouched}")
    for finding in untouched.findings:
        print(f"  {finding.kind}: {finding.explanation}")
    right = untouched.corrected
    skin = Skin.of(right, modules)
    for thinned in thinnings:
        part = replace(whole, readings=whole.readings[::thinned], times=None)
        # The correlations, most of the work, are the same for every stated layout.
        statistics = reading_statistics(part.readings, np.random.default_rng(0))
        contacts = int(np.median(part.signals.contacts))
        for (kind, fault), seed in ((one, s) for one in FAULTS.items() for s in seeds):
            placed = fault(skin, np.random.default_rng([seed, thinned, len(kind)]))
            if not placed and kind != "none":
                continue
            spoilt = right.positions.copy()
            singly = kind == "sensors"
            for key, places in placed.items():
                spoilt[key if singly else skin.members[key]] = places
            started = time.process_time()
            found = check_layout(
                replace(right, positions=spoilt), part, modules=modules, statistics=statistics
            )
            seconds = time.process_time() - started
            groups = np.arange(len(spoilt))[:, None] if singly else skin.members
            counts = score(found, right.positions, list(groups), set(placed))
            yield Result(
                path.stem, layout_path.stem, right.dimensions, thinned, contacts, kind, seed,
                *counts, found.verdict, seconds,
            )  # fmt: skip
        print(f"  every {thinned} done", flush=True)


def score(
    found: LayoutCheck, right: Points, groups: list[NDArray[np.intp]], wrong: set[int]
) -> tuple[int, int, int, int, int]:
    """Count wrong modules, those named and corrected; and right modules, and those flagged."""
    named = corrected = flagged = 0
    for m, members in enumerate(groups):
        if m not in wrong:
            flagged += bool(found.flagged[members].any())
            continue
        off = np.linalg.norm(found.layout.positions[members] - right[members], axis=1)
        changed = members[off > found.spacing / 100]
        named += bool(found.flagged[changed].mean() >= 0.5)
        left = np.linalg.norm(found.corrected.positions[members] - right[members], axis=1)
        corrected += bool(np.median(left) <= found.spacing / 2)
    return len(wrong), named, corrected, len(groups) - len(wrong), flagged


def turned(skin: Skin, rng: np.random.Generator, angles: Sequence[float]) -> Placed:
    """Turn one module at its place."""
    m = int(rng.integers(len(skin.members)))
    return {m: skin.places(m, m, float(rng.choice(angles)))}


def mirrored(skin: Skin, rng: np.random.Generator, count: int = 1) -> Placed:
    """Mirror one module at its place, or several that are adjacent."""
    angle = float(rng.choice([0, 120, 240]))
    return {m: skin.places(m, m, angle, -1) for m in skin.near(rng, count)}


def exchanged(skin: Skin, rng: np.random.Generator) -> Placed:
    """Exchange two modules, each turned at random."""
    a, b = (int(m) for m in rng.choice(len(skin.members), 2, replace=False))
    turns = rng.choice([0.0, 120.0, 240.0], 2)
    return {a: skin.places(a, b, turns[0]), b: skin.places(b, a, turns[1])}


def as_one(skin: Skin, rng: np.random.Generator, kind: str) -> Placed:
    """Turn, mirror or shift adjacent modules as one, to beside others, but not in their way."""
    k = skin.positions.shape[1]
    for _ in range(TRIES):
        chosen = skin.near(rng, PATCH)
        if not chosen:
            return {}
        sensors = np.concatenate([skin.members[m] for m in chosen])
        centre = skin.positions[sensors].mean(axis=0)
        apart = skin.positions[sensors] - centre
        axes = np.linalg.svd(apart, full_matrices=False)[2]
        angle = np.radians(60 * rng.integers(1, 6)) if kind != "shifted" else 0.0
        hand = -1.0 if kind == "mirrored" else 1.0
        turn = np.eye(k)
        cos, sin = np.cos(angle), np.sin(angle)
        turn[:2, :2] = [[cos, -hand * sin], [sin, hand * cos]]
        places = apart @ axes.T @ turn.T @ axes + centre
        if kind == "shifted":
            way = 2 * np.pi * rng.random()
            there = rng.uniform(*SHIFT) * skin.pitch * np.array([np.cos(way), np.sin(way)])
            places = places + there @ axes[:2]
        nearest = KDTree(np.delete(skin.positions, sensors, axis=0)).query(places)[0]
        far = np.linalg.norm(places - skin.positions[sensors], axis=1)
        free = np.mean(nearest < GAP * skin.pitch) <= IN_THE_WAY
        bordering = np.count_nonzero(nearest < REACH * skin.pitch) >= PATCH
        if free and bordering and np.median(far) > skin.pitch:
            ends = np.cumsum([len(skin.members[m]) for m in chosen])[:-1]
            return dict(zip(chosen, np.split(places, ends), strict=True))
    return {}


def reversed_pads(skin: Skin, rng: np.random.Generator) -> Placed:
    """Reverse the order of the pads of a module, as by a connector."""
    m = int(rng.integers(len(skin.members)))
    return {m: skin.positions[skin.members[m][::-1]]}


def reversed_board(skin: Skin, rng: np.random.Generator) -> Placed:
    """Reverse the order of the modules of a board."""
    board = skin.numbers // BOARD
    inside = np.flatnonzero(board == rng.choice(np.unique(board))).tolist()
    pairs = zip(inside, inside[::-1], strict=True)
    return {m: skin.places(m, slot) for m, slot in pairs if m != slot}


def sensors(skin: Skin, rng: np.random.Generator) -> Placed:
    """Exchange pairs of sensors."""
    n = len(skin.positions)
    chosen = rng.permutation(n)[: 2 * max(1, round(WRONG * n / 2))]
    there = chosen.reshape(-1, 2)[:, ::-1].ravel()
    return {int(i): skin.positions[j] for i, j in zip(chosen, there, strict=True)}


FAULTS: dict[str, Callable[[Skin, np.random.Generator], Placed]] = {
    "none": lambda skin, rng: {},
    "turned by 120": partial(turned, angles=(120, 240)),
    "turned by 60 or 180": partial(turned, angles=(60, 180, 300)),
    "mirrored": mirrored,
    "exchanged": exchanged,
    "pads reversed": reversed_pads,
    "five mirrored in place": partial(mirrored, count=PATCH),
    "five turned as one": partial(as_one, kind="turned"),
    "five mirrored as one": partial(as_one, kind="mirrored"),
    "five shifted as one": partial(as_one, kind="shifted"),
    "board reversed": reversed_board,
    "sensors": sensors,
}


def table(results: Sequence[Result]) -> list[str]:
    """Return a table in Markdown: one row per fault, for 2D and 3D, many contacts and few."""
    rows = frame(results)
    rows["contacts"] = np.where(rows.contacts >= ENOUGH, f"{ENOUGH} and more", "fewer")
    groups = sorted(rows.groupby(["contacts", "dimensions"]), key=lambda one: one[0])
    lines = []
    for (contacts, dimensions), group in groups:
        by_kind = dict(iter(group.groupby("kind")))
        for kind in FAULTS:
            if kind in by_kind:
                head = {"contacts": contacts, "dimensions": dimensions, "fault": kind}
                lines.append(head | _cells(by_kind[kind]))
    return [*keyed_table(lines)]


def _cells(rows: Any) -> dict[str, object]:
    return {
        "wrong": rows.wrong.sum(),
        "named": _share(rows.named.sum(), rows.wrong.sum()),
        "corrected": _share(rows.corrected.sum(), rows.wrong.sum()),
        "right ones flagged": f"{rows.flagged.sum()} of {rows.right.sum()}",
        "seconds": f"{rows.seconds.median():.1f}",
    }


def _share(count: int, of_all: int) -> str:
    """Return a count with its interval of 95 %, Clopper & Pearson (1934)."""
    if not of_all:
        return "-"
    low = beta.ppf(0.025, count, of_all - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, of_all - count) if count < of_all else 1.0
    return f"{count} ({100 * low:.0f} to {100 * high:.0f} %)"


if __name__ == "__main__":
    main()
