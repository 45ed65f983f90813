"""Checks of stated sensor positions against the readings of a recording."""

from anisomap.layout.checking import check_layout
from anisomap.layout.findings import KINDS, LayoutCheck, LayoutFinding
from anisomap.layout.modules import find_modules
from anisomap.layout.readings import reading_statistics

__all__ = [
    "KINDS",
    "LayoutCheck",
    "LayoutFinding",
    "check_layout",
    "find_modules",
    "reading_statistics",
]
