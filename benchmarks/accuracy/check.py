"""How much recording `anisomap.check_layout` needs: real layouts of triangles with seeded faults.

The layout of each recording is checked as it is, with all frames, and corrected by what was found,
which is printed. Then modules of the corrected layout are turned, mirrored, exchanged in pairs, or
moved to a free place (a tenth of the modules, at least one), or six neighbours are mirrored in
their places, or up to six are turned or mirrored as one to where no other pads are; each fault is
checked against windows of an eighth of the frames to all. Counted are wrong modules that are named
(half of their wrong sensors are accused, or more), wrong modules that are corrected (to half a
spacing), and right modules of which any sensor is accused. ``--picture
docs/_static/check-torso.png`` draws the check of the first layout as it is.

Usage: ``python -m benchmarks.accuracy.check RECORDING=LAYOUT ... --template TRIANGLE -o
docs/results/check.csv --table docs/development/check-table.md``. Scores of other recordings in the
CSV file are kept; without a recording, only the table is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

import anisomap
from anisomap.drawing.figures import plot_layout
from anisomap.layout import LayoutCheck, check_layout, find_modules, reading_statistics
from anisomap.layout.modules import Mounting
from anisomap.placement import Modules
from benchmarks.harness import frame, keyed_table, options, quietly, read_rows, write_rows

FIRST_SEED = 2001
SHARES = (1.0, 0.5, 0.25, 0.125)
WRONG = 0.1  # of the modules
PATCH = 6  # modules that are turned or mirrored together
TURN = 60.0  # degrees, of which patches are turned by a multiple
TRIES = 200
GAP = 0.6  # of the spacing of pads: pads of a turned patch nearer to others are in their way
IN_THE_WAY = 0.1  # share of the pads of a patch
SIZE = 12  # channels of a module
Points = NDArray[np.float64]
Placed = dict[int, Points]
"""Stated places of wrong modules."""


@dataclass(frozen=True)
class Result:
    """Score of one check.

    contacts: Median number of contacts of a sensor.
    """

    recording: str
    layout: str
    share: float
    n_frames: int
    contacts: int
    kind: str
    seed: int
    wrong: int
    named: int
    corrected: int
    right: int
    accused: int
    verdict: str


def main(arguments: Sequence[str] | None = None) -> None:
    """Check all recordings, write the scores and print a summary."""
    parser = options(__doc__, "check.csv", seeds=3, recordings=False)
    parser.add_argument("pairs", nargs="*", help="recordings and their layouts, A.npz=B.csv")
    parser.add_argument("--template", type=Path, help="file of the pads of a module")
    parser.add_argument("--picture", type=Path, help="draw the check of the first pair, only")
    parser.add_argument("--table", type=Path, help="file for a summary in Markdown")
    chosen = parser.parse_args(arguments)
    pairs = [tuple(map(Path, pair.split("="))) for pair in chosen.pairs]
    if chosen.picture:
        recording, layout = pairs[0]
        draw(recording, layout, anisomap.read_map(chosen.template), chosen.picture)
        return
    renewed = {(recording.stem, layout.stem) for recording, layout in pairs}
    results = [
        r for r in read_rows(chosen.output, Result) if (r.recording, r.layout) not in renewed
    ]
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.seeds)
    with quietly():
        for recording, layout in pairs:
            for result in checks(recording, layout, anisomap.read_map(chosen.template), seeds):
                results.append(result)
                write_rows(chosen.output, results)
    text = "\n".join(table(results))
    if chosen.table:
        chosen.table.write_text(text + "\n", encoding="utf-8")
    print(text)


def draw(path: Path, layout_path: Path, template: anisomap.SensorMap, picture: Path) -> None:
    """Draw the check of a layout as it is, as ``anisomap check --picture`` does."""
    stated = anisomap.read_map(layout_path)
    modules = find_modules(stated, SIZE).with_template(template)
    with quietly():
        found = check_layout(stated, anisomap.read(path), modules=modules)
    figure = plot_layout(found, title=f"{layout_path.stem} against {path.stem}").figure
    figure.savefig(picture, dpi=150)


def checks(
    path: Path, layout_path: Path, template: anisomap.SensorMap, seeds: range
) -> Iterator[Result]:
    """Score checks of one recording against its layout: all windows, faults and seeds."""
    whole = anisomap.read(path)
    stated = anisomap.read_map(layout_path)
    modules = find_modules(stated, SIZE).with_template(template)
    untouched = check_layout(stated, whole, modules=modules)
    print(f"{path.stem} against {layout_path.stem}: {untouched}")
    for finding in untouched.findings:
        print(f"  {finding.kind}: {finding.explanation}")
    right = untouched.corrected
    mounted = Mounting.of(modules, right.positions, right.units).members  # without pads elsewhere
    for share in SHARES:
        length = round(share * whole.n_frames)
        for seed in seeds if share < 1 else seeds[:1]:
            rng = np.random.default_rng(seed)
            first = int(rng.integers(0, whole.n_frames - length + 1))
            frames = slice(first, first + length)
            part = replace(whole, readings=whole.readings[frames], times=None)
            # The correlations, most of the work, are the same for every stated layout.
            statistics = reading_statistics(part.readings, np.random.default_rng(0))
            contacts = int(np.median(part.signals.contacts))
            for kind, fault in FAULTS.items():
                placed = fault(right, modules, rng)
                spoilt = right.positions.copy()
                for m, places in placed.items():
                    spoilt[mounted[m]] = places
                found = check_layout(
                    replace(right, positions=spoilt), part, modules=modules, statistics=statistics
                )
                counts = score(found, right.positions, modules, set(placed))
                yield Result(
                    path.stem, layout_path.stem, share, length, contacts, kind, seed, *counts,
                    found.verdict,
                )  # fmt: skip
        print(f"  {length} frames done", flush=True)


def score(
    found: LayoutCheck, right: Points, modules: Modules, wrong: set[int]
) -> tuple[int, int, int, int, int]:
    """Count wrong modules, those named and corrected; and right modules, and those accused."""
    named = corrected = accused = 0
    for m in range(modules.n_modules):
        members = modules.members(m)
        if m not in wrong:
            accused += bool(found.accused[members].any())
            continue
        off = np.linalg.norm(found.layout.positions[members] - right[members], axis=1)
        changed = members[off > found.spacing / 100]
        named += bool(found.accused[changed].mean() >= 0.5)
        left = np.linalg.norm(found.corrected.positions[members] - right[members], axis=1)
        corrected += bool(np.median(left) <= found.spacing / 2)
    return len(wrong), named, corrected, modules.n_modules - len(wrong), accused


def turned(
    layout: anisomap.SensorMap,
    modules: Modules,
    rng: np.random.Generator,
    *,
    reflected: bool = False,
    patch: int = 0,
) -> Placed:
    """Turn or mirror modules in their places: some at random, or neighbours."""
    mounting = Mounting.of(modules, layout.positions, layout.units)
    count = patch or max(1, round(WRONG * mounting.n_modules))
    chosen = rng.permutation(mounting.n_modules)[:count]
    if patch:
        away = np.linalg.norm(mounting.middles - mounting.middles[chosen[0]], axis=1)
        chosen = np.argsort(away)[:count]
    turns = [o for o, one in enumerate(mounting.orientations) if o and one.reflected == reflected]
    return {int(m): mounting.places(int(m), int(m), int(rng.choice(turns))) for m in chosen}


def turned_together(
    layout: anisomap.SensorMap, modules: Modules, rng: np.random.Generator
) -> Placed:
    """Turn or mirror neighbours as one about their middle, where they are not in others' way.

    They are fewer than the others that are adjacent to them: readings tell how both lie to each
    other, not which of them is turned.
    """
    mounting = Mounting.of(modules, layout.positions, layout.units)
    graph: Any = csr_array(mounting.adjacent)
    k, label = layout.dimensions, connected_components(graph, directed=False)[1]
    for _ in range(TRIES):
        first = int(rng.integers(mounting.n_modules))
        away = np.linalg.norm(mounting.middles - mounting.middles[first], axis=1)
        size = min(PATCH, (int(np.count_nonzero(label == label[first])) - 1) // 2)
        if size < 2:
            continue
        chosen = np.argsort(away)[:size].tolist()
        sensors = np.concatenate([mounting.members[m] for m in chosen])
        centre = layout.positions[sensors].mean(axis=0)
        apart = layout.positions[sensors] - centre
        axes = np.linalg.svd(apart, full_matrices=False)[2]
        angle, hand = np.radians(TURN * rng.integers(6)), rng.choice([1.0, -1.0])
        turn = np.eye(k)
        cos, sin = np.cos(angle), np.sin(angle)
        turn[:2, :2] = [[cos, -hand * sin], [sin, hand * cos]]
        places = apart @ axes.T @ turn.T @ axes + centre
        others = np.delete(layout.positions, sensors, axis=0)
        nearest = KDTree(others).query(places)[0]
        far = np.linalg.norm(places - layout.positions[sensors], axis=1)
        free = np.mean(nearest < GAP * mounting.pitch) <= IN_THE_WAY
        if free and np.median(far) > mounting.pitch:
            ends = np.cumsum([len(mounting.members[m]) for m in chosen])[:-1]
            return dict(zip(chosen, np.split(places, ends), strict=True))
    return {}


def exchanged(layout: anisomap.SensorMap, modules: Modules, rng: np.random.Generator) -> Placed:
    """Exchange pairs of modules, each turned at random."""
    mounting = Mounting.of(modules, layout.positions, layout.units)
    count = 2 * max(1, round(WRONG * mounting.n_modules / 2))
    chosen = rng.permutation(mounting.n_modules)[:count].tolist()
    turns = [o for o, one in enumerate(mounting.orientations) if not one.reflected]
    pairs = zip(chosen, [chosen[i ^ 1] for i in range(count)], strict=True)
    return {m: mounting.places(m, slot, int(rng.choice(turns))) for m, slot in pairs}


def moved(layout: anisomap.SensorMap, modules: Modules, rng: np.random.Generator) -> Placed:
    """Move a module to a free place that is not beside its own."""
    mounting = Mounting.of(modules, layout.positions, layout.units)
    mounting = mounting.with_free_slots(layout.positions)
    m = int(rng.integers(mounting.n_modules))
    away = np.linalg.norm(mounting.middles - mounting.middles[m], axis=1)
    far = np.flatnonzero(away > 8 * mounting.pitch)
    slots = far[far >= mounting.n_modules]
    return {m: mounting.places(m, int(rng.choice(slots)), 0)} if slots.size else {}


FAULTS: dict[str, Callable[[anisomap.SensorMap, Modules, np.random.Generator], Placed]] = {
    "none": lambda layout, modules, rng: {},
    "turned": turned,
    "mirrored": lambda layout, modules, rng: turned(layout, modules, rng, reflected=True),
    "patch mirrored": lambda layout, modules, rng: turned(
        layout, modules, rng, reflected=True, patch=PATCH
    ),
    "patch as one": turned_together,
    "exchanged": exchanged,
    "moved": moved,
}


def table(results: Sequence[Result]) -> list[str]:
    """Return a table in Markdown: one row per layout and number of frames."""
    groups = frame(results).groupby(["recording", "layout", "n_frames"])
    ordered = sorted(groups, key=lambda one: (one[0][0], one[0][1], -one[0][2]))
    return [*keyed_table(_cells(rows) for _, rows in ordered)]


def _cells(rows: Any) -> dict[str, object]:
    by_kind = dict(iter(rows.groupby("kind")))
    cells: dict[str, object] = {
        "recording": rows.recording.iloc[0],
        "layout": rows.layout.iloc[0],
        "frames": f"{rows.n_frames.iloc[0]:,}",
        "contacts": int(rows.contacts.median()),
    }
    for kind in FAULTS:
        if kind in by_kind and by_kind[kind].wrong.sum():
            cells[kind] = f"{by_kind[kind].named.sum()} of {by_kind[kind].wrong.sum()}"
        elif kind != "none":
            cells[kind] = "-"
    right, accused = rows.right.sum(), rows.accused.sum()
    return {**cells, "right ones accused": f"{accused} of {right}"}


if __name__ == "__main__":
    main()
