"""Verdicts: the regions of state space that decide the outcome, with ω∞ and its error.

`transverse` decides for the axisymmetric top with a transverse dipole, `any_body` for every other
body. Both give ω∞ by its expansion near the residual line (`residual_line`, `residual_series`).
"""
