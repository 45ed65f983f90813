"""Read recordings and maps from files, and write them.

`registry` lists every format, and reads and writes files. `stream` contains the blocks in which
recordings are read. `recordings` and `maps` contain the formats, and `parsing` their common code. A
new format is a reader and a writer, and one line in `registry.FORMATS`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
