"""Scale, handedness, pose and surface normals of a map, as robot software needs them.

A map is known up to rotation, translation, scale and mirror image. Known positions of some sensors,
known rigid modules, and the distance between neighbouring sensors determine the rest.
"""

from anisomap.placement.anchors import Anchors as Anchors
from anisomap.placement.anchors import anchors_from_map as anchors_from_map
from anisomap.placement.anchors import parse_anchor as parse_anchor
from anisomap.placement.anchors import suggest_anchors as suggest_anchors
from anisomap.placement.modules import NO_MODULE as NO_MODULE
from anisomap.placement.modules import Modules as Modules
from anisomap.placement.modules import modules_by_name as modules_by_name
from anisomap.placement.modules import modules_by_size as modules_by_size
from anisomap.placement.orientation import mirrored as mirrored
from anisomap.placement.orientation import pad_to_3d as pad_to_3d
from anisomap.placement.orientation import surface_normals as surface_normals
from anisomap.placement.placing import Placement as Placement
from anisomap.placement.placing import place as place
from anisomap.placement.rigid_fit import ModuleFit as ModuleFit
from anisomap.placement.rigid_fit import fit_modules as fit_modules
from anisomap.placement.scale import METRES as METRES
from anisomap.placement.scale import median_spacing as median_spacing
from anisomap.placement.scale import parse_length as parse_length
from anisomap.placement.scale import scaled_to_spacing as scaled_to_spacing
from anisomap.placement.self_touch import SelfTouch as SelfTouch
from anisomap.placement.self_touch import TouchPlacement as TouchPlacement
from anisomap.placement.self_touch import place_by_self_touch as place_by_self_touch
from anisomap.placement.taxels import Taxels as Taxels
from anisomap.placement.taxels import to_taxels as to_taxels
