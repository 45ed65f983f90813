"""Scale, handedness, pose and surface normals of a map, as required by robot software.

A map is known up to rotation, translation, scale and mirror image. These are determined by known
positions of some sensors, known rigid modules, or the distance between neighbouring sensors.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
