"""The method on one page: readings become evidence, a metric, positions and a map.

McGregor et al. (2011), section "Methods". `reconstruct` starts from readings, `reconstruct_from`
from a precomputed stage; both pass these stages:

=============  ===================================  ========================================
S              `Evidence.of`                        similarity of all pairs of sensors
M              `Method.dissimilarity_of`            dissimilarity of all pairs of sensors
D              `Method.lengths_of`                  metric: shortest path lengths
dimensions     `plan_dimensions`                    their number, given or chosen
positions      `configuration.scale`                scaling by SMACOF
refinement     `refinement.refine`                  positions refined by S
=============  ===================================  ========================================
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.errors import AnisomapWarning
from anisomap.method.blocks import is_dask, sum_blocks
from anisomap.method.configuration import Configuration, configure
from anisomap.method.dimensions import (
    AUTO,
    PLANE,
    SPATIAL,
    DimensionChoice,
    Dimensions,
    check_dimensions,
    given_dimensions,
    plan_dimensions,
)
from anisomap.method.evidence import Evidence
from anisomap.method.named import METHODS, Method, find_method
from anisomap.method.options import MethodOptions
from anisomap.method.result import as_map, caveats, parameters_of, unknown_pairs
from anisomap.method.validation import (
    check_frames,
    check_related,
    check_size,
    check_unlike,
    checked_noise,
    checked_start,
    checked_weights,
    only_stage,
)
from anisomap.notes import Note
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.metric import check_semi_metric
from anisomap.numerics.precision import Reals
from anisomap.recording import (
    Recording,
    as_runs,
    check_names,
    column_names,
    default_names,
    join_runs,
    select_sensors,
    sensor_mask,
)
from anisomap.sensor_map import SensorMap


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of a map of n sensors, which a verdict can use again. metric (n, n)."""

    evidence: Evidence
    metric: Reals
    configuration: Configuration
    choice: DimensionChoice


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
        A key of `anisomap.METHODS`: ``"covariogram"`` (the default), a variant, or one of the
        paper's: ``"r-anisomap"``, ``"i-anisomap"``, ``"information-distance"`` and ``"isomap"``.
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
    recipe, options = recipe or find_method(method), options or MethodOptions()
    runs = as_runs(recording)
    joined = join_runs(runs)
    mapped = joined.varying() & ~sensor_mask(joined.names, drop)
    check_size(mapped, dimensions, options, refined=recipe.refine is not None)
    check_frames(joined.n_frames, dimensions)
    names = [joined.names[i] for i in np.flatnonzero(mapped)]
    complete = [run.complete() for run in select_sensors(runs, names)]
    check_unlike(*(run.readings for run in complete))
    with limited_blas(len(names)):
        stages = compute_stages(complete, recipe, dimensions, options)
    configuration, evidence = stages.configuration, stages.evidence
    check_related(configuration.component, options)
    facts = parameters_of(method, options, len(names)) | stages.choice.facts()
    facts |= {"source": joined.source, "frames": joined.n_frames, "similarity": evidence.statistic}
    made = as_map(
        configuration,
        joined.names,
        mapped,
        method=method,
        similarity=evidence.statistic,
        notes=(
            *stages.choice.notes(),
            *unknown_pairs(evidence, names),
            *caveats(configuration, evidence, names),
        ),
        provenance=facts if len(runs) == 1 else facts | {"runs": len(runs)},
        stack_level=stack_level + 1,
    )
    return made, stages


def compute_stages(
    runs: Sequence[Recording], recipe: Method, dimensions: Dimensions, options: MethodOptions
) -> Stages:
    """Compute all stages of the sensors of some complete recordings."""
    evidence = Evidence.of(
        runs,
        recipe.similarity_of(runs),
        bins=options.entropy_bins,
        with_variance=recipe.refine is not None,
    )
    metric = recipe.lengths_of(evidence, options)
    if recipe.shows_dimensions:
        choice = plan_dimensions(
            dimensions, metric, evidence.weights, common_share=evidence.common_share
        )
    elif dimensions == AUTO:  # other metrics need not show the dimensions
        choice = compute_stages(runs, METHODS[DEFAULT_METHOD], AUTO, options).choice
    else:
        choice = plan_dimensions(dimensions, None)
    configuration, choice = _confirmed(choice, metric, evidence, recipe, options)
    return Stages(evidence, metric, configuration, choice)


