"""Scale, handedness, pose and surface normals of a map, as robot software needs them.

A map is known up to rotation, translation, scale and mirror image. Known positions of some sensors,
known rigid modules, and the distance between neighbouring sensors determine the rest.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
