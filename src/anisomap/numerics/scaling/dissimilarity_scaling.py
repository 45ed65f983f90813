"""Scaling of dissimilarities: of shortest paths, of the values themselves, or of their order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.graph.metric import check_semi_metric, metricise
from anisomap.numerics.precision import Floats
from anisomap.numerics.scaling.multidimensional_scaling import Scaling, SmacofOptions, smacof

_STEPS = 10  # of SMACOF between two monotone regressions


def monotone_regression(
    dissimilarities: Floats, distances: Floats, weights: Floats | None = None
) -> tuple[NDArray[np.intp], Floats]:
    """Fit a non-decreasing function of P dissimilarities to distances.

    dissimilarities, distances, weights (P,) -> order of the pairs, and disparities in it (P,).

    Ties of dissimilarity are ordered by distance: Kruskal's primary approach (1964).
    """
    from scipy.optimize import isotonic_regression  # noqa: PLC0415, slow to import

    order = np.lexsort((distances, dissimilarities))
    chosen = None if weights is None else weights[order]
    return order, np.asarray(isotonic_regression(distances[order], weights=chosen).x)


def ordinal_smacof(
    dissimilarities: ArrayLike,
    *,
    dimensions: int = 3,
    start: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    options: SmacofOptions | None = None,
) -> tuple[Scaling, Floats]:
    """Find a configuration whose distances have the order of dissimilarities.

    Arguments are those of `smacof`; iterations are those between the monotone regressions,
    together. The stress of the scaling is Kruskal's non-metric Stress-1, and its trace the square
    of that. Disparities, (N, N), are the non-decreasing function of the dissimilarities that is
    nearest to the distances; infinite where unknown.

    Kruskal (1964), Psychometrika 29: 1-27 and 115-129; Borg & Groenen (2005), chapter 9. Monotone
    regressions and steps of SMACOF alternate; neither increases the stress.
    """
    chosen = options or SmacofOptions()
    values = np.asarray(check_semi_metric(dissimilarities), dtype=np.float64)
    scaling = smacof(values, dimensions=dimensions, start=start, weights=weights, options=chosen)
    first, second = np.triu_indices(len(values), k=1)
    share = np.ones(len(first)) if weights is None else np.asarray(weights, float)[first, second]
    kept = np.isfinite(values[first, second]) & (share > 0)
    first, second, share = first[kept], second[kept], share[kept]
    known = values[first, second]
    size = share @ known**2
    steps = replace(chosen, max_iterations=_STEPS, solver="majorization", tolerance=0)
    trace, converged = list[float](), False
    disparities = np.full(values.shape, np.inf)
    np.fill_diagonal(disparities, 0)
    while True:
        distances = cdist(scaling.positions, scaling.positions)[first, second]
        order, fitted = monotone_regression(known, distances, share)
        spread = float(share @ distances**2)
        missed = float(share[order] @ (distances[order] - fitted) ** 2)
        trace.append(missed / spread if spread else 0.0)
        converged = len(trace) > 1 and trace[-2] - trace[-1] <= chosen.tolerance * trace[-2]
        if converged or not missed or len(trace) * _STEPS > chosen.max_iterations:
            break
        # The size of the disparities is fixed, or the configuration would shrink.
        rescaled = fitted * np.sqrt(size / (share[order] @ fitted**2))
        disparities[first[order], second[order]] = rescaled
        disparities[second[order], first[order]] = rescaled
        scaling = smacof(disparities, start=scaling.positions, weights=weights, options=steps)
    disparities[first[order], second[order]] = disparities[second[order], first[order]] = fitted
    history = np.array(trace)
    history.setflags(write=False)
    done = replace(
        scaling, raw_stress=missed, spread=spread, trace=history, converged=converged or not missed
    )
    return done, disparities


def _by_paths(values: ArrayLike, **settings: Any) -> tuple[Scaling, Floats]:
    metric = np.asarray(metricise(values), dtype=np.float64)
    return smacof(metric, **settings), metric


def _by_values(values: ArrayLike, **settings: Any) -> tuple[Scaling, Floats]:
    return smacof(values, **settings), np.asarray(values, dtype=np.float64)


SCALINGS: Mapping[str, Callable[..., tuple[Scaling, Floats]]] = MappingProxyType(
    {"anisomap": _by_paths, "mds": _by_values, "ordinal": ordinal_smacof}
)
"""How dissimilarities are scaled: by the lengths of shortest paths, as they are, or by their order.

Each takes the arguments of `ordinal_smacof`, and returns a scaling and the distances (N, N) that it
approximates.
"""


def find_scaling(name: str) -> Callable[..., tuple[Scaling, Floats]]:
    """Return the function of a name in `SCALINGS`."""
    if name not in SCALINGS:
        raise InputError(
            f"there is no scaling of dissimilarities {name!r}; choose from {', '.join(SCALINGS)}"
        )
    return SCALINGS[name]
