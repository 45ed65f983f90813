"""Accuracy against contacts per sensor (part of ``make quality``).

Recordings of simulated skins are cut where their sensors have had a number of contacts on average,
and mapped by all methods. The seeds were not used for tuning. The tables hold medians over the
seeds of Mantel r and, in brackets, of the RMS error in spacings; a map without a score has an r
of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap.comparison import COMPARED, compare_methods, spanned_dimensions
from anisomap.defaults import DEFAULT_METHOD
from anisomap.errors import InputError
from anisomap.numerics.similarity.rest import estimate_rest
from benchmarks.harness import frame, markdown_table, measured, options, publish

SKINS = (
    ("sphere", "bombardment"),
    ("hand", "bombardment"),
    ("sphere", "rubbing"),
    ("hand", "rubbing"),
    ("hexagon", "rubbing"),
)
CONTACTS = (3, 5, 8, 12, 20, 50)
FIRST_SEED = 801
LONGEST = 32_000  # frames; the first length that is simulated is a sixteenth of it


@dataclass(frozen=True)
class Row:
    """Score of one map; placed and scored are shares of the sensors. See `MethodScore`."""

    skin: str
    contacts: int
    frames: int
    seed: int
    method: str
    r: float
    error: float
    placed: float
    scored: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all recordings and write the results."""
    parser = options(__doc__, "quality", seeds=5, first_seed=FIRST_SEED, recordings=False,
                     workers=True)  # fmt: skip
    parser.add_argument("--contacts", type=int, nargs="+", default=CONTACTS)
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    skins = [(*skin, seed, tuple(chosen.contacts)) for seed in seeds for skin in SKINS]
    rows = measured(rows_of, skins, chosen.workers)
    publish(chosen.output, "contacts", rows, tables(rows))


def contacts_by_frame(readings: NDArray[np.floating]) -> NDArray[np.intp]:
    """Count the contacts of each sensor that began in each frame or before, shape (T, N)."""
    active = estimate_rest(readings).active(readings)
    began = active & ~np.vstack([np.zeros_like(active[:1]), active[:-1]])
    return np.cumsum(began, axis=0)


def rows_of(skin: tuple[str, str, int, tuple[int, ...]]) -> list[Row]:
    """Map the beginnings of one recording by all methods."""
    body, scenario, seed, contacts = skin
    n_frames, counts = LONGEST // 16, np.empty(0)
    while (counts.size == 0 or counts[-1] < max(contacts)) and n_frames <= LONGEST:
        whole = anisomap.simulate(body, scenario, n_frames=n_frames, seed=seed)
        counts = contacts_by_frame(np.asarray(whole.readings)).mean(axis=1)
        n_frames *= 2
    rows = []
    for mean in contacts:
        until = int(np.searchsorted(counts, mean)) + 1
        if until > len(counts):
            continue
        part = anisomap.Recording(whole.readings[:until], positions=whole.positions)
        dimensions = spanned_dimensions(np.asarray(whole.positions))
        try:
            found = compare_methods(part, COMPARED, dimensions, seed=seed)
        except InputError as error:
            print(f"skipped {body}, {scenario}, {mean} contacts, seed {seed}: {error}")
            continue
        n_sensors, scored = whole.n_sensors, len(found.sensors) / whole.n_sensors
        rows += [
            Row(f"{body}, {scenario}", mean, until, seed, s.method, s.mantel_r, s.rms_in_spacings,
                s.n_placed / n_sensors, scored)
            for s in found.scores
        ]  # fmt: skip
    return rows


def tables(rows: Sequence[Row]) -> str:
    """Return one table per skin, and the points at which another method leads."""
    found = frame(rows)
    medians = found.fillna({"r": 0, "error": np.inf}).groupby(["skin", "contacts", "method"])
    points = medians[["r", "error", "frames", "placed", "scored"]].median()
    methods, losses = list(found.method.unique()), []
    lines: list[str] = []
    for skin, group in found.groupby("skin", sort=False):
        cells = []
        for contacts in sorted(group.contacts.unique()):
            point = points.loc[skin, contacts].reindex(methods)
            own, texts = point.loc[DEFAULT_METHOD], {}
            best = max(methods, key=lambda m: (round(point.r[m], 3), m == DEFAULT_METHOD))
            if best != DEFAULT_METHOD:
                scores = f"{own.r:.3f} against {point.r[best]:.3f} of {best}"
                losses.append(f"{skin}, {contacts} contacts ({scores})")
            for m, r, error in point[["r", "error"]].itertuples():
                text = f"{r:.3f} ({error:.2f})" if np.isfinite(error) else "-"
                texts[m] = f"**{text}**" if m == best else text
            shares = (f"{own.placed:.0%}", f"{own.scored:.0%}")
            cells.append([contacts, round(own.frames), *texts.values(), *shares])
        header = ("contacts", "frames", *methods, "placed", "scored")
        title = f"### {skin}, {group.seed.nunique()} seeds"
        lines += [title, "", *markdown_table(header, cells), ""]
    named = f": {'; '.join(losses)}" if losses else ""
    n_points = len(points.groupby(level=["skin", "contacts"]))
    lines.append(
        f"{DEFAULT_METHOD} does not have the largest r at {len(losses)} of {n_points} "
        f"points{named}."
    )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
