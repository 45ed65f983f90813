"""The verdict on the use of a map, from measurements of its errors."""

from anisomap.map_verdict import LEVELS, UNKNOWN, Verdict
from anisomap.verdict.judge import Measurements, judge

__all__ = ["LEVELS", "UNKNOWN", "Measurements", "Verdict", "judge"]
