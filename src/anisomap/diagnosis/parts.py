"""Repeatability of a map, from maps of halves of the recording.

The recording is split into two halves of alternating blocks of time, and each half is mapped. The
differences of these maps measure random errors, not systematic ones, which all share.

The components of a map, with the stages that they were computed from, for its diagnosis.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.diagnosis.resampling import departure_in_spacings
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.evaluation.scoring import align, median_spacing
from anisomap.evidence import PairStatistics, compare
from anisomap.mapping import Stages, configure_pairs
from anisomap.methods import find_method
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.reliability.split_half import N_BLOCKS, split_blocks
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct_with_stages
from anisomap.recording import Recording
from anisomap.refinements.chain import RefinedMap
from anisomap.sensor_map import SensorMap

MIN_SENSORS = 12
"""Minimum number of sensors: maps of fewer agree too often by chance."""

MIN_FRAMES = 4 * N_BLOCKS
"""Minimum number of frames."""

Frames = NDArray[np.intp]


def repeatability_of_halves(
    n_frames: int,
    positions: NDArray[np.float64],
    place: Callable[[Frames], NDArray[np.float64]],
) -> float:
    """Measure the random error of a map by maps of halves of the recording.

    positions (N, k).

    If a map of all frames has errors of variance v, those of a half have 2 v. Both share frames:
    their difference has a variance of v, which is that of the map.
    """
    squares = [_squared_difference(place, frames, positions) for frames in split_blocks(n_frames)]
    spacing = median_spacing(positions)
    return math.sqrt(float(np.mean(squares))) / spacing if spacing > 0 else math.inf


def _squared_difference(
    place: Callable[[Frames], NDArray[np.float64]],
    frames: Frames,
    positions: NDArray[np.float64],
) -> float:
    """Mean squared difference of the map of some frames and the map; infinite if there is none."""
    try:
        made = place(frames)
        placed = np.isfinite(made).all(axis=1)
        if np.count_nonzero(placed) < MIN_SENSORS_COMPARED:
            return math.inf
        return align(made[placed], positions[placed]).rms ** 2
    except InputError:  # the half cannot be mapped, or all its positions coincide
        return math.inf


logger = logging.getLogger(__name__)

# Of the covariogram fit of a half. With the default, the error of a map of 1,000 sensors under few
# contacts differed by 1 % (16.7 and 16.5 spacings), and halves took four times as long.
_MAX_ITERATIONS = 30
_SAME = 1e-6  # spacings; rounding errors of a map that was scaled or turned are far below


@dataclass(frozen=True, eq=False)
class MapPart:
    """A component of a map.

    positions (n, k)
    refined: How the positions were computed; None if that is not known.
    """

    positions: NDArray[np.float64]
    pairs: PairStatistics
    refined: RefinedMap | None = None

    @property
    def readings(self) -> NDArray[np.generic]:
        """Readings of the sensors, shape (T, n)."""
        return np.asarray(self.pairs.readings)


class MapParts:
    """The components of a map of one recording.

    Without the stages of the map, it is made again.
    """

    def __init__(
        self,
        sensor_map: SensorMap,
        run: Recording,
        options: MethodOptions,
        stages: Stages | None = None,
    ) -> None:
        self._map, self._run, self.options = sensor_map, run, options
        self._stages = self._made_again() if stages is None else stages
        self.method = sensor_map.method

    def error_of_halves(self, part: MapPart) -> float:
        """Map halves of the recording of a component, and return its error in spacings."""
        logger.info("mapping halves of the recording to estimate the repeatability")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)  # halves are short by design
            return repeatability_of_halves(
                len(part.readings), part.positions, lambda frames: self._map_half(part, frames)
            )

    def __getitem__(self, label: int) -> MapPart:
        """Return the component with a label; `InputError` if it has no variance of similarity."""
        members = self._map.component == label
        stages, positions = self._stages, self._map.positions[members]
        components = self._map.component[self._map.placed]
        if stages is not None and np.array_equal(stages.configuration.component, components):
            made, inside = stages.configuration, components == label
            same = departure_in_spacings(made.positions[inside], positions) <= _SAME
            refined = made.refinements[label] if same else None
            return MapPart(positions, stages.pairs.select(inside), refined)
        run = self._run.select(members)
        with limited_blas(run.n_sensors):
            pairs = compare([run], self._map.similarity, bins=self.options.bins, with_noise=True)
        return MapPart(positions, pairs)

    def _made_again(self) -> Stages | None:
        unplaced = [self._map.names[i] for i in np.flatnonzero(~self._map.placed)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)  # the notes of the map have them
            try:
                return reconstruct_with_stages(
                    self._run,
                    self._map.method,
                    self._map.dimensions,
                    options=self.options,
                    drop=unplaced,
                )[1]
            except InputError:
                return None

    def _map_half(self, part: MapPart, frames: NDArray[np.intp]) -> NDArray[np.float64]:
        """Map a half of the frames from the beginning, as all of them; NaN for constant sensors."""
        fit = self.options.covariogram
        fit = replace(fit, max_iterations=min(fit.max_iterations, _MAX_ITERATIONS))
        options = replace(self.options, split_unrelated=False, covariogram=fit)
        half = part.pairs.of_frames(frames)
        varying = np.ptp(np.asarray(half.readings), axis=0) > 0
        if np.count_nonzero(varying) < max(options.min_sensors, self._map.dimensions):
            raise InputError("too few sensors vary in a half of the recording")
        positions = np.full(part.positions.shape, np.nan)
        positions[varying] = configure_pairs(
            half.select(varying), find_method(self._map.method), self._map.dimensions, options
        ).positions
        return positions
