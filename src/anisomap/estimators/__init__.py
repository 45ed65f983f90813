"""Estimators with scikit-learn's interface."""

from anisomap.estimators.embedding import Anisomap as Anisomap
from anisomap.estimators.mapper import SensorMapper as SensorMapper
