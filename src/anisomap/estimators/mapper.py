"""A transformer whose columns are sensors."""

from __future__ import annotations

import warnings
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from anisomap.errors import AnisomapWarning
from anisomap.large.chunked_similarity import CHUNKED
from anisomap.methods import MethodOptions, find_method
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions
from anisomap.numerics.similarity.accumulators import Moments
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.numerics.similarity.joint_values import JointValues
from anisomap.numerics.similarity.rest import Rest, estimate_rest
from anisomap.reconstruction import reconstruct
from anisomap.recording import MissingPolicy, Recording

SAMPLE_FRAMES = 4096
"""Frames that `SensorMapper.partial_fit` keeps, to tell where each sensor rests."""


class SensorMapper(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Map the sensors (columns) of a recording; transform frames into centres of contact.

    Parameters
    ----------
    n_components : int, default=3
        Dimensions of the map.
    method : str, default="r-anisomap"
        A name in `anisomap.methods.METHODS`. The default can be taken in chunks (`partial_fit`);
        ``"covariogram"``, the default of `anisomap.reconstruct`, makes better maps.
    mu, bins : float, int
        See `anisomap.methods.MethodOptions`.
    tol, max_iter : float, int
        When to stop scaling: see `anisomap.numerics.scaling.stress_minimisation.SmacofOptions`.
    missing : {"error", "drop-frames", "interpolate"}, default="error"
        What to do about NaN in X: see `anisomap.Recording.complete`. With ``"error"`` and
        ``"drop-frames"``, `transform` leaves missing readings out of a frame's centre.

    Attributes
    ----------
    positions_ : ndarray of shape (n_sensors, n_components)
        Where the sensors are; NaN for those that never vary.
    map_ : SensorMap
        The map, with its health, stress and notes.
    n_features_in_ : int
        Number of sensors.
    n_iter_ : int
        Iterations of SMACOF.
    n_samples_seen_ : int
        Number of frames.

    See Also
    --------
    Anisomap : the same for objects that are rows, such as points or a dissimilarity matrix.

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
        n_components: int = 3,
        *,
        method: str = "r-anisomap",
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
        """Make a map from all frames at once.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings.
        y : object
            Not looked at.

        Returns
        -------
        SensorMapper
            Itself.

        Raises
        ------
        InputError
            See `anisomap.reconstruct`.
        """
        recording = self._validated(X, reset=True)
        self._begin()
        self._take_in(recording)
        self._set_map(recording)
        return self

    def partial_fit(self, X: ArrayLike, y: object = None) -> Self:
        """Take in more frames of the same sensors, and make the map anew from all so far.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings that follow those seen before.
        y : object
            Not looked at.

        Returns
        -------
        SensorMapper
            Itself.

        Raises
        ------
        InputError
            See `anisomap.reconstruct`.

        Notes
        -----
        Frames are not kept: memory does not grow with their number. The map is that of `fit` on
        all of them, up to rounding, but sensor health is not assessed, gaps are settled within
        each part, and ``"covariogram"`` and ``"contact-fit"`` make their maps of Pearson's r alone,
        as in `anisomap.large.streaming.reconstruct_chunks`. What other methods than
        those on Pearson's r make of a reading is known only once all frames are; so the joint
        counts of values are kept, and a warning says so if a sensor reads too many values to keep
        them apart (`anisomap.numerics.similarity.joint_values.MAX_SERIES` in all).
        `anisomap.large.streaming.reconstruct_chunks` reads the frames twice and keeps more.

        Warns
        -----
        AnisomapWarning
            If values had to be rounded, and as `anisomap.reconstruct`.
        """
        first = not hasattr(self, "n_samples_seen_")
        recording = self._validated(X, reset=first)
        if first:
            self._begin()
        self._take_in(recording)
        self._count_pairs(recording)
        self._set_map(None)
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Tell where the skin is touched: the centre of contact of every frame.

        Parameters
        ----------
        X : array_like of shape (n_frames, n_sensors)
            Readings.

        Returns
        -------
        ndarray of shape (n_frames, n_components)
            Mean position of the sensors, weighted by how far beyond rest they read; NaN for a
            frame without contact. Of a map in several pieces, only the largest is looked at.
        """
        check_is_fitted(self)
        readings = validate_data(self, X, reset=False, ensure_all_finite="allow-nan")
        if self.missing == "error" and np.isnan(readings).any():
            validate_data(self, X, reset=False)
        largest = self.map_.component == 0
        depth = np.nan_to_num(self._rest.depth(readings)[:, largest])
        total = depth.sum(axis=1, keepdims=True)
        centre = depth @ self.positions_[largest]
        nowhere = np.full_like(centre, np.nan)
        return np.asarray(np.divide(centre, total, out=nowhere, where=total > 0))

    @property
    def _n_features_out(self) -> int:
        return self.n_components

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = self.missing != "error"
        return tags

    def _validated(self, X: ArrayLike, *, reset: bool) -> Recording:
        readings = validate_data(
            self,
            X,
            reset=reset,
            dtype=(np.float64, np.float32),
            ensure_all_finite=True if self.missing == "error" else "allow-nan",
            ensure_min_samples=2 if reset else 1,
            ensure_min_features=2 if reset else 0,
        )
        names = getattr(self, "feature_names_in_", ())
        return Recording(readings, names=tuple(names)).complete(self.missing)

    def _begin(self) -> None:
        self.n_samples_seen_ = 0
        self._pairs: Moments | JointValues | None = None
        self._sample: NDArray[np.floating] | None = None
        self._stride = 1

    def _take_in(self, recording: Recording) -> None:
        # Every stride-th frame since the first: the sample is spread evenly, however many come.
        fresh = recording.readings[-self.n_samples_seen_ % self._stride :: self._stride]
        sample = fresh if self._sample is None else np.concatenate([self._sample, fresh])
        while len(sample) > SAMPLE_FRAMES:
            sample = sample[::2]
            self._stride *= 2
        self._sample = sample
        self.n_samples_seen_ += recording.n_frames
        self._rest: Rest = estimate_rest(sample)

    def _count_pairs(self, recording: Recording) -> None:
        """Add what a part of the frames tells of pairs of sensors."""
        part: Any
        if CHUNKED[find_method(self.method).similarity].of_values is None:
            part = Moments.of(recording.readings)
        else:
            part = JointValues.of(recording.readings)
        self._pairs = part if self._pairs is None else self._pairs.merged(part)

    def _similarity(self) -> Reals | None:
        """Give the similarity from the parts, if frames came in parts."""
        pairs = self._pairs
        if pairs is None:
            return None
        if isinstance(pairs, Moments):
            return pairs.correlation()
        if not pairs.single.exact:
            warnings.warn(
                f"some sensors read more than {pairs.single.most} different values, which were "
                "rounded to so many; hand all frames over at once to keep them apart",
                AnisomapWarning,
                stacklevel=4,
            )
        of_values = CHUNKED[find_method(self.method).similarity].of_values
        return None if of_values is None else of_values(pairs, self.bins)

    def _set_map(self, recording: Recording | None) -> None:
        constant = [] if self._pairs is None else np.flatnonzero(~self._pairs.varying()).tolist()
        self.map_ = reconstruct(
            recording,
            method=self.method,
            dimensions=self.n_components,
            options=MethodOptions(
                mu=self.mu,
                bins=self.bins,
                smacof=SmacofOptions(self.tol, self.max_iter),
                fewest_sensors=1,
            ),
            similarity=self._similarity(),
            names=getattr(self, "feature_names_in_", ()),
            drop=constant,
        )
        self.positions_ = self.map_.positions
        self.n_iter_ = int(self.map_.provenance["iterations"])
