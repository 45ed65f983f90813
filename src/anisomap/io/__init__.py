"""Reading recordings and maps from files, and writing them.

Where things are:

=================  =================================================================
`registry`         `FORMATS`, and `read`, `open_stream`, `write` ..., which choose from it
`kind`             what a format is
`npz`              NumPy archives: recordings and maps
`text`             delimited text: recordings
`map_csv`          delimited text: maps and true positions
`yarp`             what ``yarpdatadumper`` leaves: ``data.log``, folders and sessions
`mats`             exports of pressure mats
`mat`, `hdf5`      MATLAB and HDF5: named arrays
`arrow`            Parquet, Arrow, Feather
`rosbag`           ROS 1 and 2 bags, MCAP
`images`           stacks of images
`map_json`         maps as JSON
`ply`              maps as point clouds
`stream`           recordings as they come, block by block, and what is made of them
`choice`           files that hold several things, and which is the recording
`joining`          parts of a skin that were recorded side by side
`presets`          robots whose numbering of sensors is known
`grids`            rectangular arrays
`source`           opening files, and one clear sentence for all that can fail
`foreign`          other people's readers: loaded when needed, kept in bounds
`frames`           times that increase, readings in as few bytes as they need
`archive`          the arrays of an NPZ file, checked before they are unpacked
`datasets`         which of several named arrays is the recording, and what belongs to it
`ros_messages`     what messages of tactile sensors hold
`ros_files`        what rosbags has to be told about files
`ros_repair`       bags without an end
`table`            numbers in lines of text: fast, and with the line of what is wrong
`delimited`        delimiter, header and records of delimited text
`columns`          which columns are time or a frame counter
`comments`         ``# key: value`` lines at the top of a text file
=================  =================================================================

A new format is one file with its readers and writers, and one line in `registry.FORMATS`.
"""

from anisomap.io.choice import ChoiceError as ChoiceError
from anisomap.io.choice import Content as Content
from anisomap.io.format import Format as Format
from anisomap.io.recordings.presets import apply_preset as apply_preset
from anisomap.io.recordings.presets import numbering as numbering
from anisomap.io.registry import FORMATS as FORMATS
from anisomap.io.registry import check_writable as check_writable
from anisomap.io.registry import contents as contents
from anisomap.io.registry import needs_scale as needs_scale
from anisomap.io.registry import open_stream as open_stream
from anisomap.io.registry import read as read
from anisomap.io.registry import read_map as read_map
from anisomap.io.registry import write as write
from anisomap.io.stream import Block as Block
from anisomap.io.stream import ReadOptions as ReadOptions
from anisomap.io.stream import Stream as Stream
