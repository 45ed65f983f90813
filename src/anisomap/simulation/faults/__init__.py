"""What goes wrong with real skins, done to any recording: composable, seeded, on the record.

To add a fault, add one function and one line to `FAULTS` or `FRAME_FAULTS`.
"""

from anisomap.simulation.faults.log import (
    ALL_SENSORS,
    RECORD,
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
from anisomap.simulation.faults.sensors import (
    dead,
    drifting,
    gain_spread,
    hysteresis,
    nan_bursts,
    noisy,
    quantised,
    saturating,
    stuck,
    thresholded,
)
from anisomap.simulation.faults.timing import clock_jitter, dropped_frames, repeated_frames
from anisomap.simulation.faults.wiring import crosstalk, duplicated, mirrored, swapped

__all__ = [
    "ALL_SENSORS",
    "FAULTS",
    "FRAME_FAULTS",
    "RECORD",
    "Fault",
    "FaultRequest",
    "clock_jitter",
    "crosstalk",
    "dead",
    "drifting",
    "dropped_frames",
    "duplicated",
    "fault_mask",
    "gain_spread",
    "hysteresis",
    "inject",
    "injected_faults",
    "mirrored",
    "nan_bursts",
    "noisy",
    "parse_fault",
    "quantised",
    "repeated_frames",
    "saturating",
    "stuck",
    "swapped",
    "thresholded",
]
