"""A scikit-learn embedding of objects, which are rows."""

from __future__ import annotations

import warnings
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.metrics import pairwise_distances
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_non_negative, validate_data

from anisomap.errors import AnisomapWarning, InputError
from anisomap.numerics.scaling.dissimilarity_scaling import find_scaling
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions


class Anisomap(BaseEstimator):
    """ANISOMAP embedding of objects (rows): scaling of their metricised dissimilarities.

    An alternative to scikit-learn's ``MDS`` and ``Isomap`` that supports any semi-metric, weights
    and missing pairs. Like ``MDS``, it has no `transform` for new objects. Of the parameters of
    ``MDS``, `eps` is `tol` here, ``metric_mds=False`` (once ``metric=False``) is
    ``method="ordinal"``, ``dissimilarity="precomputed"`` is ``metric="precomputed"``, and `init` is
    an argument of `fit`; `n_jobs` and `verbose` have no counterpart, and `normalized_stress` none
    either, since `stress_` is always normalised.

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
        What distances approximate: the lengths of shortest paths, the dissimilarities themselves,
        or their order (non-metric scaling).
    n_init : int, default=1
        Number of initial configurations, of which the one with the least stress is kept. The first
        is Torgerson's classical scaling or `init`; further ones are random.
    random_state : int, RandomState or None, default=None
        Random numbers of the further initial configurations.
    tol, max_iter : float, int
        Stopping criteria: see `anisomap.numerics.scaling.multidimensional_scaling.SmacofOptions`.
    dissimilarity : None
        Refused, with an error that names `metric`.

    Attributes
    ----------
    embedding_ : ndarray of shape (n_samples, n_components)
        Positions of the objects.
    metric_matrix_ : ndarray of shape (n_samples, n_samples)
        The distances that were approximated: metricised dissimilarities, the dissimilarities, or
        with ``method="ordinal"`` the monotone function of them that fits best.
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
        dissimilarity: str | None = None,
    ) -> None:
        self.n_components = n_components
        self.metric = metric
        self.metric_params = metric_params
        self.tol = tol
        self.max_iter = max_iter
        self.method = method
        self.n_init = n_init
        self.random_state = random_state
        self.dissimilarity = dissimilarity

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
            If a dissimilarity is negative or not symmetric, or the known pairs do not connect all
            objects.

        Warns
        -----
        AnisomapWarning
            If X is a matrix of dissimilarities, but `metric` is not ``"precomputed"``.
        """
        self._check_parameters()
        precomputed = self.metric == "precomputed"
        values = validate_data(
            self,
            X,
            dtype=np.float64,
            ensure_all_finite=not precomputed,
            ensure_min_samples=2,
        )
        if precomputed:
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

    def _check_parameters(self) -> None:
        if isinstance(self.metric, bool) or self.dissimilarity is not None:
            raise InputError(
                "of scikit-learn's MDS, dissimilarity='precomputed' is metric='precomputed' here, "
                "and metric=False is method='ordinal'"
            )
        if self.n_init < 1:
            raise InputError(f"n_init must be at least 1, got {self.n_init}")

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.pairwise = self.metric == "precomputed"
        tags.input_tags.allow_nan = tags.input_tags.pairwise
        tags.input_tags.positive_only = tags.input_tags.pairwise
        return tags


def _are_dissimilarities(values: NDArray[np.float64]) -> bool:
    return (
        values.shape[0] == values.shape[1]
        and not np.diag(values).any()
        and np.array_equal(values, values.T)
        and bool((values >= 0).all() and values.any())
    )
