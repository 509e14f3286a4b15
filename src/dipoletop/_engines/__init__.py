"""Engines, which integrate many runs at once and keep only their end states.

`interface` defines an engine, `select` chooses one for an equation. `step` is the adaptive
Runge–Kutta step that the engines in JAX and in machine code share.
"""
