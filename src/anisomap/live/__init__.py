"""Live sessions: a map that grows while the skin is touched.

====================  ============================================================
`sources`             where frames come from
`recorder`            the recording on disk, `journal` its file
`statistics`          what is accumulated of the frames
`mapping`             the quick map, `examination` the checked map
`coach`               where to touch next
`workers`             the processes that make the maps
`session_maps`        when maps are made, and what they show so far
`levels`              what each sensor reads now
`session`             all of this together
`server`, `page`      the page in the browser
====================  ============================================================
"""

from anisomap.live.examination import Examination, ExaminationOptions
from anisomap.live.session import LiveSession
from anisomap.live.sources import SOURCES, open_source

__all__ = [
    "SOURCES",
    "Examination",
    "ExaminationOptions",
    "LiveSession",
    "open_source",
]
