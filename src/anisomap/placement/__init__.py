"""Scale, handedness and surface normals of a map, as robot software needs them.

A map is known up to rotation, translation, scale and mirror image. The distance between
neighbouring sensors and the handedness of the skin come from the user.
"""

from anisomap.placement.modules import NO_MODULE as NO_MODULE
from anisomap.placement.modules import Modules as Modules
from anisomap.placement.modules import modules_by_name as modules_by_name
from anisomap.placement.modules import modules_by_size as modules_by_size
from anisomap.placement.orientation import mirrored as mirrored
from anisomap.placement.orientation import pad_to_3d as pad_to_3d
from anisomap.placement.orientation import surface_normals as surface_normals
from anisomap.placement.scale import METRES as METRES
from anisomap.placement.scale import median_spacing as median_spacing
from anisomap.placement.scale import parse_length as parse_length
from anisomap.placement.scale import scaled_to_spacing as scaled_to_spacing
from anisomap.placement.taxels import Taxels as Taxels
from anisomap.placement.taxels import to_taxels as to_taxels
