"""Checks of stated sensor positions against the readings of a recording."""

from anisomap.layout.checking import check_layout
from anisomap.layout.findings import KINDS, Finding, LayoutCheck
from anisomap.layout.grouping import module_members

__all__ = ["KINDS", "Finding", "LayoutCheck", "check_layout", "module_members"]
