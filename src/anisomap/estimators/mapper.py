"""A scikit-learn transformer that maps sensors, which are columns."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist
from scipy.stats import spearmanr
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from anisomap.defaults import DEFAULT_BINS, DEFAULT_METHOD
from anisomap.diagnosis.diagnostics import diagnose
from anisomap.dimensions import AUTO, Dimensions
from anisomap.errors import AnisomapWarning, InputError
from anisomap.large.chunked_similarity import CHUNKED, computed_similarity
from anisomap.large.chunks import Excerpt
from anisomap.methods import find_method
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.numerics.similarity.correlation import Moments
from anisomap.numerics.similarity.information import JointValues
from anisomap.numerics.similarity.rest import Rest, estimate_rest
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct, reconstruct_from
from anisomap.recording import MissingPolicy, Recording
from anisomap.sensor_map import SensorMap

SAMPLE_FRAMES = 4096
"""Maximum number of frames that `SensorMapper` keeps to estimate the rest of each sensor."""

PARTIAL_NOTE = (
    "partial_fit computes the similarity by Pearson's r alone, without rank correlation, and does "
    "not examine contacts; fit on all frames does both"
)


class SensorMapper(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Map the sensors (columns) of a recording; transform frames to centres of contact.

    Parameters
    ----------
    n_components : int or "auto", default="auto"
        Number of dimensions of the map: see `anisomap.reconstruct`.
    method : str, default="covariogram"
        A key of `anisomap.methods.METHODS`; the default is that of `anisomap.reconstruct`.
    mu, bins : float, int
        See `anisomap.methods.MethodOptions`.
    tol, max_iter : float, int
        Stopping criteria: see `anisomap.numerics.scaling.multidimensional_scaling.SmacofOptions`.
    missing : {"error", "drop-frames", "interpolate"}, default="error"
        How to handle NaN in X: see `anisomap.Recording.complete`. With ``"error"`` and
        ``"drop-frames"``, `transform` ignores missing readings of a frame.

    Attributes
    ----------
    positions_, embedding_ : ndarray of shape (n_sensors, k)
        Positions of the sensors; NaN for constant sensors.
    map_ : SensorMap
        The map, with sensor health (after `fit`), stress and notes.
    n_features_in_ : int
        Number of sensors.
    n_iter_ : int
        Iterations of SMACOF.
    n_samples_seen_ : int
        Number of frames.

    See Also
    --------
    Anisomap : Embedding of rows, given as points or as a dissimilarity matrix.

    Examples
    --------
    >>> import numpy as np
    >>> place, touch = np.linspace(0, 1, 12), np.random.default_rng(0).uniform(size=(2000, 1))
    >>> readings = np.maximum(0, 0.2 - abs(touch - place))
    >>> mapper = SensorMapper(n_components=1).fit(readings)
    >>> bool(abs(np.corrcoef(mapper.positions_[:, 0], place)[0, 1]) > 0.99)
    True
    """

    def __init__(
        self,
        n_components: Dimensions = AUTO,
        *,
        method: str = DEFAULT_METHOD,
        mu: float = 1.0,
        bins: int = DEFAULT_BINS,
        tol: float = SmacofOptions.tolerance,
        max_iter: int = SmacofOptions.max_iterations,
        missing: MissingPolicy = "error",
    ) -> None:
        self.n_components = n_components
        self.method = method
        self.mu = mu
        self.bins = bins
        self.tol = tol
        self.max_iter = max_iter
        self.missing = missing

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Map the sensors from all frames at once.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings.
        y : object
            Ignored.

        Returns
        -------
        SensorMapper
            The fitted estimator.

        Raises
        ------
        InputError
            See `anisomap.reconstruct`.
        """
        recording = self._validated(X, reset=True)
        self._reset()
        self._add_frames(recording)
        options = self._options()
        made = reconstruct(recording, self.method, self.n_components, options=options)
        self._set_map(diagnose(made, recording, with_verdict=False))
        return self

    def partial_fit(self, X: ArrayLike, y: object = None) -> Self:
        """Add frames of the same sensors, and map the sensors from all frames so far.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings that follow those seen before.
        y : object
            Ignored.

        Returns
        -------
        SensorMapper
            The fitted estimator.

        Raises
        ------
        InputError
            See `anisomap.reconstruct`.

        Warns
        -----
        AnisomapWarning
            If the map differs from that of `fit`, and once for each note of the map.

        Notes
        -----
        Frames are not stored, so memory does not grow with their number. The map equals that of
        `fit` on all frames up to rounding, with these exceptions. ``"covariogram"`` and
        ``"contact-fit"`` use Pearson's r alone, with a note on the map. Sensor health is not
        assessed. Missing readings are handled within each part. Methods based on other
        similarities than Pearson's r store joint counts of values; if sensors have too many
        distinct values, these are rounded, with a warning.
        `anisomap.large.reconstruct_chunks`, which reads the frames twice, rounds later.
        """
        first = not hasattr(self, "n_samples_seen_")
        recording = self._validated(X, reset=first)
        if first:
            self._reset()
        self._add_frames(recording)
        pairs = self._add_pairs(recording)
        made = reconstruct_from(
            similarity=self._similarity(pairs),
            method=self.method,
            dimensions=self.n_components,
            options=self._options(),
            names=getattr(self, "feature_names_in_", ()),
            drop=np.flatnonzero(~pairs.varying()).tolist(),
            statistic=computed_similarity(find_method(self.method).similarity),
        )
        self._set_map(self._with_limitations(made))
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Compute the centre of contact of every frame.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings.

        Returns
        -------
        ndarray of shape (n_frames, k)
            Mean position of the sensors of the largest component, weighted by their readings
            beyond rest; NaN for frames without contact.
        """
        check_is_fitted(self)
        readings = self._checked(X, reset=False)
        largest = self.map_.component == 0
        depth = np.nan_to_num(self._rest.depth(readings)[:, largest])
        total = depth.sum(axis=1, keepdims=True)
        centre = depth @ self.positions_[largest]
        nowhere = np.full_like(centre, np.nan)
        return np.asarray(np.divide(centre, total, out=nowhere, where=total > 0))

    def score(self, X: ArrayLike, y: object = None) -> float:
        """Score the map on other frames: sensors that agree in them should be close together.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings, such as those that a cross-validation left out.
        y : object
            Ignored.

        Returns
        -------
        float
            Rank correlation of Pearson's r in these frames with the nearness of sensors on the
            map, at most 1; pairs of the largest component whose sensors vary in them. NaN if all r
            or all distances are equal.
        """
        check_is_fitted(self)
        moments = Moments.of(self._validated(X, reset=False).readings)
        kept = np.flatnonzero((self.map_.component == 0) & moments.varying())
        pairs = np.triu_indices(len(kept), k=1)
        agreement = moments.correlation()[np.ix_(kept, kept)][pairs]
        if not pairs[0].size:
            return float("nan")
        nearness = -pdist(self.positions_[kept])
        if np.ptp(agreement) == 0 or np.ptp(nearness) == 0:
            return float("nan")
        return float(spearmanr(agreement, nearness).statistic)

    @property
    def _n_features_out(self) -> int:
        return self.map_.dimensions

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = self.missing != "error"
        return tags

    def _validated(self, X: ArrayLike, *, reset: bool) -> Recording:
        readings = self._checked(X, reset=reset)
        names = getattr(self, "feature_names_in_", ())
        return Recording(readings, names=tuple(names)).complete(self.missing)

    def _checked(self, X: ArrayLike, *, reset: bool) -> NDArray[np.floating]:
        """Check readings as scikit-learn does; the error on missing ones names our option."""
        readings = validate_data(
            self,
            X,
            reset=reset,
            dtype=(np.float64, np.float32),
            ensure_all_finite="allow-nan",
            ensure_min_samples=2 if reset else 1,
            ensure_min_features=2 if reset else 0,
        )
        if self.missing == "error" and np.isnan(readings).any():
            raise InputError(
                "Input X contains NaN, missing readings; SensorMapper(missing='interpolate') fills "
                "them in, and missing='drop-frames' leaves their frames out"
            )
        return np.asarray(readings)

    def _reset(self) -> None:
        self.n_samples_seen_ = 0
        self._pairs: Moments | JointValues | None = None
        self._sample: Excerpt | None = None

    def _add_frames(self, recording: Recording) -> None:
        """Update the sample of frames and the rest of each sensor."""
        if self._sample is None:
            self._sample = Excerpt(SAMPLE_FRAMES * recording.n_sensors, segment=1)
        self._sample.add(recording.readings)
        self.n_samples_seen_ += recording.n_frames
        self._rest: Rest = estimate_rest(self._sample.readings)

    def _add_pairs(self, recording: Recording) -> Moments | JointValues:
        """Add the pair statistics of a part of the frames; return those of all parts."""
        needs_values = CHUNKED[find_method(self.method).similarity].needs_values
        part: Any = (JointValues if needs_values else Moments).of(recording.readings)
        self._pairs = part if self._pairs is None else self._pairs.merged(part)
        return self._pairs

    def _similarity(self, pairs: Moments | JointValues) -> Reals:
        """Compute the similarity from the pair statistics of all parts."""
        if isinstance(pairs, Moments):
            return pairs.correlation()
        if not pairs.single.exact:
            warnings.warn(
                f"some sensors have more than {pairs.single.max_values} distinct values, which are "
                "rounded by partial_fit; call fit on all frames to keep them",
                AnisomapWarning,
                stacklevel=3,
            )
        return CHUNKED[find_method(self.method).similarity].of_values(pairs, self.bins)

    def _with_limitations(self, made: SensorMap) -> SensorMap:
        """Add a note if the map differs from that of `fit`."""
        similarity = find_method(self.method).similarity
        if computed_similarity(similarity) == similarity:
            return made
        warnings.warn(PARTIAL_NOTE, AnisomapWarning, stacklevel=3)
        return replace(made, notes=(*made.notes, PARTIAL_NOTE))

    def _options(self) -> MethodOptions:
        return MethodOptions(
            mu=self.mu,
            bins=self.bins,
            smacof=SmacofOptions(self.tol, self.max_iter),
            min_sensors=1,
        )

    def _set_map(self, sensor_map: SensorMap) -> None:
        self.map_ = sensor_map
        self.positions_ = self.embedding_ = sensor_map.positions
        self.n_iter_ = max(1, sensor_map.n_iterations)  # 0 if the initial positions fit exactly
