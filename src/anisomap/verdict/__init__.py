"""Diagnosis of a map: sensor health, and the verdict that follows from evidence of its errors."""

from anisomap.usability import LEVELS, UNKNOWN, Verdict
from anisomap.verdict.judge import Evidence, judge

__all__ = ["LEVELS", "UNKNOWN", "Evidence", "Verdict", "judge"]
