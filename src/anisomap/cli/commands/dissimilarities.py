"""``anisomap map --dissimilarities``: objects mapped by their dissimilarities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap import drawing, io
from anisomap.base.wording import join_items, number, percent
from anisomap.cli.console import Printer, attributes, progress
from anisomap.cli.outputs import Outputs, Truth
from anisomap.cli.printing import print_map, record_map
from anisomap.errors import InputError
from anisomap.evaluation import NullTest, Shepard, permutation_test, shepard, stress_per_point
from anisomap.method.dimensions import AUTO, Dimensions, plan_dimensions
from anisomap.numerics.graph.neighbour_graphs import components
from anisomap.numerics.scaling.dissimilarity_scaling import SCALINGS, find_scaling
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.recording import sensor_mask
from anisomap.route import split_names
from anisomap.sensor_map import SensorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = ("shepard", "stress")
"""Pictures that --picture takes by name."""

_DEFAULT_SCALING = next(iter(SCALINGS))
_NULL_TOLERANCE = 1e-5  # of the stress; as for the choice of dimensions
_WORST = 5
_LEAST = 3  # objects


@dataclass(frozen=True)
class Fit:
    """How well a map fits its dissimilarities.

    shares (N,): Of the objects, in the stress.
    """

    diagram: Shepard
    shares: NDArray[np.float64]
    test: NullTest


def find(
    files: Sequence[Path], *, wanted: bool | None, weights: Path | None
) -> io.Dissimilarities | None:
    """Read the dissimilarities in a file; None if it is to be read as a recording.

    wanted: Whether it holds dissimilarities, or None if the file tells.
    """
    found = None
    if wanted:
        found = io.read_dissimilarities(files[0])
    elif wanted is None and len(files) == 1:
        found = io.find_dissimilarities(files[0])
    if found is None and weights is not None:
        raise InputError(
            "--weights applies to dissimilarities only: give --dissimilarities as well"
        )
    return found


def map_objects(
    printer: Printer,
    outputs: Outputs,
    truth: Truth,
    table: io.Dissimilarities,
    *,
    picture: str,
    weights: Path | None,
    drop: Sequence[str] | None,
    method: str | None,
    dimensions: Dimensions,
    permutations: int,
) -> None:
    """Map the objects of a file, write all files, and print the results.

    picture: One of `PICTURES`, or "" for another.
    """
    find_scaling(method or _DEFAULT_SCALING)
    names, values, shares = _kept(table, weights, split_names(drop, table.names))
    made, fit = scaled(
        names,
        values,
        shares,
        method=method or _DEFAULT_SCALING,
        dimensions=dimensions,
        permutations=permutations,
        seed=truth.seed,
    )
    source = outputs.inputs[0]
    if source is not None:
        made = replace(made, provenance={**made.provenance, "source": source.name})
    made = made if outputs.placing is None else outputs.placing.applied(made)
    print_fit(printer, made, fit)
    result = truth.score(printer, made, "Score against the true positions")
    drawn = partial(draw, picture, made, fit) if picture else None
    printer.files(outputs.write_all(made, result, draw=drawn))


Floats: TypeAlias = NDArray[np.float64]


def _kept(
    table: io.Dissimilarities, weights: Path | None, drop: Sequence[str]
) -> tuple[list[str], Floats, Floats | None]:
    """Return the objects that are left, their dissimilarities and the weights of these."""
    kept = np.flatnonzero(~sensor_mask(table.names, drop, "object"))
    if len(kept) < _LEAST:
        raise InputError(f"a map requires at least {_LEAST} objects, got {len(kept)}")
    pairs = np.ix_(kept, kept)
    values, shares = table.values[pairs], None
    if weights is not None:
        shares = io.read_pair_weights(weights, table.names)[pairs]
        values = np.where(shares + np.eye(len(kept)) > 0, values, np.inf)
    names = [table.names[i] for i in kept]
    if (group := components(values)).any():
        apart = join_items([names[i] for i in np.flatnonzero(group)], _WORST)
        raise InputError(
            f"no known pairs connect {apart} with the other objects: there are {group.max() + 1} "
            "connected components; map each by itself, without the others (--drop)"
        )
    return names, values, shares


def scaled(
    names: Sequence[str],
    values: Floats,
    weights: Floats | None = None,
    *,
    method: str = _DEFAULT_SCALING,
    dimensions: Dimensions,
    permutations: int,
    seed: int = 0,
) -> tuple[SensorMap, Fit]:
    """Map objects by their dissimilarities, with progress, and examine the fit."""
    scale = find_scaling(method)
    with progress("making the map"):
        target = None
        if dimensions == AUTO:
            target = scale(values, dimensions=2, weights=weights, options=SmacofOptions())[1]
        plan = plan_dimensions(dimensions, target, weights)
        if dimensions == AUTO:  # n objects span n - 1 dimensions
            plan = replace(plan, dimensions=min(plan.dimensions, len(names) - 1))
        k = plan.dimensions
        scaling, target = scale(values, dimensions=k, weights=weights, options=SmacofOptions())
    quick = SmacofOptions(tolerance=max(SmacofOptions().tolerance, _NULL_TOLERANCE))

    def stress(permuted: Floats) -> float:
        return scale(permuted, dimensions=k, weights=weights, options=quick)[0].stress

    with progress(f"computing {permutations} permutations") as report_progress:
        test = permutation_test(
            values, stress, permutations=permutations, rng=seed, progress=report_progress
        )
    made = SensorMap(
        scaling.positions,
        names=tuple(names),
        method=method,
        stress=scaling.stress,
        n_iterations=len(scaling.trace) - 1,
        notes=plan.notes(objects=True),
        provenance=plan.facts(objects=True),
        kind="object",
    )
    shares = stress_per_point(target, scaling.positions, weights=weights)
    return made, Fit(shepard(values, scaling.positions), shares, test)


def draw(kind: str, made: SensorMap, fit: Fit) -> Figure:
    """Draw one of `PICTURES`."""
    if kind == "shepard":
        drawn: Figure = drawing.figures.plot_shepard(fit.diagram).figure
        return drawn
    title = f"{made.method}, {made.n_sensors} objects, Stress-1 {made.stress:.3f}"
    return drawing.figures.stress_figure(title, fit.diagram, fit.shares, made.names, fit.test)


def print_pairs(printer: Printer, table: io.Dissimilarities) -> None:
    """Print a summary of a file of dissimilarities."""
    values = table.values[np.triu_indices(len(table.names), 1)]
    known = values[np.isfinite(values)]
    facts = _facts_of_pairs(printer, len(table.names), len(known))
    if known.size:
        facts["dissimilarities"] = f"{number(known.min())} to {number(known.max())}"
    printer.facts("Dissimilarities", facts)
    printer.line("Map the objects: anisomap map; --no-dissimilarities if it is a recording")


def _facts_of_pairs(printer: Printer, n: int, n_known: int, **fit: object) -> dict[str, str]:
    """Record the objects, their pairs and the fit of a map; return the facts of the pairs."""
    unknown = n * (n - 1) // 2 - n_known
    printer.record(
        dissimilarities={"objects": n, "pairs": n_known, "unknown": unknown, **fit},
    )
    told = f", {unknown} unknown" if unknown else ""
    return {"objects": str(n), "pairs": f"{n_known} known{told}"}


def print_fit(printer: Printer, made: SensorMap, fit: Fit) -> None:
    """Print a map of objects, and how well it fits."""
    n, shown = made.n_sensors, fit.diagram
    # smacof divides by the dissimilarities instead of the distances (Borg & Groenen 2005, 11.1).
    explicit = float(made.stress / np.hypot(1, made.stress))
    null = fit.test.null
    pairs = _facts_of_pairs(
        printer,
        n,
        len(shown.pairs),
        stress=made.stress,
        explicit_stress=explicit,
        **attributes(shown, "nonmetric_stress nonmetric_fit linear_fit"),
        stress_per_point=dict(zip(made.names, fit.shares.tolist(), strict=True)),
        p_value=fit.test.p_value if null.size else None,
        permutations=null.size,
    )
    printer.facts("Dissimilarities", pairs)
    print_map(printer, made)
    record_map(printer, made)
    worst = np.argsort(-fit.shares, kind="stable")[:_WORST]
    facts = {
        "Stress-1 as in smacof": number(explicit),
        "non-metric stress": number(shown.nonmetric_stress),
        "Shepard diagram": f"R squared {shown.nonmetric_fit:.3f} (non-metric), "
        f"{shown.linear_fit:.3f} (linear)",
        "worst fit": ", ".join(f"{made.names[i]} {percent(fit.shares[i])}" for i in worst)
        + f" of the stress; equal shares are {percent(1 / n)}",
    }
    if null.size:
        facts["permutation test"] = (
            f"p = {number(fit.test.p_value, 3)}; Stress-1 of {null.size} permutations: "
            f"{number(float(null.min()))} to {number(float(null.max()))}"
        )
    printer.facts("Fit", facts)
