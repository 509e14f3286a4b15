"""Engines: they integrate many runs at once and keep only the states in which these end.

`interface` says what an engine is, `select` which one takes an equation. `step` is the adaptive
Runge–Kutta step that the engines in JAX and in machine code share.
"""
