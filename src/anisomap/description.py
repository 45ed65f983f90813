"""Notes and provenance of a map, as text and as plain values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from anisomap._version import __version__
from anisomap.methods import find_method
from anisomap.options import MethodOptions
from anisomap.recording import Scalar
from anisomap.sensor_map import UNPLACED, SensorMap
from anisomap.wording import join_items, noun_and_items


def caveats(component: NDArray[np.intp], names: Sequence[str], *, converged: bool) -> Iterator[str]:
    """Yield a note if the map has several components, and if scaling did not converge."""
    sizes = np.bincount(component[component != UNPLACED])
    if sizes.size > 1:
        outside = [names[i] for i in np.flatnonzero(component > 0).tolist()]
        fragmented = 2 * sizes[0] < sizes.sum()
        yield (
            ("most of the skin is not mapped: " if fragmented else "")
            + f"the sensors form {sizes.size} separate components with unknown positions relative "
            f"to one another; sizes: {join_items(sizes.tolist())}; outside the largest: "
            f"{join_items(outside)}"
        )
    if not converged:
        yield "scaling stopped before it converged: allow more iterations"


def unknown_pairs(known: NDArray[np.bool_], names: Sequence[str]) -> Iterator[str]:
    """Yield a note if some pairs of sensors were never recorded together."""
    if not known.all():
        affected = [names[i] for i in np.flatnonzero(~known.all(axis=1)).tolist()]
        yield (
            f"{np.count_nonzero(np.triu(~known))} pairs of sensors were never recorded together; "
            f"their distances follow from other pairs only: {noun_and_items('sensor', affected)}"
        )


def options_provenance(method: str, options: MethodOptions) -> dict[str, Scalar]:
    """Return the version and the parameters with which a map can be reproduced."""
    recipe, defaults = find_method(method), MethodOptions()
    facts: dict[str, Scalar] = {
        "anisomap": __version__,
        "mu": options.mu,
        "bins": options.bins,
    }
    if options.n_neighbours is not None:
        facts["n_neighbours"] = options.n_neighbours
    if recipe.refinements:
        for kind in ("covariogram", "contacts"):
            usual = asdict(getattr(defaults, kind))
            changed = {k: v for k, v in asdict(getattr(options, kind)).items() if v != usual[k]}
            facts |= {f"{kind}_{name}": value for name, value in changed.items()}
    for name in ("split_unrelated", "independent_frames", "even_spacing", "min_sensors"):
        if getattr(options, name) != getattr(defaults, name):
            facts[name] = getattr(options, name)
    return facts | asdict(options.smacof)


_WEIGHT = "weight_of_"  # of a step, in the provenance of a map


def steps_of(sensor_map: SensorMap) -> list[str]:
    """Name the steps that refined a map, each with its share of the map that it gave."""
    weights = {
        name.removeprefix(_WEIGHT): float(weight)
        for name, weight in sensor_map.provenance.items()
        if name.startswith(_WEIGHT)
    }
    return [
        name if weight == 1 else f"{name} ({weight:.2f})".replace("(0.", "(.")
        for name, weight in weights.items()
    ]
