"""Where the sensors of a robot's skin are, from nothing but what they read.

McGregor, Polani & Dautenhahn (2011), "Generation of Tactile Maps for Artificial Skin",
PLoS ONE 6(11): e26561, doi:10.1371/journal.pone.0026561.

The names live in `__init__.pyi`, where type checkers read them; each is imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
