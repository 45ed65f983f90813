"""Summary of a recording, the health of its sensors, and the faults of the whole."""

from anisomap.health.assessment import STATUSES, SensorHealth, assess
from anisomap.health.behaviour import Matches
from anisomap.health.findings import Finding
from anisomap.health.recording_check import CHECKS, Repair, find_faults, repair
from anisomap.health.summary import RecordingSummary, spoiling, summarise, weaknesses
from anisomap.health.touch_coverage import Place, TouchCoverage, next_places, touch_coverage

__all__ = [
    "CHECKS",
    "STATUSES",
    "Finding",
    "Matches",
    "Place",
    "RecordingSummary",
    "Repair",
    "SensorHealth",
    "TouchCoverage",
    "assess",
    "find_faults",
    "next_places",
    "repair",
    "spoiling",
    "summarise",
    "touch_coverage",
    "weaknesses",
]
