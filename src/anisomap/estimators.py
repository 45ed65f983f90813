"""Estimators with the interface of scikit-learn, for columns (sensors) and for rows (objects)."""

from __future__ import annotations

import warnings
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist
from scipy.stats import spearmanr
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.metrics import pairwise_distances
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, check_non_negative, validate_data

from anisomap.base import DEFAULT_METHOD
from anisomap.errors import AnisomapWarning, InputError
from anisomap.method.dimensions import AUTO, Dimensions
from anisomap.method.named import DEFAULT_MU, MethodOptions
from anisomap.method.pipeline import reconstruct
from anisomap.numerics.ranges import COUNT
from anisomap.numerics.sampling import sample_of
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, find_scaling
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.numerics.similarity.correlation import pearson
from anisomap.recording import MissingPolicy, Recording
from anisomap.verdict.diagnosis import diagnose


class SensorMapper(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Map the sensors (columns) of a recording; transform frames to centres of contact.

    Parameters
    ----------
    n_components : int or "auto", default="auto"
        Number of dimensions of the map: see `anisomap.reconstruct`.
    method : str, default="covariogram"
        A key of `anisomap.method.named.METHODS`; the default is as in `anisomap.reconstruct`.
    regularisation, entropy_bins : float, int
        See `anisomap.MethodOptions`.
    tol, max_iter : float, int
        Stopping criteria: see `anisomap.numerics.scaling.multidimensional_scaling.SmacofOptions`.
    missing : {"error", "drop-frames", "interpolate"}, default="error"
        Handling of NaN in X: see `anisomap.Recording.complete`. With ``"error"`` and
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
        regularisation: float = DEFAULT_MU,
        entropy_bins: int = DEFAULT_BINS,
        tol: float = SmacofOptions.tolerance,
        max_iter: int = SmacofOptions.max_iterations,
        missing: MissingPolicy = "error",
    ) -> None:
        self.n_components = n_components
        self.method = method
        self.regularisation = regularisation
        self.entropy_bins = entropy_bins
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
        return self._map(self._added(X, first=True))

    def partial_fit(self, X: ArrayLike, y: object = None) -> Self:
        """Add frames of the same sensors, and map the sensors from all frames so far.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings that follow the previous ones.
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
        Up to 16,384 frames (fewer for more than 512 sensors), the map equals the map by `fit`. Of
        more frames, an even sample is kept and mapped, so memory does not grow. Missing readings
        are handled within each part.
        """
        recording = self._added(X, first=not hasattr(self, "n_samples_seen_"))
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
        """Score the map on other frames: sensors with similar readings should be close together.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings, such as held-out frames of a cross-validation.
        y : object
            Ignored.

        Returns
        -------
        float
            Rank correlation, in [-1, 1], of Pearson's r in these frames with negative distances on
            the map, over pairs of sensors of the largest component that vary in these frames.
            NaN if all r or all distances are equal.
        """
        check_is_fitted(self)
        recording = self._validated(X, reset=False)
        kept = np.flatnonzero((self.map_.component == 0) & recording.varying())
        pairs = np.triu_indices(len(kept), k=1)
        agreement = pearson(recording.readings[:, kept])[pairs]
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
        """Check readings as scikit-learn does; the error on missing readings names our option."""
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
            raise InputError("Input X contains NaN; set missing='interpolate' or 'drop-frames'")
        return np.asarray(readings)

    def _added(self, X: ArrayLike, *, first: bool) -> Recording:
        """Add frames to the sample, or begin a new sample with them."""
        recording = self._validated(X, reset=first)
        if first:
            self.n_samples_seen_ = 0
            self._sample = sample_of(self.n_features_in_)
        self._sample.add(recording.readings)
        self.n_samples_seen_ += recording.n_frames
        return recording

    def _map(self, recording: Recording) -> Self:
        options = MethodOptions(
            regularisation=self.regularisation,
            entropy_bins=self.entropy_bins,
            smacof=SmacofOptions(self.tol, self.max_iter),
            min_sensors=1,
        )
        made = reconstruct(recording, self.method, self.n_components, options=options)
        self.map_ = diagnose(made, recording, with_verdict=False)
        self.positions_ = self.embedding_ = made.positions
        self.n_iter_ = max(1, made.n_iterations)  # 0 if the initial positions fit exactly
        self._rest = recording.signals.rest
        return self


