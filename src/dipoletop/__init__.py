"""dipoletop: rotation of a rigid electric dipole that radiates, its outcomes and their basins."""

from importlib.metadata import version

import lazy_loader

# Every name is imported when it is used, from where `__init__.pyi` says.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("dipoletop")
