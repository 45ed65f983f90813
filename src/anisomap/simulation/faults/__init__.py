"""Documented, reproducible faults for any recording.

To add a fault, add one function with a decorator of `anisomap.simulation.faults.forms` to
`channels`, `electronics` or `timing`.
"""

from anisomap.simulation.faults import channels, electronics, timing
from anisomap.simulation.faults.forms import FAULTS, FRAME_FAULTS
from anisomap.simulation.faults.log import (
    ALL_SENSORS,
    METADATA_KEY,
    Fault,
    fault_mask,
    injected_faults,
)
from anisomap.simulation.faults.request import (
    FaultRequest,
    inject,
    parse_fault,
)

__all__ = [
    "ALL_SENSORS",
    "FAULTS",
    "FRAME_FAULTS",
    "METADATA_KEY",
    "Fault",
    "FaultRequest",
    "channels",
    "electronics",
    "fault_mask",
    "inject",
    "injected_faults",
    "parse_fault",
    "timing",
]
