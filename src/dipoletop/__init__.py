"""dipoletop: rotation of a rigid electric dipole that radiates, its outcomes and their basins."""

import difflib
from importlib.metadata import version
from typing import Any

import lazy_loader

# Every name is imported when it is used, from where `__init__.pyi` says.
_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("dipoletop")


def __getattr__(name: str) -> Any:
    if name in __all__:
        return _imported(name)
    (near,) = difflib.get_close_matches(name, __all__, 1) or [None]
    meant = f"; did you mean {near!r}?" if near else ""
    raise AttributeError(f"dipoletop has no attribute {name!r}{meant}", name=name)
