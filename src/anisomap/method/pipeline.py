"""The method on one page: from readings to evidence, a metric, positions and a map.

McGregor et al. (2011), section "Methods". Readings, blocks of a Dask array and precomputed matrices
are converted to `Evidence` or to a metric, which `_map` converts to a map.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from anisomap.base import DEFAULT_METHOD
from anisomap.errors import AnisomapWarning, InputError
from anisomap.method.blocks import sum_blocks
from anisomap.method.configuration import (
    Configuration,
    Task,
    as_map,
    caveats,
    configure,
    parameters_of,
    unknown_pairs,
)
from anisomap.method.dimensions import (
    AUTO,
    PLANE,
    SPATIAL,
    DimensionChoice,
    Dimensions,
    check_dimensions,
    check_size,
    plan_dimensions,
)
from anisomap.method.evidence import Evidence, check_unlike
from anisomap.method.named import DEFAULT_OPTIONS, METHODS, Method, MethodOptions, find_method
from anisomap.names import check_names, column_names, default_names, sensor_mask
from anisomap.notes import Note
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import check_semi_metric
from anisomap.numerics.precision import Floats, Reals, check_pair_memory, float_type
from anisomap.recording import Recording, Scalar, join_runs
from anisomap.sensor_map import SensorMap


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of a map of n sensors, which a verdict can reuse. metric (n, n).

    other: The map in the other number of dimensions, if the number was chosen from the readings.
    """

    evidence: Evidence
    metric: Reals
    configuration: Configuration
    choice: DimensionChoice
    other: Configuration | None = None


_Placed: TypeAlias = tuple[Configuration, DimensionChoice, Configuration | None]


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
        Complete readings (see `Recording.complete`). Several recordings of one skin result in one
        map: sensors are matched by name, and each pair is compared over the runs that contain both.
        The blocks of a Dask array are compared where Dask runs, by methods without refinement.
    method : str
        A key of `anisomap.METHODS`: ``"covariogram"`` (the default), a variant, or a method of the
        paper: ``"r-anisomap"``, ``"i-anisomap"``, ``"information-distance"`` or ``"isomap"``.
    dimensions : int or "auto"
        Number of coordinates: 2 for flat skins, 3 for bodies. ``"auto"`` chooses 2 or 3, see Notes;
        if the choice is not clear, it is 3, and the map has a note.
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
        If a reading is missing, fewer than 3 sensors vary or are related, all sensors differ only
        by offset and gain, the method or a sensor is unknown, `dimensions` is less than 1 or more
        than the number of mapped sensors, or the matrices of all pairs do not fit in memory.

    Warns
    -----
    AnisomapWarning
        Once for each note of the map.

    Notes
    -----
    McGregor et al. (2011), section "Methods", doi:10.1371/journal.pone.0026561: the similarity S is
    converted to a dissimilarity M (step 1 of ANISOMAP), M to the metric D of shortest path lengths
    (step 2), and D is scaled to positions (step 3). Some methods, including the default, then
    refine the positions by S. This refinement is not part of the paper.

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
    graph = getattr(recording, "__dask_graph__", None)  # without an import of Dask
    if callable(graph) and graph() is not None:  # an array of xarray in memory has no graph
        return _reconstruct_blocks(recording, method, dimensions, options or DEFAULT_OPTIONS, drop)
    return reconstruct_with_stages(
        recording, method, dimensions, options=options, drop=drop, stack_level=3
    )[0]


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
    """Reconstruct positions; also return the stages, which `anisomap.diagnose` can reuse."""
    recipe, options = recipe or find_method(method), options or DEFAULT_OPTIONS
    joined = join_runs(recording)
    mapped = joined.varying() & ~sensor_mask(joined.names, drop)
    n_mapped = int(np.count_nonzero(mapped))
    least, total = options.min_sensors, mapped.size
    check_size(dimensions, n_mapped, joined.n_frames, least=least, total=total)
    check_pair_memory(n_mapped, refined=recipe.refine is not None)
    complete = joined.select(mapped).complete()
    check_unlike(*(part.readings for part in complete.parts))

    def compared(recipe: Method) -> Evidence:
        return Evidence.of(
            complete,
            recipe.similarity_of(complete),
            bins=options.entropy_bins,
            with_variance=recipe.refine is not None,
        )

    facts: dict[str, Scalar] = {"source": joined.source, "frames": joined.n_frames}
    facts |= {"runs": len(joined.starts) + 1} if joined.starts else {}
    with limited_blas(n_mapped):
        evidence = compared(recipe)
        facts |= {"similarity": evidence.statistic}
        whole = bool(evidence.known.all())
        task = Task(
            evidence,
            recipe.lengths_of(evidence, options),
            *(joined.names, mapped, method, recipe, dimensions, options),
            usual=compared,
            facts=facts,
            notes=() if whole else (unknown_pairs(evidence, complete.names),),
            weights=None if whole else evidence.known.astype(np.float64),
        )
        made, placed = _map(task, stack_level + 1)
    return made, Stages(evidence, task.metric, *placed)


