"""Diagnosis of a map: sensor health, and the verdict that follows from evidence of its errors."""

from anisomap.diagnosis.verdict import Evidence, judge
from anisomap.usability import LEVELS, UNKNOWN, Verdict

__all__ = ["LEVELS", "UNKNOWN", "Evidence", "Verdict", "judge"]
