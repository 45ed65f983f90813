"""``anisomap map --dissimilarities``: objects mapped by their dissimilarities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.cli import pipeline, printing
from anisomap.cli.console import Printer, number, percent, progress
from anisomap.cli.parameters import PlacingOptions, ReportingOptions, beside, sensors
from anisomap.defaults import PERMUTATIONS, STRESS_PERMUTATIONS
from anisomap.dimensions import AUTO, Dimensions, plan_dimensions
from anisomap.errors import InputError
from anisomap.evaluation import NullTest, Shepard, permutation_test, shepard, stress_per_point
from anisomap.numerics.scaling.dissimilarity_scaling import SCALINGS, find_scaling
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.recording import sensor_mask
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
        raise InputError("--weights are those of dissimilarities: give --dissimilarities as well")
    return found


def map_file(
    table: io.Dissimilarities,
    files: Sequence[Path],
    *,
    output: list[Path] | None,
    picture: Path | None,
    report: Path | None,
    weights: Path | None,
    drop: list[str] | None,
    placing: PlacingOptions,
    truth: Path | None,
    exclude: list[str] | None,
    permutations: int | None,
    seed: int,
    reporting: ReportingOptions,
    others: bool,
    **settings: Any,
) -> None:
    """Map the objects of a file, write all files, and print the results.

    others: Whether options are given that apply to recordings only.
    """
    if len(files) > 1 or others:
        raise InputError(
            "dissimilarities are one file, without a verdict: leave out other files, --repair, "
            "--keep-statistics, --min-quality and the options for large recordings"
        )
    maps = output or [beside(files[0], ".map.csv")]
    kind = str(picture) if str(picture) in PICTURES else ""
    outputs = pipeline.Outputs(
        maps=maps,
        picture=beside(files[0], f".{kind}.png") if kind else picture,
        report=report,
        inputs=(*files, truth, weights),
        placing=placing,
    )
    placing.check(maps)
    reference = None if truth is None else pipeline.read_reference(truth)
    with reporting.printer() as printer:
        made, fit = map_objects(
            table,
            source=files[0].name,
            weights=weights,
            drop=sensors(drop, table.names),
            permutations=permutations,
            seed=seed,
            **settings,
        )
        made = placing.applied(made)
        _print_fit(printer, made, fit)
        result = None
        if reference is not None:
            count = PERMUTATIONS if permutations is None else permutations
            left_out = sensors(exclude, made.names)
            result = pipeline.score_with_progress(made, reference, count, seed, exclude=left_out)
            printing.print_score(printer, result, made, "Score against the true positions")
        files_written = pipeline.write_outputs(
            outputs, made, result, draw=(lambda: _draw(kind, made, fit)) if kind else None
        )
        printing.print_files(printer, files_written)


def map_objects(
    found: io.Dissimilarities,
    *,
    source: str,
    weights: Path | None,
    drop: Sequence[str],
    method: str | None,
    dimensions: Dimensions,
    options: SmacofOptions,
    permutations: int | None,
    seed: int,
) -> tuple[SensorMap, Fit]:
    """Map objects but those of `drop`, with progress, and examine the fit."""
    kept = np.flatnonzero(~sensor_mask(found.names, drop))
    if len(kept) < _LEAST:
        raise InputError(f"a map requires at least {_LEAST} objects, got {len(kept)}")
    pairs = np.ix_(kept, kept)
    values, shares = found.values[pairs], None
    if weights is not None:
        shares = io.read_pair_weights(weights, found.names)[pairs]
        values = np.where(shares + np.eye(len(kept)) > 0, values, np.inf)
    name = method or _DEFAULT_SCALING
    scale = find_scaling(name)
    with progress("making the map"):
        target = None
        if dimensions == AUTO:
            target = scale(values, dimensions=2, weights=shares, options=options)[1]
        plan = plan_dimensions(dimensions, target, shares)
        k = plan.dimensions
        scaling, target = scale(values, dimensions=k, weights=shares, options=options)
    quick = replace(options, tolerance=max(options.tolerance, _NULL_TOLERANCE))

    def stress(permuted: NDArray[np.float64]) -> float:
        return scale(permuted, dimensions=k, weights=shares, options=quick)[0].stress

    count = STRESS_PERMUTATIONS if permutations is None else permutations
    with progress(f"computing {count} permutations") as report_progress:
        test = permutation_test(
            values, stress, permutations=count, rng=seed, progress=report_progress
        )
    made = SensorMap(
        scaling.positions,
        names=tuple(found.names[i] for i in kept),
        method=name,
        stress=scaling.stress,
        n_iterations=len(scaling.trace) - 1,
        notes=plan.note,
        provenance=plan.provenance | {"source": source, "precomputed": "dissimilarity"},
    )
    fit = Fit(
        shepard(values, scaling.positions),
        stress_per_point(target, scaling.positions, weights=shares),
        test,
    )
    return made, fit


def _draw(kind: str, made: SensorMap, fit: Fit) -> Figure:
    from anisomap.drawing import figures

    if kind == "shepard":
        drawn: Figure = figures.plot_shepard(fit.diagram).figure
        return drawn
    title = f"{made.method}, {made.n_sensors} objects, Stress-1 {made.stress:.3f}"
    return figures.stress_figure(title, fit.diagram, fit.shares, made.names, fit.test)


def _print_fit(printer: Printer, made: SensorMap, fit: Fit) -> None:
    n, n_known = made.n_sensors, len(fit.diagram.pairs)
    unknown = n * (n - 1) // 2 - n_known
    printer.facts(
        "Dissimilarities",
        {
            "objects": str(n),
            "pairs": f"{n_known} known" + (f", {unknown} unknown" if unknown else ""),
        },
    )
    printing.print_map(printer, made)
    printing.record_map(printer, made)
    worst = np.argsort(-fit.shares, kind="stable")[:_WORST]
    # smacof divides by the dissimilarities instead of the distances (Borg & Groenen 2005, 11.1).
    explicit = made.stress / np.hypot(1, made.stress)
    tested = {}
    if fit.test.null.size:
        tested["permutation test"] = (
            f"p = {number(fit.test.p_value, 3)}; Stress-1 of {fit.test.null.size} permutations: "
            f"{number(float(fit.test.null.min()))} to {number(float(fit.test.null.max()))}"
        )
    printer.facts(
        "Fit",
        {
            "Stress-1 as in smacof": number(explicit),
            "non-metric stress": number(fit.diagram.nonmetric_stress),
            "Shepard diagram": f"R squared {fit.diagram.nonmetric_fit:.3f} (non-metric), "
            f"{fit.diagram.linear_fit:.3f} (linear)",
            "worst fit": ", ".join(f"{made.names[i]} {percent(fit.shares[i])}" for i in worst)
            + f" of the stress; equal shares are {percent(1 / n)}",
            **tested,
        },
    )
    printer.record(
        dissimilarities={
            "objects": n,
            "pairs": n_known,
            "unknown": unknown,
            "stress": made.stress,
            "explicit_stress": float(explicit),
            "nonmetric_stress": fit.diagram.nonmetric_stress,
            "nonmetric_fit": fit.diagram.nonmetric_fit,
            "linear_fit": fit.diagram.linear_fit,
            "stress_per_point": dict(zip(made.names, fit.shares.tolist(), strict=True)),
            "p_value": fit.test.p_value if fit.test.null.size else None,
            "permutations": fit.test.null.size,
        }
    )
