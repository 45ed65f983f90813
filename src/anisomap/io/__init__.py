"""Read recordings and maps from files, and write them.

`registry` lists every format, and reads and writes with it. `stream` holds the blocks in which
recordings are read. `recordings` and `maps` hold the formats, and `parsing` the code they share. A
new format is its reader and writer, and one line in `registry.FORMATS`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
