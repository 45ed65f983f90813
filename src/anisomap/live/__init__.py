"""Live sessions: a map that grows while the skin is touched.

====================  ============================================================
`sources`             where frames come from
`recorder`            the recording on disk, `journal` its file
`maps`                the quick and the checked maps, and where to touch next
`levels`              what each sensor reads now
`history`             what has happened so far
`session`             all of this together
`saving`              the files that a session writes besides its recording
`page`                the page in the browser
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
