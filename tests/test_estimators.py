"""The scikit-learn faces: the contract, and what they promise beyond it."""

import numpy as np
import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from anisomap import Anisomap, SensorMapper


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@parametrize_with_checks(
    [
        SensorMapper(n_components=2),
        SensorMapper(n_components=2, missing="interpolate"),
        SensorMapper(n_components=2, method="isomap", missing="drop-frames"),
        Anisomap(),
        Anisomap(metric="precomputed"),
    ],
)
def test_scikit_learn_contract(estimator, check):
    check(estimator)
