"""Maps of skins with white noise in their readings.

Noise is in units of a deep contact, the 90 % quantile of the loads above 0. The table holds medians
over the seeds of Mantel r of the default and of r-ANISOMAP, and of the share of sensors in the
largest component of the default map; a recording that is refused has an r of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

import anisomap
from anisomap.base import DEFAULT_METHOD
from benchmarks.harness import frame, keyed_table, measured, options, publish
from benchmarks.skins.independent import Case, make

LEVELS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
SKINS = {
    "sphere": ("sphere:n=80", "jumps:reach=1.5"),
    "plane": ("plate:n=81,jitter=.08", "poke:reach=2"),
    "strip": ("strip:n=72,rows=3,jitter=.08", "poke:reach=2"),
    "hand": ("flat-hand:jitter=.08", "poke:reach=2"),
}
"""Bodies and stimulations of `benchmarks.skins.independent`."""

FRAMES = 2500


@dataclass(frozen=True)
class Row:
    """Two maps of one recording; placed: Share of sensors in the largest component."""

    skin: str
    noise: float
    seed: int
    r: float
    published: float
    placed: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all skins and write the table."""
    parser = options(__doc__, "noise", seeds=10, first_seed=901, recordings=False, workers=True)
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    rows = measured(mapped, [*product(SKINS, LEVELS, seeds)], chosen.workers)
    publish(chosen.output, "noise", rows, table(rows))


def mapped(drawn: tuple[str, float, int]) -> list[Row]:
    """Map a skin by both methods."""
    skin, level, seed = drawn
    transducer = f"white:level={level},gains=0"
    recording = make(Case(*SKINS[skin], transducer, n_frames=FRAMES, seed=seed))
    (r, placed), (published, _) = (
        score(recording, method) for method in (DEFAULT_METHOD, "r-anisomap")
    )
    return [Row(skin, level, seed, r, published, placed)]


def score(recording: anisomap.Recording, method: str) -> tuple[float, float]:
    """Return Mantel r of a map, and the share of sensors in its largest component."""
    truth = np.asarray(recording.positions)
    try:
        made = anisomap.reconstruct(recording, method, truth.shape[1])
        r = anisomap.score(made, truth, permutations=0).mantel.r
    except anisomap.InputError:
        return 0.0, 0.0
    return r, float(np.mean(made.component == 0))


def table(rows: Sequence[Row]) -> str:
    """Return the medians in Markdown."""
    found = frame(rows).groupby(["skin", "noise"], sort=False).median().reset_index()
    cells = (
        {
            "skin": one.skin,
            "noise": f"{one.noise:g}",
            "default": f"{one.r:.3f}",
            "r-ANISOMAP": f"{one.published:.3f}",
            "difference": f"{one.r - one.published:+.3f}",
            "in one component": f"{one.placed:.0%}",
        }
        for one in found.itertuples()
    )
    return "\n".join(keyed_table(cells, ["skin"])) + "\n"


if __name__ == "__main__":
    main()
