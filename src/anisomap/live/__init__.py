"""Live sessions: a map that grows while the skin is touched.

====================  ============================================================
`batches`             what a source of frames is, and what it yields
`sources`             where frames come from
`recorder`            the recording on disk
`quick_map`           the quick map, and where to touch next
`workers`             the checked map, and the processes that make both
`session`             all of this together, and when maps are made
`saving`              the files that a session writes besides its recording
`page`                the page in the browser
====================  ============================================================
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
