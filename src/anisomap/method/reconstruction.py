"""Reconstruction of sensor positions from readings: McGregor et al. (2011), section "Methods".

`reconstruct` computes a map from readings, stage by stage; `reconstruct_from` starts from a
precomputed stage. Every stage can be called separately:

==========  ===========================================  =====================================
S           `anisomap.method.evidence.compare`           similarity of all pairs of sensors
M           `anisomap.method.pipeline.dissimilarities`   dissimilarity of all pairs of sensors
D           `anisomap.method.named.Method.metric`        metric: shortest path lengths
dimensions  `anisomap.method.dimensions`                 their number, if it is not given
positions   `anisomap.method.pipeline.scale`             scaling by SMACOF
refinement  `anisomap.method.pipeline.refine_components` positions refined by S
==========  ===========================================  =====================================
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap._version import __version__
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.base.wording import join_items, noun_and_items
from anisomap.errors import AnisomapWarning, InputError
from anisomap.method.blocks import is_dask, sum_blocks
from anisomap.method.dimensions import (
    AUTO,
    SPATIAL,
    Dimensions,
    check_dimensions,
    given_dimensions,
    plan_dimensions,
)
from anisomap.method.evidence import PairStatistics
from anisomap.method.named import Method, check_even_spacing, examined_metric, find_method
from anisomap.method.options import MethodOptions
from anisomap.method.pipeline import (
    Configuration,
    Stages,
    compute_stages,
    configure,
    dissimilarities,
)
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import check_semi_metric
from anisomap.numerics.precision import Reals, check_pair_memory, float_type
from anisomap.recording import (
    Recording,
    Scalar,
    as_runs,
    check_names,
    column_names,
    default_names,
    join_runs,
    select_sensors,
    sensor_mask,
)
from anisomap.sensor_map import UNPLACED, SensorMap


def reconstruct(
    recording: Recording | ArrayLike | Sequence[Recording],
    method: str = DEFAULT_METHOD,
    dimensions: Dimensions = AUTO,
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
) -> SensorMap:
    """Reconstruct the positions of sensors from their readings.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Complete readings (see `Recording.complete`). Several recordings of one skin make one map:
        sensors are matched by name, and each pair is compared over the runs that contain both. The
        blocks of a Dask array are compared where Dask runs, by methods that are not refined.
    method : str
        A key of `anisomap.METHODS`: ``"covariogram"`` (the default), ``"contact-fit"``, a variant,
        or one of the paper's: ``"r-anisomap"``, ``"i-anisomap"``, ``"information-distance"`` and
        ``"isomap"``.
    dimensions : int or "auto"
        Number of coordinates: 2 for flat skins, 3 for bodies. ``"auto"`` chooses between them: see
        the notes; 3 if it is not clear, with a note.
    options : MethodOptions, optional
        Parameters of the stages.
    drop : iterable of str or int
        Sensors to leave out, by name or index.

    Returns
    -------
    SensorMap
        Positions in the order of the recording, known up to rotation, translation, scale and
        reflection; NaN for constant and dropped sensors. `anisomap.diagnose` adds sensor health
        and a verdict.

    Raises
    ------
    InputError
        If a reading is missing, fewer than 3 sensors vary or are related, all read the same but for
        offset and gain, the method or a sensor is unknown, `dimensions` is less than 1 or more than
        the number of sensors that are mapped, or the matrices of all pairs do not fit in memory.

    Warns
    -----
    AnisomapWarning
        Once for each note of the map.

    Notes
    -----
    McGregor et al. (2011), section "Methods", doi:10.1371/journal.pone.0026561: the similarity S is
    converted to a dissimilarity M (step 1 of ANISOMAP), M to the metric D of shortest path lengths
    (step 2), and D is scaled to positions (step 3). Some methods, the default included, then refine
    the positions by S, which is not part of the paper.

    ``"auto"`` compares how much the third and the fourth dimension improve the fit of the metric of
    the default method: see `anisomap.method.dimensions.choose_dimensions`. Readings show distances
    along the skin, so skins that are bent like a sheet of paper are mapped in 2D.

    Examples
    --------
    Twelve sensors in a line, pressed at random places:

    >>> import numpy as np
    >>> places, touches = np.arange(12), np.random.default_rng(0).uniform(0, 11, (2000, 1))
    >>> readings = np.maximum(0, 2 - abs(touches - places))
    >>> sensor_map = reconstruct(readings, dimensions=1)
    >>> bool(abs(np.corrcoef(sensor_map.positions[:, 0], places)[0, 1]) > 0.99)
    True
    """
    if is_dask(recording):
        return _reconstruct_blocks(recording, method, dimensions, options or MethodOptions(), drop)
    return reconstruct_with_stages(
        recording, method, dimensions, options=options, drop=drop, stack_level=3
    )[0]


def _reconstruct_blocks(
    readings: Any,
    method: str,
    dimensions: Dimensions,
    options: MethodOptions,
    drop: Iterable[str | int],
) -> SensorMap:
    """Reconstruct positions from a Dask array of readings, shape (T, N)."""
    check_even_spacing(method, options, readings=False)
    check_dimensions(dimensions)
    statistic = find_method(method).similarity
    found = sum_blocks(readings, statistic, options.entropy_bins)
    check_frames(found.n_frames, dimensions)
    dropped = sensor_mask(default_names(len(found.varying)), drop) | ~found.varying
    made = reconstruct_from(
        similarity=found.similarity,
        method=method,
        dimensions=dimensions,
        options=options,
        drop=np.flatnonzero(dropped).tolist(),
        statistic=statistic,
    )
    for note in found.notes:
        warnings.warn(note, AnisomapWarning, stacklevel=3)
    return replace(
        made,
        notes=(*found.notes, *made.notes),
        provenance={**made.provenance, "frames": found.n_frames},
    )


def reconstruct_with_stages(
    recording: Recording | ArrayLike | Sequence[Recording],
    method: str = DEFAULT_METHOD,
    dimensions: Dimensions = AUTO,
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
    recipe: Method | None = None,
    stack_level: int = 2,
) -> tuple[SensorMap, Stages]:
    """Reconstruct positions, and return the stages that `anisomap.diagnose` can use again."""
    named, options = find_method(method), options or MethodOptions()
    recipe = recipe or named
    runs = as_runs(recording)
    check_even_spacing(method, options, readings=len(runs) == 1)
    joined = join_runs(runs)
    mapped = joined.varying() & ~sensor_mask(joined.names, drop)
    _check_size(mapped, dimensions, recipe, options)
    check_frames(joined.n_frames, dimensions)
    names = [joined.names[i] for i in np.flatnonzero(mapped)]
    complete = [run.complete() for run in select_sensors(runs, names)]
    check_unlike(*(run.readings for run in complete))
    stages = compute_stages(complete, recipe, dimensions, options)
    pairs, configuration, plan = stages.pairs, stages.configuration, stages.plan
    _check_related(configuration, options)
    provenance = options_provenance(method, options) | plan.provenance
    provenance |= {
        "source": joined.source,
        "frames": joined.n_frames,
        "similarity": pairs.statistic,
    }
    if len(runs) > 1:
        provenance["runs"] = len(runs)
    made = as_map(
        configuration,
        joined.names,
        mapped,
        method=method,
        similarity=pairs.statistic,
        notes=(*plan.note, *_unknown_pairs(pairs.known, names)),
        provenance=provenance,
        stack_level=stack_level + 1,
    )
    return made, stages


def reconstruct_from(
    *,
    similarity: ArrayLike | None = None,
    dissimilarity: ArrayLike | None = None,
    metric: ArrayLike | None = None,
    method: str = DEFAULT_METHOD,
    dimensions: Dimensions = AUTO,
    options: MethodOptions | None = None,
    noise: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    start: ArrayLike | None = None,
    names: Sequence[str] = (),
    drop: Iterable[str | int] = (),
    statistic: str = "",
) -> SensorMap:
    """Reconstruct the positions of sensors from a precomputed stage.

    Parameters
    ----------
    similarity, dissimilarity, metric : array_like of shape (N, N)
        Exactly one of them; the method continues from this stage. Only a similarity allows
        refinement of the map.
    method, options, drop
        See `reconstruct`.
    dimensions : int or "auto"
        See `reconstruct`. ``"auto"`` needs a correlation, a dissimilarity or a metric, or takes
        the number of coordinates of `start`.
    noise : array_like of shape (N, N), optional
        Sampling variance of each similarity; by default the reciprocal of
        `MethodOptions.independent_frames`.
    weights : array_like of shape (N, N), optional
        Weights of the distances in scaling; 0 marks an unknown pair.
    start : array_like of shape (N, k), optional
        Initial positions of the scaling, with k = `dimensions` if that is a number.
    names : sequence of str, optional
        Unique names of the sensors; by default the columns of a DataFrame, or ``s0, s1, ...``.
    statistic : str
        Name of the similarity, if it was computed from readings; noted in the map.

    Returns
    -------
    SensorMap
        See `reconstruct`.

    Raises
    ------
    InputError
        If not exactly one stage is given, a matrix is not symmetric, shapes disagree, or for the
        reasons given in `reconstruct`.

    Warns
    -----
    AnisomapWarning
        Once for each note of the map.
    """
    recipe, options = find_method(method), options or MethodOptions()
    check_even_spacing(method, options, readings=False)
    stage, matrix = _only_stage(
        {"similarity": similarity, "dissimilarity": dissimilarity, "metric": metric}
    )
    n_sensors = len(matrix)
    given = column_names(next(x for x in (similarity, dissimilarity, metric) if x is not None))
    names = tuple(names) or given or default_names(n_sensors)
    check_names(names, n_sensors)
    mapped = ~sensor_mask(names, drop)
    _check_size(mapped, dimensions, recipe, options)
    inside = ... if mapped.all() else np.ix_(mapped, mapped)
    matrix = matrix[inside]
    pair_weights = None if weights is None else _checked_weights(weights, n_sensors)[inside]
    if start is not None and dimensions == AUTO:
        dimensions = int(np.shape(start)[-1]) if np.ndim(start) == 2 else SPATIAL
    k = given_dimensions(dimensions)
    initial = None if start is None else _checked_start(start, n_sensors, k)[mapped]
    pairs = None
    if stage == "similarity":
        variance = 1 / options.independent_frames
        pairs = PairStatistics.from_similarity(
            matrix,
            noise=variance if noise is None else _checked_noise(noise, n_sensors)[inside],
            known=None if pair_weights is None else pair_weights > 0,
            statistic=statistic,
        )
    with limited_blas(len(matrix)):
        if pairs is not None:
            matrix = dissimilarities(pairs, method, options)
            check_unlike(pairs.similarity, rows_of=np.transpose)
        semi_metric = check_semi_metric(matrix)
        computed = semi_metric if stage == "metric" else recipe.metric(semi_metric)
        chosen = dimensions == AUTO
        examined = examined_metric(recipe, pairs, computed, options) if chosen else computed
        examine = bool(recipe.refinements) and pairs is not None
        plan = plan_dimensions(dimensions, examined, pair_weights, examine=examine)
        configuration, plan = configure(
            plan, computed, pairs, recipe, options, weights=pair_weights, start=initial
        )
    notes = plan.note
    if bool(recipe.refinements) and pairs is None:
        notes = (
            *notes,
            f"the positions are not refined: for this, {method} needs the similarity",
        )
    _check_related(configuration, options)
    provenance = options_provenance(method, options) | plan.provenance
    provenance |= {"similarity": statistic} if statistic else {"precomputed": stage}
    return as_map(
        configuration,
        names,
        mapped,
        method=method,
        similarity=statistic,
        notes=notes,
        provenance=provenance,
    )


def _check_size(
    mapped: NDArray[np.bool_], dimensions: Dimensions, recipe: Method, options: MethodOptions
) -> None:
    check_dimensions(dimensions)
    check_sensors(mapped, dimensions, options)
    check_pair_memory(int(np.count_nonzero(mapped)), refined=bool(recipe.refinements))


def check_sensors(
    mapped: NDArray[np.bool_], dimensions: Dimensions, options: MethodOptions
) -> None:
    """Check that enough sensors, given as a mask of shape (N,), are mapped."""
    n_mapped = np.count_nonzero(mapped)
    if n_mapped < options.min_sensors:
        raise InputError(
            f"a map requires at least {options.min_sensors} sensors that vary and are not "
            f"dropped, got {n_mapped} of {len(mapped)}"
        )
    if dimensions != AUTO and dimensions > n_mapped:
        raise InputError(
            f"a map in {dimensions} dimensions requires at least {dimensions} sensors, "
            f"got {n_mapped}"
        )


def check_frames(n_frames: int, dimensions: Dimensions) -> None:
    """Check that correlations of so many frames can place points.

    Centred and scaled readings of T frames are points of a sphere of T - 2 dimensions.
    """
    k = 2 if dimensions == AUTO else dimensions
    held = max(0, n_frames - 2)
    if held < k:
        raise InputError(
            f"a map in {k} dimensions requires at least {k + 2} frames, got {n_frames}, whose "
            f"correlations place sensors in at most {held} dimension{'s' * (held != 1)}"
        )


def check_unlike(*runs: Any, rows_of: Callable[[Any], NDArray[Any]] = centred_rows) -> None:
    """Check that sensors differ by more than offset, gain and sign: else all maps are alike.

    runs: Readings, each (T, n), or other matrices that have a column for each sensor.
    rows_of: Takes some columns, and returns what is alike in such sensors, up to its size.
    """
    for run, count in product(runs, (2, None)):  # nearly always, two sensors differ
        rows = rows_of(run[:, :count])
        rows = rows / np.maximum(np.abs(rows).max(axis=1), np.finfo(rows.dtype).tiny)[:, None]
        signs = np.sign(rows @ rows[0])[:, None]
        if (np.abs(signs * rows - rows[0]) > _ALIKE).any():
            return
    raise InputError(
        "all sensors read the same, but for offset and gain, so their readings do not show where "
        "they are; touch one place after another"
    )


def _check_related(configuration: Configuration, options: MethodOptions) -> None:
    if np.count_nonzero(configuration.component == 0) < options.min_sensors:
        raise InputError(
            f"a map requires at least {options.min_sensors} related sensors, but the largest group "
            f"has {np.count_nonzero(configuration.component == 0)}; check that the skin was "
            "touched during the recording"
        )


def as_map(
    configuration: Configuration,
    names: tuple[str, ...],
    mapped: NDArray[np.bool_],
    *,
    method: str,
    similarity: str,
    notes: Iterable[str],
    provenance: dict[str, Scalar],
    stack_level: int = 3,
) -> SensorMap:
    """Make a map of all sensors from the positions of the mapped ones; warn for each note."""
    refined = configuration.largest
    positions = np.full((len(names), configuration.positions.shape[1]), np.nan)
    positions[mapped] = configuration.positions
    component = np.full(len(names), UNPLACED)
    component[mapped] = configuration.component
    all_notes = (
        *notes,
        *caveats(component, names, converged=configuration.converged),
        *configuration.notes,
    )
    for note in all_notes:
        warnings.warn(note, AnisomapWarning, stacklevel=stack_level)
    return SensorMap(
        positions,
        names=names,
        component=component,
        method=method,
        similarity=similarity,
        stress=configuration.stress,
        n_iterations=configuration.n_iterations,
        uneven=refined is not None and refined.distorted,
        notes=all_notes,
        provenance=provenance
        | {"iterations": configuration.n_iterations}
        | ({} if refined is None else refined.facts),
    )


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


def _unknown_pairs(known: NDArray[np.bool_], names: Sequence[str]) -> Iterator[str]:
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
        "regularisation": options.regularisation,
        "entropy_bins": options.entropy_bins,
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


_ALIKE = 1e-5  # difference of readings in [-1, 1] by rounding, in float32
_MAX_SINGLE = 1e15  # squares of numbers up to this, and down to its inverse, fit into float32


def _only_stage(given: Mapping[str, ArrayLike | None]) -> tuple[str, Reals]:
    """Return the name and the matrix, shape (N, N), of the only stage that is given."""
    stages = [name for name, matrix in given.items() if matrix is not None]
    if len(stages) != 1:
        raise InputError(
            f"give exactly one of {', '.join(given)}; got {', '.join(stages) or 'none'}"
        )
    matrix = _as_matrix(given[stages[0]], stages[0])
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"the {stages[0]} must be of shape (N, N), got {matrix.shape}")
    return stages[0], matrix


def _as_matrix(matrix: ArrayLike | None, name: str) -> Reals:
    """Convert a matrix to the precision that is used for its size."""
    try:
        values = np.asarray(matrix)
    except ValueError:
        values = np.asarray(None)
    if values.dtype.kind not in "biuf":
        raise InputError(
            f"the {name} must be a matrix of real numbers, shape (N, N), got {values.dtype}"
        )
    dtype = float_type(len(values)) if values.ndim else np.float64
    if dtype == np.float32 and values.dtype == np.float64:
        largest = float(values.max(where=np.isfinite(values), initial=0))
        if largest and not 1 / _MAX_SINGLE < largest < _MAX_SINGLE:
            raise InputError(
                f"the largest {name} is {largest:g}, outside the range of single precision, which "
                f"is used for {len(values)} sensors; divide the matrix by its maximum"
            )
    return np.asarray(values, dtype)


def _square(matrix: ArrayLike, name: str, n_sensors: int) -> Reals:
    values = _as_matrix(matrix, name)
    if values.shape != (n_sensors, n_sensors):
        raise InputError(
            f"the {name} must be of shape ({n_sensors}, {n_sensors}), got {values.shape}"
        )
    return values


def _checked_start(start: ArrayLike, n_sensors: int, dimensions: int) -> NDArray[np.float64]:
    """Return initial positions as float64; raise `InputError` unless of shape (N, k)."""
    positions = np.asarray(start, dtype=np.float64)
    if positions.shape != (n_sensors, dimensions):
        raise InputError(
            f"the start must be of shape ({n_sensors}, {dimensions}), got {positions.shape}"
        )
    return positions


def _checked_weights(weights: ArrayLike, n_sensors: int) -> Reals:
    """Return weights, shape (N, N); raise `InputError` unless finite, >= 0 and symmetric."""
    values = _square(weights, "weights", n_sensors)
    if not np.isfinite(values).all() or (values < 0).any():
        raise InputError("weights must be finite and at least 0")
    return as_symmetric(values, "weight")


def _checked_noise(noise: ArrayLike, n_sensors: int) -> Reals:
    """Return a sampling variance, shape (N, N)."""
    values = _square(noise, "noise", n_sensors)
    n_positive = np.count_nonzero(values > 0) - np.count_nonzero(np.diag(values) > 0)
    if not np.isfinite(values).all() or n_positive < n_sensors * (n_sensors - 1):
        raise InputError("the noise must be finite and above 0, since it is a variance")
    return as_symmetric(values, "noise")
