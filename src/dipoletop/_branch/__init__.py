"""The physical branch of the full equations.

`window` solves for a stretch of motion as a boundary-value problem, whose elements are those of
`mesh`; `march` joins such stretches, `turning` follows the attitude, and `slow_manifold` gives the
rate of ω at one angular velocity.
"""