class Anisomap(BaseEstimator):
    """ANISOMAP embedding of objects (rows): scaling of their metricised dissimilarities.

    An alternative to scikit-learn's ``MDS`` and ``Isomap`` that supports any semi-metric, weights
    and missing pairs. Like ``MDS``, it has no `transform` for new objects. Parameters of ``MDS``
    have different names: `metric_mds` is `method`, `dissimilarity` is `metric`, `eps` is `tol`, and
    `init` is an argument of `fit`; `normalized_stress`, `n_jobs` and `verbose` have no counterpart.

    Parameters
    ----------
    n_components : int, default=2
        Number of dimensions of the embedding.
    metric : str or callable, default="euclidean"
        Dissimilarity of rows, as in `sklearn.metrics.pairwise_distances`; ``"precomputed"`` if X is
        a matrix of dissimilarities. Any semi-metric is allowed, such as correlation, cosine or
        squared distance.
    metric_params : dict, optional
        Additional arguments of `metric`.
    method : {"anisomap", "mds", "ordinal"}, default="anisomap"
        Targets of the distances: the lengths of shortest paths, the dissimilarities, or their order
        (non-metric scaling).
    n_init : int, default=1
        Number of initial configurations; the result with the least stress is kept. The first one
        is Torgerson's classical scaling or `init`; all others are random.
    random_state : int, RandomState or None, default=None
        Generator of the random initial configurations, or its seed.
    tol, max_iter : float, int
        Stopping criteria: see `anisomap.numerics.scaling.multidimensional_scaling.SmacofOptions`.

    Attributes
    ----------
    embedding_ : ndarray of shape (n_samples, n_components)
        Positions of the objects.
    metric_matrix_ : ndarray of shape (n_samples, n_samples)
        The target distances: metricised dissimilarities, the dissimilarities, or with
        ``method="ordinal"`` the best-fitting monotone function of the dissimilarities.
    stress_ : float
        Stress-1 of `metric_matrix_`; 0 is a perfect fit.
    n_iter_ : int
        Iterations of SMACOF.
    n_features_in_ : int
        Number of columns of X.

    See Also
    --------
    SensorMapper : Map of sensors, which are columns.

    Examples
    --------
    >>> import numpy as np
    >>> square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    >>> embedding = Anisomap().fit_transform(square)
    >>> np.allclose(np.linalg.norm(embedding, axis=1), 0.5**0.5, atol=1e-4)
    True
    """

    def __init__(
        self,
        n_components: int = 2,
        *,
        metric: str | Any = "euclidean",
        metric_params: dict[str, Any] | None = None,
        method: str = "anisomap",
        n_init: int = 1,
        random_state: Any = None,
        tol: float = SmacofOptions.tolerance,
        max_iter: int = SmacofOptions.max_iterations,
    ) -> None:
        self.n_components = n_components
        self.metric = metric
        self.metric_params = metric_params
        self.tol = tol
        self.max_iter = max_iter
        self.method = method
        self.n_init = n_init
        self.random_state = random_state

    def fit(
        self,
        X: ArrayLike,
        y: object = None,
        *,
        weights: ArrayLike | None = None,
        init: ArrayLike | None = None,
    ) -> Self:
        """Embed the rows of X.

        Parameters
        ----------
        X : array_like of shape (n_samples, n_features) or (n_samples, n_samples)
            Objects, or with ``metric="precomputed"`` their dissimilarities. NaN or infinity on
            either side of the diagonal marks an unknown pair.
        y : object
            Ignored.
        weights : array_like of shape (n_samples, n_samples), optional
            Weights of the distances; 0 marks an unknown distance.
        init : array_like of shape (n_samples, n_components), optional
            Initial positions; Torgerson's classical scaling by default.

        Returns
        -------
        Anisomap
            The fitted estimator.

        Raises
        ------
        InputError
            If a point has a NaN, a dissimilarity is negative or not symmetric, or the known pairs
            do not connect all objects.

        Warns
        -----
        AnisomapWarning
            If X is a matrix of dissimilarities, but `metric` is not ``"precomputed"``.
        """
        COUNT.check("n_init", self.n_init)
        precomputed = self.metric == "precomputed"
        values = validate_data(
            self,
            X,
            dtype=np.float64,
            ensure_all_finite=False if precomputed else "allow-nan",
            ensure_min_samples=2,
        )
        if not precomputed and np.isnan(values).any():
            raise InputError("Input X contains NaN; only metric='precomputed' allows it")
        if precomputed:
            largest = np.abs(values).max(where=np.isfinite(values), initial=0)
            rounding = _ROUNDING * largest
            values = np.where(np.abs(values) <= rounding, 0, values)
            check_non_negative(values, "Anisomap")
            unknown = np.isnan(values) | np.isnan(values.T)
            dissimilarity = np.where(unknown, np.inf, values)
        else:
            if _are_dissimilarities(values):
                warnings.warn(
                    "X is square and symmetric with a zero diagonal, like a matrix of "
                    "dissimilarities, but its rows are taken as points; set metric='precomputed' "
                    "if it holds dissimilarities",
                    AnisomapWarning,
                    stacklevel=2,
                )
            dissimilarity = pairwise_distances(
                values, metric=self.metric, **(self.metric_params or {})
            )
            # Rounding errors of some metrics are negative, or not 0 on the diagonal.
            dissimilarity = np.maximum(dissimilarity, 0)
            np.fill_diagonal(dissimilarity, 0)
        scale = find_scaling(self.method)
        options = SmacofOptions(self.tol, self.max_iter)
        random = check_random_state(self.random_state)
        starts = [init] + [
            random.standard_normal((len(dissimilarity), self.n_components))
            for _ in range(self.n_init - 1)
        ]
        scaling, self.metric_matrix_ = min(
            (
                scale(
                    dissimilarity,
                    dimensions=self.n_components,
                    start=start,
                    weights=weights,
                    options=options,
                )
                for start in starts
            ),
            key=lambda found: found[0].stress,
        )
        self.embedding_ = scaling.positions
        self.stress_ = scaling.stress
        self.n_iter_ = len(scaling.trace) - 1
        return self

    def fit_transform(
        self,
        X: ArrayLike,
        y: object = None,
        *,
        weights: ArrayLike | None = None,
        init: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Embed the rows of X and return their positions; see `fit`.

        Returns
        -------
        ndarray of shape (n_samples, n_components)
        """
        return self.fit(X, y, weights=weights, init=init).embedding_

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.pairwise = self.metric == "precomputed"
        tags.input_tags.allow_nan = tags.input_tags.pairwise
        tags.input_tags.positive_only = tags.input_tags.pairwise
        return tags


_ROUNDING = 1e-9  # of dissimilarities such as 1 - r, relative to the largest


def _are_dissimilarities(values: NDArray[np.float64]) -> bool:
    return (
        values.shape[0] == values.shape[1]
        and not np.diag(values).any()
        and np.array_equal(values, values.T)
        and bool((values >= 0).all() and values.any())
    )
