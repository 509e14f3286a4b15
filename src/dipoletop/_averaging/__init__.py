"""Averages over free rotation, and the slow flow that they drive, in the limit of weak radiation.

`principal_axes` describes a free rotation, `free_rotation` holds the averages of the radiation over
one period, in closed form. `slow_flow` is the law for the shape of the rotation that follows from
them, `motion` its solution in time, `capture` the end of axisymmetric bodies, and `ends` how any
motion ends. `orbit`, `landen` and `dipole_series` give the Fourier series of the dipole.
"""
