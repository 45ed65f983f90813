"""Maps that are kept up to date: the evidence of several recordings is pooled."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