def _confirmed(
    choice: DimensionChoice,
    metric: Reals,
    evidence: Evidence,
    recipe: Method,
    options: MethodOptions,
) -> tuple[Configuration, DimensionChoice]:
    """Make the map; if its number of dimensions was chosen, confirm or reject it by the other map.

    metric (n, n).
    """

    def made(dimensions: int) -> Configuration:
        return configure(metric, evidence, dimensions, recipe, options, weights=evidence.weights)

    found = made(choice.dimensions)
    if choice.given or choice.line or not choice.shown or found.largest is None:
        return found, choice
    other = made(PLANE + SPATIAL - choice.dimensions)
    if other.largest is None:
        return found, choice
    flat, spatial = (found, other) if choice.dimensions == PLANE else (other, found)
    explained = other.largest.unexplained - found.largest.unexplained
    confirmed = choice.confirmed(explained if found is spatial else -explained)
    return spatial if confirmed.dimensions == SPATIAL else flat, confirmed


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
    stage, matrix = only_stage(
        {"similarity": similarity, "dissimilarity": dissimilarity, "metric": metric}
    )
    n_sensors = len(matrix)
    given = column_names(next(x for x in (similarity, dissimilarity, metric) if x is not None))
    names = tuple(names) or given or default_names(n_sensors)
    check_names(names, n_sensors)
    mapped = ~sensor_mask(names, drop)
    check_size(mapped, dimensions, options, refined=recipe.refine is not None)
    inside = ... if mapped.all() else np.ix_(mapped, mapped)
    matrix = matrix[inside]
    pair_weights = None if weights is None else checked_weights(weights, n_sensors)[inside]
    if start is not None and dimensions == AUTO:
        dimensions = int(np.shape(start)[-1]) if np.ndim(start) == 2 else SPATIAL
    k = given_dimensions(dimensions)
    initial = None if start is None else checked_start(start, n_sensors, k)[mapped]
    evidence = None
    if stage == "similarity":
        evidence = Evidence.from_similarity(
            matrix,
            variance=1 / options.independent_frames
            if noise is None
            else checked_noise(noise, n_sensors)[inside],
            known=None if pair_weights is None else pair_weights > 0,
            statistic=statistic,
        )
    with limited_blas(len(matrix)):
        if evidence is not None:
            lengths = recipe.lengths_of(evidence, options)
            check_unlike(evidence.similarity, rows_of=np.transpose)
        else:
            semi_metric = check_semi_metric(matrix)
            lengths = semi_metric if stage == "metric" else recipe.metric(semi_metric)
        shown = _showing_dimensions(lengths, evidence, recipe, options)
        examine = dimensions == AUTO or (evidence is not None and recipe.shows_dimensions)
        choice = plan_dimensions(dimensions, shown if examine else None, pair_weights)
        configuration = configure(
            lengths,
            evidence,
            choice.dimensions,
            recipe,
            options,
            weights=pair_weights,
            start=initial,
        )
    check_related(configuration.component, options)
    objects = stage == "dissimilarity"
    notes = [*choice.notes(objects=objects), *caveats(configuration, evidence, names)]
    if recipe.refine is not None and evidence is None:
        notes.append(Note("not-refined", method=method))
    facts = parameters_of(method, options, len(matrix)) | choice.facts(objects=objects)
    facts |= {"similarity": statistic} if statistic else {"precomputed": stage}
    return as_map(
        configuration,
        names,
        mapped,
        method=method,
        similarity=statistic,
        notes=notes,
        provenance=facts,
        objects=objects,
    )


def _showing_dimensions(
    metric: Reals, evidence: Evidence | None, recipe: Method, options: MethodOptions
) -> Reals | None:
    """Return the metric, (n, n), from which the number of dimensions can be chosen, if any."""
    if evidence is None or recipe.shows_dimensions:
        return metric
    if recipe.similarity == "mutual-information":
        return None
    default = METHODS[DEFAULT_METHOD]
    return default.lengths_of(evidence, options)
