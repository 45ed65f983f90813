"""Checks of stated sensor positions against the readings of a recording."""

from anisomap.layout.checking import KINDS, LayoutCheck, LayoutFinding, check_layout
from anisomap.layout.explanation import module_members

__all__ = ["KINDS", "LayoutCheck", "LayoutFinding", "check_layout", "module_members"]
