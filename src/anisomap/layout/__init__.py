"""Checks of stated sensor positions against the readings of a recording."""

from anisomap.layout.checking import check_layout
from anisomap.layout.findings import KINDS, LayoutCheck, LayoutFinding
from anisomap.layout.grouping import module_members

__all__ = ["KINDS", "LayoutCheck", "LayoutFinding", "check_layout", "module_members"]
