"""The verdict on a map: from evidence of chance and of systematic errors to a level."""

from anisomap.usability import LEVELS, UNKNOWN, Verdict
from anisomap.verdict.evidence import Doubt, Evidence
from anisomap.verdict.judgement import judge

__all__ = ["LEVELS", "UNKNOWN", "Doubt", "Evidence", "Verdict", "judge"]
