"""Read recordings and maps from files, and write them.

`registry` lists every format, and reads and writes with it. `stream` holds the blocks in which
recordings are read. `recordings` and `maps` hold the formats, and `parsing` the code they share. A
new format is its reader and writer, and one line in `registry.FORMATS`.
"""

from anisomap.io.dissimilarities import Dissimilarities as Dissimilarities
from anisomap.io.dissimilarities import find_dissimilarities as find_dissimilarities
from anisomap.io.dissimilarities import read_dissimilarities as read_dissimilarities
from anisomap.io.dissimilarities import read_pair_weights as read_pair_weights
from anisomap.io.maps.point_files import to_montage as to_montage
from anisomap.io.maps.robot_models import read_robot as read_robot
from anisomap.io.maps.text_files import read_modules as read_modules
from anisomap.io.presets import apply_preset as apply_preset
from anisomap.io.presets import numbering as numbering
from anisomap.io.registry import FORMATS as FORMATS
from anisomap.io.registry import Format as Format
from anisomap.io.registry import attach_positions as attach_positions
from anisomap.io.registry import check_writable as check_writable
from anisomap.io.registry import contents as contents
from anisomap.io.registry import needs_scale as needs_scale
from anisomap.io.registry import open_stream as open_stream
from anisomap.io.registry import read as read
from anisomap.io.registry import read_map as read_map
from anisomap.io.registry import write as write
from anisomap.io.registry import write_components as write_components
from anisomap.io.statistics_files import read_statistics as read_statistics
from anisomap.io.statistics_files import statistics_beside as statistics_beside
from anisomap.io.statistics_files import write_statistics as write_statistics
from anisomap.io.stream import Block as Block
from anisomap.io.stream import ChoiceError as ChoiceError
from anisomap.io.stream import Content as Content
from anisomap.io.stream import ReadOptions as ReadOptions
from anisomap.io.stream import Stream as Stream
