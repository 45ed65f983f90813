"""The verdict on a map: how far it can be used, from what is measured of its errors."""

from anisomap.map_verdict import LEVELS, UNKNOWN, Verdict
from anisomap.verdict.judge import Measurements, judge

__all__ = ["LEVELS", "UNKNOWN", "Measurements", "Verdict", "judge"]
