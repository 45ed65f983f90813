"""Exact maps of many sensors on a GPU, through the array API standard."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.method.dimensions import AUTO, check_dimensions
from anisomap.method.named import find_method
from anisomap.method.options import MethodOptions
from anisomap.method.pipeline import Configuration
from anisomap.method.reconstruction import (
    as_map,
    check_frames,
    check_sensors,
    check_unlike,
    options_provenance,
)
from anisomap.numerics import array_api
from anisomap.numerics.array_api import Array
from anisomap.numerics.columns import centred_rows
from anisomap.recording import check_names, default_names
from anisomap.sensor_map import SensorMap

logger = logging.getLogger(__name__)

DEVICE_METHODS: Mapping[str, Callable[[Array, int], Array]] = MappingProxyType(
    {
        "r-anisomap": lambda x, _: array_api.pearson(x),
        "spearman-anisomap": lambda x, _: array_api.spearman(x),
        "i-anisomap": array_api.mutual_information,
    }
)
"""Methods that run on a device, and the functions of readings and bins that compare sensors."""


def reconstruct_on_device(
    readings: Array,
    method: str = "r-anisomap",
    dimensions: int = 3,
    *,
    options: MethodOptions | None = None,
    names: Sequence[str] = (),
) -> SensorMap:
    """Reconstruct the positions of sensors on the device that holds their readings.

    Parameters
    ----------
    readings : array of shape (T, N)
        Finite readings, as an array of CuPy (``cupy.asarray(readings)``), PyTorch or another
        library of the array API standard. About four matrices of shape (N, N) must fit in the
        memory of the device, in float32 from 2,000 sensors on.
    method : {"r-anisomap", "spearman-anisomap", "i-anisomap"}
        See `anisomap.METHODS`.
    dimensions : int
        Number of coordinates: 2 for flat skins, 3 for bodies.
    options : MethodOptions, optional
        Only `regularisation`, which must be above 0, `entropy_bins`, `smacof` and `min_sensors` are
        used. From 500 sensors on, L-BFGS minimises the stress, whatever the `solver`.
    names : sequence of str, optional
        Names of the sensors; by default ``s0, s1, ...``.

    Returns
    -------
    SensorMap
        The map of `anisomap.reconstruct`, up to rounding; NaN for constant sensors.

    Raises
    ------
    InputError
        If a reading is not finite, if fewer than `min_sensors` sensors vary, if all read the same
        but for offset and gain, if `regularisation` is 0, or if the method, the dimensions, the
        number of frames or the names are invalid.
    MissingExtraError
        If the compatibility layer of the array API standard (extra ``gpu``) is not installed.

    Warns
    -----
    AnisomapWarning
        Once for each note of the map.

    Notes
    -----
    The stages of McGregor et al. (2011), section "Methods", doi:10.1371/journal.pone.0026561.
    ``docs/explanation/large-recordings.md`` lists the time that each takes.

    Examples
    --------
    With a numpy array, numpy computes the map:

    >>> import numpy as np
    >>> from anisomap.large import reconstruct_on_device
    >>> places, touches = np.arange(12), np.random.default_rng(0).uniform(0, 11, (2000, 1))
    >>> readings = np.maximum(0, 2 - abs(touches - places))
    >>> sensor_map = reconstruct_on_device(readings, dimensions=1)
    >>> bool(abs(np.corrcoef(sensor_map.positions[:, 0], places)[0, 1]) > 0.99)
    True
    """
    chosen = options or MethodOptions()
    check_dimensions(dimensions)
    if str(dimensions) == AUTO:
        raise InputError("dimensions are not chosen on a device: take 2 for flat skins, or 3")
    if method not in DEVICE_METHODS:
        able = ", ".join(DEVICE_METHODS)
        raise InputError(f"{method} does not run on a device; choose from {able}")
    if chosen.regularisation == 0:
        raise InputError(
            "with regularisation 0, unrelated sensors are infinitely far apart; give more than 0"
        )
    similarity = find_method(method).similarity
    if readings.ndim != 2:
        raise InputError(f"readings must be of shape (T, N), got {tuple(readings.shape)}")
    n_frames, n_sensors = readings.shape
    names = tuple(names) or default_names(n_sensors)
    check_names(names, n_sensors)
    check_frames(n_frames, dimensions)
    readings = array_api.as_numbers(readings)
    varying = _varying(readings)
    check_sensors(varying, dimensions, chosen)
    if not varying.all():
        readings = array_api.select_columns(readings, varying)
    check_unlike(readings, rows_of=lambda some: centred_rows(array_api.to_numpy(some)))
    logger.info("comparing all pairs of sensors (%s)", similarity)
    compared = DEVICE_METHODS[method](readings, chosen.entropy_bins)
    lengths = array_api.regularised_reciprocal(compared, chosen.regularisation)
    del compared
    logger.info("computing shortest paths")
    metric = array_api.metricise(lengths)
    del lengths
    logger.info("scaling %d sensors into %d dimensions", metric.shape[0], dimensions)
    scaling = array_api.scale(metric, int(dimensions), chosen.smacof)
    configuration = Configuration(
        positions=scaling.positions,
        component=np.zeros(len(scaling.positions), np.intp),
        stress=scaling.stress,
        converged=scaling.converged,
        n_iterations=len(scaling.trace) - 1,
    )
    return as_map(
        configuration,
        names,
        varying,
        method=method,
        similarity=similarity,
        notes=(),
        provenance=options_provenance(method, chosen)
        | {
            "frames": int(n_frames),
            "similarity": similarity,
            "array_library": array_api.array_namespace(readings).__name__.rpartition(".")[2],
        },
    )


def _varying(readings: Array) -> NDArray[np.bool_]:
    """Check that readings (T, N) are finite, and return which sensors vary, (N,)."""
    xp = array_api.array_namespace(readings)
    lowest = array_api.to_numpy(xp.min(readings, axis=0))
    highest = array_api.to_numpy(xp.max(readings, axis=0))
    faulty = np.flatnonzero(~(np.isfinite(lowest) & np.isfinite(highest)))
    if faulty.size:
        raise InputError(
            f"a reading of sensor {faulty[0]} is not a finite number; replace missing readings "
            "before a map is made on a device"
        )
    return np.asarray(highest > lowest)
