"""From a recording to a map: what takes part, the method's stages, scaling, and the doubts."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap._version import __version__
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.confidence import (
    DOUBTFUL,
    FEWEST_TO_JUDGE,
    agreement_of_halves,
    expected_mantel_r,
)
from anisomap.health import SensorHealth, assess, weaknesses
from anisomap.memory import check_pair_memory
from anisomap.methods import (
    DEFAULT_METHOD,
    MethodOptions,
    check_priors,
    compute_stages,
    find_method,
)
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Reals, float_type
from anisomap.pieces import Pieces, refine_pieces, scale_pieces
from anisomap.recording import Recording, Scalar, check_names, default_names, find_sensors
from anisomap.sensor_map import UNPLACED, SensorMap
from anisomap.wording import join_items

logger = logging.getLogger(__name__)

_SINGLE_RANGE = 1e15


def reconstruct(
    recording: Recording | None = None,
    method: str = DEFAULT_METHOD,
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    similarity: ArrayLike | None = None,
    dissimilarity: ArrayLike | None = None,
    metric: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    start: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    names: Iterable[str] = (),
    exclude: Iterable[str | int] = (),
    drop: Iterable[str | int] = (),
    health: Sequence[SensorHealth] | None = None,
    judge: bool = True,
) -> SensorMap:
    """Make a map of the sensors from what they read.

    Parameters
    ----------
    recording : Recording, optional
        What was read. May be left out if one of the stages below is given.
    method : str
        A name in `METHODS`.
    dimensions : int
        Of the space to map into: 1, 2 or 3, or more.
    options : MethodOptions, optional
    similarity, dissimilarity, metric : array_like of shape (N, N), optional
        A stage that is known already: the method sets in behind the last one given.
    noise : array_like of shape (N, N), optional
        Sampling variance of a given similarity, for methods that ask how far it can be believed;
        see `anisomap.methods.MethodOptions.independent_frames` for what it is else.
    start : array_like of shape (N, k), optional
        Positions to start scaling from, with k = `dimensions`.
    weights : array_like of shape (N, N), optional
        How much each distance counts in scaling; 0 is unknown. The covariogram method looks only
        at which are 0.
    names : iterable of str, optional
        Names of the sensors, where there is no recording to name them.
    exclude : iterable of str or int
        Sensors, by name or index, that take part but are left out of scores (as the paper does
        with its failed sensor 30).
    drop : iterable of str or int
        Sensors to leave out altogether.
    health : sequence of SensorHealth, optional
        An assessment of the recording, if it is at hand already.
    judge : bool
        Whether to find out how far the map can be trusted (`SensorMap.confidence`), with the
        methods that refine their maps: takes as long as two to four more maps.

    Returns
    -------
    SensorMap
        In the order of the recording, known up to rotation, translation, scale and mirror image.
        Sensors that never vary or were dropped have no position. `SensorMap.notes` says what
        speaks against the map.

    Raises
    ------
    InputError
        If a reading is missing (see `Recording.complete`), fewer than 3 sensors vary or are
        related to one another, the method or a sensor is unknown, a given stage does not fit, or
        there are more sensors than the machine has memory for.

    Warns
    -----
    AnisomapWarning
        Once for each of the notes.

    Notes
    -----
    McGregor et al. (2011), section "Methods", doi:10.1371/journal.pone.0026561.
    """
    recipe = find_method(method)
    chosen = options or MethodOptions()
    if dimensions < 1:
        raise InputError(f"{dimensions} dimensions hold no map; use 2 or 3")
    given = {"similarity": similarity, "dissimilarity": dissimilarity, "metric": metric}
    matrices = {
        what: _as_held(matrix, what) for what, matrix in given.items() if matrix is not None
    }
    n_sensors = _count_sensors(recording, matrices)
    sensor_names = (tuple(names) if recording is None else recording.names) or default_names(
        n_sensors
    )
    check_names(sensor_names, n_sensors)
    dropped = _mask(sensor_names, drop)
    taking_part = ~dropped if recording is None else recording.varying() & ~dropped
    if np.count_nonzero(taking_part) < chosen.fewest_sensors:
        raise InputError(
            f"only {np.count_nonzero(taking_part)} of {n_sensors} sensors take part (those that "
            f"ever vary and are not dropped); a map takes at least {chosen.fewest_sensors}"
        )
    part = ... if taking_part.all() else np.ix_(taking_part, taking_part)
    check_pair_memory(int(np.count_nonzero(taking_part)), refined=recipe.refine is not None)
    counts = None if weights is None else _checked_weights(weights, n_sensors)[part]
    everything_known = counts is None or bool((counts[~np.eye(len(counts), dtype=bool)] > 0).all())
    check_priors(
        method, chosen, readings=recording is not None and not matrices and everything_known
    )
    stages = compute_stages(
        None if recording is None or matrices else _readings_of(recording, taking_part),
        method,
        chosen,
        **{what: matrix[part] for what, matrix in matrices.items()},
        noise=None if noise is None else _checked_noise(noise, n_sensors)[part],
        known=None if counts is None else counts > 0,
    )
    pieces = scale_pieces(
        stages.metric,
        dimensions,
        start=None if start is None else _checked_start(start, n_sensors, dimensions)[taking_part],
        weights=counts,
        options=chosen.smacof,
    )
    if recipe.refine is not None and stages.evidence is not None:
        pieces = refine_pieces(recipe.refine, stages.evidence, stages.metric, pieces, chosen)
    if np.count_nonzero(pieces.labels == 0) < chosen.fewest_sensors:
        raise InputError(
            f"no {chosen.fewest_sensors} sensors are related to one another, so there is nothing "
            "to map; was the skin touched during the recording?"
        )
    positions = np.full((n_sensors, dimensions), np.nan)
    positions[taking_part] = pieces.positions
    component = np.full(n_sensors, UNPLACED)
    component[taking_part] = pieces.labels
    if health is None:
        health = () if recording is None else assess(recording)
    notes: list[str] = []
    if recording is not None:
        kept = [sensor for sensor, out in zip(health, dropped, strict=True) if not out]
        notes += weaknesses(recording, kept)
    notes += _doubts(component, sensor_names, pieces)
    notes += pieces.notes
    if recipe.refine is not None and stages.evidence is None:
        notes.append(
            f"{method} looks at how alike sensors are, which was not given: this map is its start, "
            "the scaled distances"
        )
    confidence = math.nan
    if judge and recipe.refine is not None and recording is not None and counts is None:
        confidence = _confidence(
            # Of none, where a stage was given: what the readings would say of it, nobody knows.
            recording.readings[:, [] if matrices else component == 0],
            dimensions,
            chosen,
            squeezed=bool(pieces.facts.get("uneven")),
        )
        notes += _lacks_evidence(confidence)
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    return SensorMap(
        positions,
        names=sensor_names,
        component=component,
        health=tuple(sensor.status for sensor in health),
        excluded=_mask(sensor_names, exclude),
        method=method,
        stress=pieces.stress,
        confidence=confidence,
        notes=tuple(notes),
        provenance=_provenance(recording, method, chosen, matrices)
        | {"iterations": pieces.iterations}
        | dict(pieces.facts),
    )


def _confidence(
    readings: NDArray[np.floating],
    dimensions: int,
    options: MethodOptions,
    *,
    squeezed: bool,
) -> float:
    """Tell how far a map of one piece can be trusted, from maps of halves of its recording.

    These are by the default method, for which it was found out what their agreement means.
    """
    if readings.shape[1] < FEWEST_TO_JUDGE:
        return math.nan
    whole = replace(options, part=False)

    def place(half: NDArray[np.floating]) -> NDArray[np.float64]:
        made = reconstruct(Recording(half), DEFAULT_METHOD, dimensions, options=whole, judge=False)
        return made.positions

    logger.info("making maps of halves of the recording, to judge the map")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # halves are short; that is the point
        confidence = expected_mantel_r(agreement_of_halves(readings, place))
    # What is squeezed comes out squeezed again.
    return math.nan if squeezed and confidence >= DOUBTFUL else confidence


def _lacks_evidence(confidence: float) -> Iterator[str]:
    if confidence < DOUBTFUL:
        yield (
            f"the evidence does not suffice: halves of the recording make different maps, so this "
            f"one is expected to reach a Mantel r of {confidence:.2f} only; record longer, and "
            "touch all of the skin"
        )


def _readings_of(recording: Recording, sensors: NDArray[np.bool_]) -> NDArray[np.floating]:
    readings = recording.complete().readings
    return readings if sensors.all() else readings[:, sensors]


def _count_sensors(recording: Recording | None, matrices: Mapping[str, NDArray[np.generic]]) -> int:
    """Count the sensors, and check that everything given is of the same ones."""
    shapes = {what: matrix.shape for what, matrix in matrices.items()}
    if recording is not None:
        shapes = {"recording": (recording.n_sensors, recording.n_sensors), **shapes}
    if not shapes:
        raise InputError("there is nothing to map: give a recording, or a precomputed stage")
    first, expected = next(iter(shapes.items()))
    for what, shape in shapes.items():
        if len(shape) != 2 or shape[0] != shape[1] or shape != expected:
            raise InputError(
                f"the {what} has shape {shape}; it must be square, and of as many sensors as "
                f"the {first}"
            )
    return int(expected[0])


def _as_held(matrix: ArrayLike, what: str) -> Reals:
    """Give a matrix in the type in which so many sensors are held, if it can be held in it."""
    try:
        values = np.asarray(matrix)
    except ValueError:
        values = np.asarray(None)
    if values.dtype.kind not in "biuf":
        raise InputError(f"the {what} is no matrix of real numbers; it must be of shape (N, N)")
    dtype = float_type(len(values)) if values.ndim else np.float64
    if dtype == np.float32 and values.dtype == np.float64:
        largest = float(values.max(where=np.isfinite(values), initial=0))
        if largest and not 1 / _SINGLE_RANGE < largest < _SINGLE_RANGE:
            raise InputError(
                f"the {what} reaches {largest:g}; of so many sensors matrices are held in single "
                "precision: divide it by that, so that its greatest number is 1"
            )
    return np.asarray(values, dtype)


def _mask(names: tuple[str, ...], sensors: Iterable[str | int]) -> NDArray[np.bool_]:
    mask = np.zeros(len(names), dtype=bool)
    mask[find_sensors(names, sensors)] = True
    return mask


def _checked_start(start: ArrayLike, n_sensors: int, dimensions: int) -> NDArray[np.float64]:
    positions = np.asarray(start, dtype=np.float64)
    if positions.shape != (n_sensors, dimensions):
        raise InputError(
            f"the start has shape {positions.shape}; it must be ({n_sensors}, {dimensions})"
        )
    return positions


def _checked_weights(weights: ArrayLike, n_sensors: int) -> Reals:
    values = _square(weights, "weights", n_sensors)
    if not np.isfinite(values).all() or (values < 0).any():
        raise InputError("weights must be finite and at least 0")
    return as_symmetric(values, "weight")


def _checked_noise(noise: ArrayLike, n_sensors: int) -> Reals:
    values = _square(noise, "noise", n_sensors)
    n_positive = np.count_nonzero(values > 0) - np.count_nonzero(np.diag(values) > 0)
    if not np.isfinite(values).all() or n_positive < n_sensors * (n_sensors - 1):
        raise InputError("the noise is a variance: it must be finite, and above 0")
    return as_symmetric(values, "noise")


def _square(matrix: ArrayLike, what: str, n_sensors: int) -> Reals:
    values = _as_held(matrix, what)
    if values.shape != (n_sensors, n_sensors):
        raise InputError(
            f"the {what} have shape {values.shape}; they must be ({n_sensors}, {n_sensors})"
            if what == "weights"
            else f"the {what} has shape {values.shape}; it must be ({n_sensors}, {n_sensors})"
        )
    return values


def _doubts(component: NDArray[np.intp], names: tuple[str, ...], pieces: Pieces) -> Iterator[str]:
    sizes = np.bincount(component[component != UNPLACED])
    if sizes.size > 1:
        lost = [names[i] for i in np.flatnonzero(component > 0)]
        yield (
            f"the sensors fall into {sizes.size} separate pieces (of {join_items(sizes.tolist())} "
            "sensors), and how these lie to one another is not known; "
            f"outside the largest: {join_items(lost)}"
        )
    if not pieces.converged:
        yield "scaling stopped before it converged: allow it more iterations"


def _provenance(
    recording: Recording | None,
    method: str,
    options: MethodOptions,
    precomputed: Iterable[str],
) -> dict[str, Scalar]:
    facts: dict[str, Scalar] = {"anisomap": __version__}
    if recording is not None:
        facts |= {"source": recording.source, "frames": recording.n_frames}
    facts |= {"similarity": find_method(method).similarity, "mu": options.mu, "bins": options.bins}
    if options.n_neighbours is not None:
        facts["n_neighbours"] = options.n_neighbours
    if given := " ".join(precomputed):
        facts["precomputed"] = given
    if find_method(method).refine is not None:
        usual = asdict(CovariogramOptions())
        changed = {k: v for k, v in asdict(options.covariogram).items() if v != usual[k]}
        facts |= {f"covariogram_{name}": value for name, value in changed.items()}
        usual_options = MethodOptions()
        for name in ("part", "independent_frames"):
            if getattr(options, name) != getattr(usual_options, name):
                facts[name] = getattr(options, name)
    return facts | asdict(options.smacof)