def _reconstruct_blocks(
    readings: Any,
    method: str,
    dimensions: Dimensions,
    options: MethodOptions,
    drop: Iterable[str | int],
) -> SensorMap:
    """Reconstruct positions from a Dask array of readings, shape (T, N)."""
    check_dimensions(dimensions)
    statistic = find_method(method).similarity
    found = sum_blocks(readings, statistic, options.entropy_bins)
    total = len(found.varying)
    dropped = sensor_mask(default_names(total), drop) | ~found.varying
    n_mapped, least = total - int(np.count_nonzero(dropped)), options.min_sensors
    check_size(dimensions, n_mapped, found.n_frames, least=least, total=total)
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
        Exactly one must be given; the method continues from this stage. Only a map from a
        similarity can be refined.
    method, options, drop
        See `reconstruct`.
    dimensions : int or "auto"
        See `reconstruct`. ``"auto"`` requires a correlation, a dissimilarity or a metric; if
        `start` is given, its number of coordinates is used.
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
    recipe, options = find_method(method), options or DEFAULT_OPTIONS
    stage, matrix = _only_stage(
        {"similarity": similarity, "dissimilarity": dissimilarity, "metric": metric}
    )
    n_sensors = len(matrix)
    given = column_names(next(x for x in (similarity, dissimilarity, metric) if x is not None))
    names = tuple(names) or given or default_names(n_sensors)
    check_names(names, n_sensors)
    mapped = ~sensor_mask(names, drop)
    n_mapped = int(np.count_nonzero(mapped))
    check_size(dimensions, n_mapped, None, least=options.min_sensors, total=n_sensors)
    check_pair_memory(n_mapped, refined=recipe.refine is not None)
    inside = ... if mapped.all() else np.ix_(mapped, mapped)
    matrix = matrix[inside]
    pair_weights = None if weights is None else _checked_weights(weights, n_sensors)[inside]
    if start is not None and dimensions == AUTO:
        dimensions = int(np.shape(start)[-1]) if np.ndim(start) == 2 else SPATIAL
    initial: Floats | None = None
    if start is not None:
        initial, shape = np.asarray(start, dtype=np.float64), (n_sensors, dimensions)
        if initial.shape != shape:
            raise InputError(f"the start must be of shape {shape}, got {initial.shape}")
        initial = initial[mapped]
    evidence = None
    with limited_blas(len(matrix)):
        if stage == "similarity":
            evidence = Evidence.from_similarity(
                matrix,
                variance=1 / options.independent_frames
                if noise is None
                else _checked_noise(noise, n_sensors)[inside],
                known=None if pair_weights is None else pair_weights > 0,
                statistic=statistic,
            )
            lengths = recipe.lengths_of(evidence, options)
            check_unlike(evidence.similarity, rows_of=np.transpose)
        else:
            lengths = check_semi_metric(matrix)
            lengths = lengths if stage == "metric" else recipe.metric(lengths)
        refined = evidence is not None or recipe.refine is None
        is_correlation = recipe.similarity != "mutual-information"
        facts = {"similarity": statistic} if statistic else {"precomputed": stage}
        task = Task(
            *(evidence, lengths, names, mapped, method, recipe, dimensions, options),
            usual=lambda _: evidence if is_correlation else None,
            facts=facts,
            notes=() if refined else (Note("not-refined", method=method),),
            weights=pair_weights,
            start=initial,
            objects=stage == "dissimilarity",
        )
        return _map(task, stack_level=3)[0]


