"""Live sessions: a map that grows while the skin is touched.

====================  ============================================================
`batches`             what a source of frames is, and what it yields
`sources`             where frames come from
`recorder`            the recording on disk
`quick_map`           the quick map, and where to touch next
`examination`         the checked map
`workers`             the processes that make both
`session_maps`        when maps are made, and what they show so far
`session`             all of this together
`saving`              the files that a session writes besides its recording
`page`                the page in the browser
====================  ============================================================
"""

from anisomap.live.examination import ExaminationOptions as ExaminationOptions
from anisomap.live.session import LiveSession as LiveSession
from anisomap.live.sources import open_source as open_source
