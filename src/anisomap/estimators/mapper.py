"""A scikit-learn transformer that maps sensors, which are columns."""

from __future__ import annotations

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
from anisomap.errors import InputError
from anisomap.large.chunks import sample_of
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions
from anisomap.numerics.similarity.correlation import Moments
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct
from anisomap.recording import MissingPolicy, Recording


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
        self._forget()
        self._remember(recording)
        return self._map(recording)

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

        Notes
        -----
        Memory does not grow with the number of frames: of more than 16,384, or fewer of more than
        512 sensors, those are mapped that are evenly spread over all; until then the map is that of
        `fit`. Missing readings are handled within each part. `anisomap.large.reconstruct_chunks`
        maps all frames.
        """
        first = not hasattr(self, "n_samples_seen_")
        recording = self._validated(X, reset=first)
        if first:
            self._forget()
        self._remember(recording)
        return self._map(Recording(self._sample.readings, names=recording.names))

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

    def _forget(self) -> None:
        self.n_samples_seen_ = 0
        self._sample = sample_of(self.n_features_in_)

    def _remember(self, recording: Recording) -> None:
        self._sample.add(recording.readings)
        self.n_samples_seen_ += recording.n_frames

    def _map(self, recording: Recording) -> Self:
        options = self._options()
        made = reconstruct(recording, self.method, self.n_components, options=options)
        self.map_ = diagnose(made, recording, with_verdict=False)
        self.positions_ = self.embedding_ = made.positions
        self.n_iter_ = max(1, made.n_iterations)  # 0 if the initial positions fit exactly
        self._rest = recording.signals.rest
        return self

    def _options(self) -> MethodOptions:
        return MethodOptions(
            mu=self.mu,
            bins=self.bins,
            smacof=SmacofOptions(self.tol, self.max_iter),
            min_sensors=1,
        )