def _map(task: Task, stack_level: int) -> tuple[SensorMap, _Placed]:
    """Make the map of evidence or of a metric, with its notes and its provenance."""
    placed = configuration, choice, _ = _placed(task)
    least, largest = task.options.min_sensors, np.count_nonzero(configuration.component == 0)
    if largest < least:
        raise InputError(f"only {largest} sensors are related, but {least} are needed; touch more")
    names = [task.names[i] for i in np.flatnonzero(task.mapped).tolist()]
    facts = parameters_of(task.method, task.options, len(names))
    facts |= {} if choice.given else choice.facts(objects=task.objects)
    made = as_map(
        configuration,
        *(task.names, task.mapped, task.method),
        similarity="" if task.evidence is None else task.evidence.statistic,
        notes=(
            *(choice.notes(objects=task.objects) if choice.examined else ()),
            *task.notes,
            *caveats(configuration, task.evidence, names),
        ),
        provenance={**facts, **task.facts},
        objects=task.objects,
        stack_level=stack_level + 1,
    )
    return made, placed


def _placed(task: Task) -> _Placed:
    """Choose the number of dimensions, and scale and refine the metric.

    A chosen number is confirmed or rejected by the map in the other number, also returned.
    """
    choice = _choice(task)
    found = configure(task, choice.dimensions)
    if choice.given or choice.line or found.largest is None:
        return found, choice, None
    other = configure(task, PLANE + SPATIAL - choice.dimensions)
    if not choice.shown or other.largest is None:
        return found, choice, other
    explained = other.largest.unexplained - found.largest.unexplained
    confirmed = choice.confirmed(explained if choice.dimensions == SPATIAL else -explained)
    if confirmed.dimensions == choice.dimensions:
        return found, confirmed, other
    return other, confirmed, found


def _choice(task: Task) -> DimensionChoice:
    """Choose the number of dimensions, from the metric of the default method if possible."""
    evidence, dimensions, default = task.evidence, task.dimensions, METHODS[DEFAULT_METHOD]
    if evidence is None:
        metric = task.metric if dimensions == AUTO else None
        return plan_dimensions(dimensions, metric, task.weights)
    if task.recipe.refine is not None:
        share = evidence.common_share
        return plan_dimensions(dimensions, task.metric, task.weights, common_share=share)
    if dimensions == AUTO and (usual := task.usual(default)) is not None:
        lengths = default.lengths_of(usual, task.options)
        return _placed(replace(task, evidence=usual, metric=lengths, recipe=default))[1]
    return plan_dimensions(dimensions, None)


_MAX_SINGLE = 1e15  # float32 represents squares of numbers from its inverse to it


def _only_stage(given: Mapping[str, ArrayLike | None]) -> tuple[str, Reals]:
    """Return the name and the matrix, shape (N, N), of the given stage; raise unless it is one."""
    stages = [name for name, matrix in given.items() if matrix is not None]
    if len(stages) != 1:
        raise InputError(f"give one of {', '.join(given)}; got {', '.join(stages) or 'none'}")
    return stages[0], _as_matrix(given[stages[0]], stages[0])


def _as_matrix(matrix: ArrayLike | None, name: str, n_sensors: int | None = None) -> Reals:
    """Convert a matrix of all pairs to the float type for its size."""
    try:
        values = np.asarray(matrix)
    except ValueError:
        values = np.asarray(None)
    if values.dtype.kind not in "biuf":
        raise InputError(f"the {name} must be (N, N) real numbers, got {values.dtype}")
    n = n_sensors or (len(values) if values.ndim else 0)
    if values.shape != (n, n):
        shape = "(N, N)" if n_sensors is None else f"({n}, {n})"
        raise InputError(f"the {name} must be of shape {shape}, got {values.shape}")
    dtype = float_type(n)
    if dtype == np.float32 and values.dtype == np.float64:
        largest = float(values.max(where=np.isfinite(values), initial=0))
        if largest and not 1 / _MAX_SINGLE < largest < _MAX_SINGLE:
            raise InputError(f"the {name} {largest:g} exceeds single precision; divide all by it")
    return np.asarray(values, dtype)


def _checked_weights(weights: ArrayLike, n_sensors: int) -> Reals:
    """Return weights, shape (N, N), finite, symmetric and at least 0."""
    values = _as_matrix(weights, "weights", n_sensors)
    if not np.isfinite(values).all() or (values < 0).any():
        raise InputError("weights must be finite and at least 0")
    return as_symmetric(values, "weight")


def _checked_noise(noise: ArrayLike, n_sensors: int) -> Reals:
    """Return a sampling variance, shape (N, N)."""
    values = _as_matrix(noise, "noise", n_sensors)
    n_positive = np.count_nonzero(values > 0) - np.count_nonzero(np.diag(values) > 0)
    if not np.isfinite(values).all() or n_positive < n_sensors * (n_sensors - 1):
        raise InputError("the noise must be finite and above 0, since it is a variance")
    return as_symmetric(values, "noise")
