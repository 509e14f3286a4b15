"""Exact solutions of the reduced equations, and their late-time laws."""

from .closed_forms import (
    averaged,
    averaged_late,
    averaged_time,
    longitudinal,
    longitudinal_exponents,
    rotator,
    rotator_closed_time,
    rotator_late,
    transverse,
)

__all__ = [
    "averaged",
    "averaged_late",
    "averaged_time",
    "longitudinal",
    "longitudinal_exponents",
    "rotator",
    "rotator_closed_time",
    "rotator_late",
    "transverse",
]
