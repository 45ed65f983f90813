"""Accuracy against contacts per sensor (part of ``make quality``).

Recordings of simulated skins are cut where their sensors have had a number of contacts on average,
and mapped by all methods. The seeds were not used for tuning. The tables hold medians over the
seeds of Mantel r and, in brackets, of the RMS error in spacings; a map without a score has an r
of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.errors import InputError
from anisomap.evaluation.compare import compare_methods, spanned_dimensions
from anisomap.numerics.similarity.rest import estimate_rest
from benchmarks.accuracy.quality import Result, all_scores
from benchmarks.accuracy.rivals import COMPARED
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
class Row(Result):
    """Score of one map, of a recording with a mean number of contacts per sensor."""

    contacts: int


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
        name = f"{body}, {scenario}"
        try:
            found = compare_methods(part, COMPARED, dimensions, name=name, seed=seed)
        except InputError as error:
            print(f"skipped {name}, {mean} contacts, seed {seed}: {error}")
            continue
        rows += [Row(**asdict(one), contacts=mean) for one in all_scores(found, seed)]
    return rows


def tables(rows: Sequence[Row]) -> str:
    """Return one table per skin, and the points at which another method leads."""
    found = frame(rows).fillna({"mantel_r": 0, "rms_in_spacings": np.inf})
    keys, scores = ["recording", "contacts", "method"], ["mantel_r", "rms_in_spacings"]
    shares = ["n_frames", "share_placed", "share_scored"]
    points = found.groupby(keys)[[*scores, *shares]].median()
    methods, losses = list(found.method.unique()), []
    lines: list[str] = []
    for skin, group in found.groupby("recording", sort=False):
        cells = []
        for contacts in sorted(group.contacts.unique()):
            point = points.loc[skin, contacts].reindex(methods)
            own, r, texts = point.loc[DEFAULT_METHOD], point.mantel_r, {}
            best = max(methods, key=lambda m: (round(r[m], 3), m == DEFAULT_METHOD))
            if best != DEFAULT_METHOD:
                both = f"{own.mantel_r:.3f} against {r[best]:.3f} of {best}"
                losses.append(f"{skin}, {contacts} contacts ({both})")
            for m, mean, error in point[scores].itertuples():
                text = f"{mean:.3f} ({error:.2f})" if np.isfinite(error) else "-"
                texts[m] = f"**{text}**" if m == best else text
            placed = (f"{own.share_placed:.0%}", f"{own.share_scored:.0%}")
            cells.append([contacts, round(own.n_frames), *texts.values(), *placed])
        header = ("contacts", "frames", *methods, "placed", "scored")
        title = f"### {skin}, {group.seed.nunique()} seeds"
        lines += [title, "", *markdown_table(header, cells), ""]
    named = f": {'; '.join(losses)}" if losses else ""
    n_points = len(points.groupby(level=keys[:2]))
    lines.append(
        f"{DEFAULT_METHOD} does not have the largest r at {len(losses)} of {n_points} "
        f"points{named}."
    )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
