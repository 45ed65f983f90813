"""Summary of a recording, health of the sensors, and faults of the recording as a whole."""

from anisomap.health.faults import CHECKS, Repair, find_faults, repair
from anisomap.health.findings import Finding, spoiling
from anisomap.health.sensors import STATUSES, SensorHealth, assess
from anisomap.health.summary import RecordingSummary, summarise, weaknesses
from anisomap.health.touch_coverage import Place, TouchCoverage, next_places, touch_coverage

__all__ = [
    "CHECKS",
    "STATUSES",
    "Finding",
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
