"""Summary of a recording, and the health of its sensors."""

from anisomap.health.assessment import STATUSES, SensorHealth, assess
from anisomap.health.behaviour import Matches
from anisomap.health.summary import RecordingSummary, summarise, weaknesses

__all__ = [
    "STATUSES",
    "Matches",
    "RecordingSummary",
    "SensorHealth",
    "assess",
    "summarise",
    "weaknesses",
]
