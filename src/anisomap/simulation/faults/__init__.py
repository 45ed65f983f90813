"""Documented, reproducible faults for any recording.

To add a fault, add one function and one line to `FAULTS` or `FRAME_FAULTS`.
"""

from anisomap.simulation.faults.log import (
    ALL_SENSORS,
    METADATA_KEY,
    Fault,
    fault_mask,
    injected_faults,
)
from anisomap.simulation.faults.request import (
    FAULTS,
    FRAME_FAULTS,
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
    "fault_mask",
    "inject",
    "injected_faults",
    "parse_fault",
]
