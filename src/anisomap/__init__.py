"""Reconstruct the positions of a robot's tactile sensors from their readings alone.

McGregor, Polani & Dautenhahn (2011), "Generation of Tactile Maps for Artificial Skin",
PLoS ONE 6(11): e26561, doi:10.1371/journal.pone.0026561.

Names are listed in `__init__.pyi`, for type checkers, and imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
