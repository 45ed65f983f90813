"""How far lengths on maps are off that are scaled to the true median spacing.

``python -m benchmarks.placing.scale``. Skins are those of `benchmarks.skins.independent` with at
most 250 sensors. Only maps with an error of at most half a spacing count, without their scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from anisomap import reconstruct, score
from anisomap.errors import InputError
from anisomap.evaluation import median_spacing
from anisomap.placement import scaled_to_spacing
from benchmarks.accuracy.compare import spanned_dimensions
from benchmarks.harness import frame, keyed_table, options, publish, stream
from benchmarks.skins.independent import drawn, make

FIRST_SEED, SEEDS = 79001, 400
LONGEST, MOST_SENSORS, MAX_ERROR = 6000, 250, 0.5  # frames, sensors, spacings
SHARES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class Row:
    """One map.

    error: After the best scale, in spacings.
    scale: Lengths on the map over true lengths.
    """

    seed: int
    body: str
    dimensions: int
    sensors: int
    error: float
    scale: float


def measured(seeds: Sequence[int]) -> Iterator[Row]:
    """Map the skins of seeds; those that give no map are left out."""
    for seed in seeds:
        case = drawn(seed, longest=LONGEST)
        recording = make(case)
        if recording.n_sensors > MOST_SENSORS or recording.positions is None:
            continue
        spacing = median_spacing(recording.positions)
        dimensions = max(2, spanned_dimensions(recording.positions))
        try:
            made = scaled_to_spacing(reconstruct(recording, dimensions=dimensions), spacing, "mm")
            found = score(made, recording.positions, units="mm", permutations=0)
        except InputError:
            continue
        yield Row(
            seed, case.body, dimensions, recording.n_sensors, found.rms_in_spacings, found.scale
        )


def table(rows: Sequence[Row]) -> str:
    """Return the quantiles of the scales of good maps, by dimensions."""
    every = frame(rows)
    good = every[every.error <= MAX_ERROR]
    groups = {"2": good[good.dimensions == 2], "3": good[good.dimensions == 3], "all": good}
    found = (
        {"dimensions": name, "maps": len(among)}
        | {f"{share:.0%}": f"{np.quantile(among.scale, share):.2f}" for share in SHARES}
        for name, among in groups.items()
        if len(among)
    )
    return "\n".join(keyed_table(found)) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Map all skins, and write the table."""
    parser = options(__doc__, "scale", seeds=SEEDS, first_seed=FIRST_SEED, recordings=False)
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    rows = stream(chosen.output / "scale.csv", measured(seeds))
    publish(chosen.output, "scale", rows, table(rows))


if __name__ == "__main__":
    main()
