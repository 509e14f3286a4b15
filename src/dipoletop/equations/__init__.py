"""Equations of motion; each is a diffrax vector field with components on axis 0.

`rigid` holds the equations of any body, `transverse` and `longitudinal` the closed forms of
axisymmetric tops, `transverse_approximations` their averaged and linearised forms, `rotator` the
plane rotator (its curves in the phase plane: `rotator_curves`). `levels` names the levels of
approximation, `coordinates` converts to cylindrical variables, `tangent` adds first variations to
any equation. `_verdicts` says when the outcome of a run is certain. The members of an equation are
listed in `_base/types.py`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
