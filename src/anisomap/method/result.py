"""The map that a configuration makes, with its notes and its provenance."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from anisomap._version import __version__
from anisomap.errors import AnisomapWarning
from anisomap.method.configuration import Configuration
from anisomap.method.evidence import Evidence
from anisomap.method.named import DEFAULT_OPTIONS, MethodOptions, find_method
from anisomap.notes import Note
from anisomap.recording import Scalar
from anisomap.sensor_map import UNPLACED, SensorMap


def as_map(
    configuration: Configuration,
    names: tuple[str, ...],
    mapped: NDArray[np.bool_],
    method: str,
    *,
    similarity: str,
    notes: Sequence[str],
    provenance: Mapping[str, Scalar],
    objects: bool = False,
    stack_level: int = 3,
) -> SensorMap:
    """Make a map of all sensors from the positions of the mapped ones; warn for each note."""
    refined = configuration.largest
    positions = np.full((len(names), configuration.positions.shape[1]), np.nan)
    positions[mapped] = configuration.positions
    component = np.full(len(names), UNPLACED)
    component[mapped] = configuration.component
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=stack_level)
    facts: dict[str, Scalar] = {"iterations": configuration.n_iterations}
    if refined is not None:
        facts |= {
            "unexplained": round(refined.unexplained, 4),
            "weight_of_paths": round(refined.path_weight, 3),
        }
    return SensorMap(
        positions,
        names=names,
        component=component,
        method=method,
        similarity=similarity,
        stress=configuration.stress,
        n_iterations=configuration.n_iterations,
        distorted=refined is not None and refined.distorted,
        kind="object" if objects else "sensor",
        notes=tuple(notes),
        provenance={**provenance, **facts},
    )


def caveats(
    configuration: Configuration, evidence: Evidence | None, names: Sequence[str]
) -> Iterator[Note]:
    """Yield notes on what the map of the mapped sensors does not show."""
    component = configuration.component
    sizes = np.bincount(component)
    if sizes.size > 1:
        outside = [names[i] for i in np.flatnonzero(component > 0).tolist()]
        yield Note("components", sizes=sizes.tolist(), outside=outside)
    if not configuration.converged:
        yield Note("not-converged")
    if evidence is None or not configuration.refinements:
        return
    hidden = [names[i] for i in evidence.groups.hidden.tolist()]
    if hidden:
        yield Note("hidden-links", sensors=hidden, total=len(names))
    for one in configuration.refinements:
        if one is not None and one.distorted:
            yield Note("different-contacts", share=one.unexplained)


def unknown_pairs(evidence: Evidence, names: Sequence[str]) -> Iterator[Note]:
    """Yield a note if some pairs of sensors were never recorded together."""
    if not evidence.known.all():
        pairs = int(np.count_nonzero(np.triu(~evidence.known)))
        affected = [names[i] for i in np.flatnonzero(~evidence.known.all(axis=1)).tolist()]
        yield Note("unknown-pairs", count=pairs, sensors=affected)


def parameters_of(method: str, options: MethodOptions, n_sensors: int) -> dict[str, Scalar]:
    """Return the version and the parameters with which a map of n sensors can be reproduced."""
    recipe, defaults = find_method(method), DEFAULT_OPTIONS
    facts: dict[str, Scalar] = {
        "anisomap": __version__,
        "regularisation": options.regularisation,
        "entropy_bins": options.entropy_bins,
    }
    if options.n_neighbours is not None:
        facts["n_neighbours"] = options.n_neighbours
    if recipe.refine is not None:
        usual = asdict(defaults.covariogram)
        changed = {k: v for k, v in asdict(options.covariogram).items() if v != usual[k]}
        facts |= {f"covariogram_{name}": value for name, value in changed.items()}
    for name in ("independent_frames", "min_sensors"):
        if getattr(options, name) != getattr(defaults, name):
            facts[name] = getattr(options, name)
    return facts | asdict(recipe.scaling_of(n_sensors, options.smacof))
