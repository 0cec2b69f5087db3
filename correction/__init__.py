"""Frames as if the glass were not there, and their uncertainty.

``__init__.pyi`` lists names for a notebook, imported when first used; inside the project modules are named
in full.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
