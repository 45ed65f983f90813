"""The components of a map, with the stages that they were computed from, for its diagnosis."""

from __future__ import annotations

import logging
import warnings
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.diagnosis.halves import repeatability_of_halves
from anisomap.diagnosis.uncertainty import departure_in_spacings
from anisomap.errors import AnisomapWarning, InputError
from anisomap.mapping import Stages, configure_pairs
from anisomap.methods import DEFAULT_METHOD, METHODS, MethodOptions, refine_without_contacts
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.covariogram.minimisation import SharedCurvature
from anisomap.numerics.precision import Reals
from anisomap.reconstruction import reconstruct_with_stages
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.stages.contact_average import (
    average_with_contacts,
    average_with_known_contacts,
)
from anisomap.stages.pairs import PairStatistics, compare
from anisomap.stages.refinement import ContactAverage, Refined

logger = logging.getLogger(__name__)

_MAX_ITERATIONS = 60
"""Maximum number of iterations of the covariogram fit to a half.

With 300, differences of halves changed by less than .6 % (Nao's torso and head, an insole, soles,
and simulated skins, seeds 11 to 17).
"""

_START_TOLERANCE = 1e-5
"""Minimum tolerance of the scaling from which the covariogram fit of a half starts.

With 1e-8, differences of halves changed by less than .7 % (an insole, Nao's torso and head, soles,
retinas, and simulated skins, seeds 5 to 10).
"""

_SAME = 1e-6  # spacings; rounding errors of a map that was scaled or turned are far below


@dataclass(frozen=True, eq=False)
class MapPart:
    """A component of a map.

    Attributes
    ----------
    readings : ndarray of shape (T, n)
    positions : ndarray of shape (n, k)
    pairs : PairStatistics
    refinement : Refined, optional
        How the positions were computed; None if that is not known.
    curvature : SharedCurvature
        Of the covariogram fits of resamples and halves. Their minima do not depend on it, but a fit
        that ends after its maximum number of iterations does, slightly.
    """

    readings: NDArray[np.floating]
    positions: NDArray[np.float64]
    pairs: PairStatistics
    refinement: Refined | None = None
    curvature: SharedCurvature = field(default_factory=SharedCurvature)

    def contacts_from(self, reference: Reals, options: MethodOptions) -> ContactAverage | None:
        """Return the fit of contacts of the map; if unknown, that of a reference map instead."""
        if self.refinement is not None:
            return self.refinement.contacts
        return average_with_contacts(self.pairs, Refined(reference), options.contacts).contacts


class MapParts:
    """The components of a map of one recording, each examined once.

    Parameters
    ----------
    sensor_map : SensorMap
    run : Recording
        Complete.
    options : MethodOptions
    stages : Stages, optional
        The stages of the map. Without them, the map is made again.
    """

    def __init__(
        self,
        sensor_map: SensorMap,
        run: Recording,
        options: MethodOptions,
        stages: Stages | None = None,
    ) -> None:
        self._map, self._run, self._options = sensor_map, run, options
        self._stages = self._made_again() if stages is None else stages
        self._halves: dict[int, float] = {}
        self._parts: dict[int, MapPart] = {}

    def __getitem__(self, label: int) -> MapPart:
        """Return the component with a label.

        Raises
        ------
        InputError
            If no variance of its similarity can be estimated.
        """
        if label not in self._parts:
            self._parts[label] = self._part(label)
        return self._parts[label]

    def error_of_halves(self, label: int) -> float:
        """Map halves of the recording of a component, and return its error in spacings.

        Notes
        -----
        Every half is mapped from the beginning, up to the fit of contacts; heights of
        contacts are examined if they contradict the map of the whole recording. Where its map then
        agrees with that of the whole recording, the fit of the whole recording is continued with
        the contacts of the half, instead of repeated.
        """
        if label not in self._halves:
            part = self[label]
            logger.info("mapping halves of the recording to estimate the repeatability")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)  # halves are short by design
                self._halves[label] = repeatability_of_halves(
                    len(part.readings),
                    part.positions,
                    lambda frames: self._map_half(part, frames),
                )
        return self._halves[label]

    def _part(self, label: int) -> MapPart:
        members = self._map.component == label
        run, stages = self._run.select(members), self._stages
        positions = self._map.positions[members]
        components = self._map.component[self._map.placed]
        if stages is not None and np.array_equal(stages.configuration.component, components):
            made, inside = stages.configuration, components == label
            same = departure_in_spacings(made.positions[inside], positions) <= _SAME
            refinement = made.refinements[label] if same else None
            return MapPart(run.readings, positions, stages.pairs.select(inside), refinement)
        with limited_blas(run.n_sensors):
            pairs = compare([run], self._map.similarity, bins=self._options.bins, with_noise=True)
        return MapPart(run.readings, positions, pairs)

    def _made_again(self) -> Stages | None:
        unplaced = [self._map.names[i] for i in np.flatnonzero(~self._map.placed)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)  # the notes of the map have them
            try:
                return reconstruct_with_stages(
                    self._run,
                    self._map.method,
                    self._map.dimensions,
                    options=self._options,
                    drop=unplaced,
                )[1]
            except InputError:
                return None

    def _map_half(self, part: MapPart, frames: NDArray[np.intp]) -> NDArray[np.float64]:
        def refine(
            pairs: PairStatistics, metric: Reals, positions: Reals, options: MethodOptions
        ) -> Refined:
            made = part.refinement
            # Whether heights contradict a map is known best from the whole recording.
            heights = made is None or made.facts.heights_contradict
            mapped = refine_without_contacts(
                pairs,
                metric,
                positions,
                options,
                with_heights=heights,
                # The curvature is that of all sensors.
                curvature=part.curvature if len(positions) == len(part.positions) else None,
            )
            known = None if part.refinement is None else part.refinement.contacts
            if known is None and part.refinement is not None:
                return mapped
            if known is None or len(mapped.positions) < len(part.positions):
                return average_with_contacts(pairs, mapped, options.contacts)
            return average_with_known_contacts(known, mapped, frames) or average_with_contacts(
                pairs, mapped, options.contacts
            )

        covariogram, smacof = self._options.covariogram, self._options.smacof
        options = replace(
            self._options,
            split_unrelated=False,
            covariogram=replace(
                covariogram, max_iterations=min(covariogram.max_iterations, _MAX_ITERATIONS)
            ),
            smacof=replace(smacof, tolerance=max(smacof.tolerance, _START_TOLERANCE)),
        )
        recipe = replace(METHODS[DEFAULT_METHOD], refine=refine)
        # The half that begins with the first frame is the first.
        half = part.pairs.of_half(int(frames[0] > 0))
        varying = np.ptp(np.asarray(half.readings), axis=0) > 0
        if np.count_nonzero(varying) < max(options.min_sensors, self._map.dimensions):
            raise InputError("too few sensors vary in a half of the recording")
        positions = np.full(part.positions.shape, np.nan)
        positions[varying] = configure_pairs(
            half.select(varying), recipe, self._map.dimensions, options
        ).positions
        return positions
