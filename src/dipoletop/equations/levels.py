"""The levels of the transverse top by the names that the command line and tables give them."""

from typing import Any

from .transverse import TransverseFull, TransverseReduced, TransverseSemi

LEVELS = ("order-1", "order-2", "order-3", "order-4", "semi", "full")

CONSISTENT = "semi"
"""The level that lacks nothing of leading order, and costs no more than order 1."""
LACKS = "Order 1 lacks a leading term of the full equation"


def equation(level: str, delta: Any) -> TransverseReduced | TransverseSemi | TransverseFull:
    """The equation of a level, one of `LEVELS`."""
    if level in ("semi", "full"):
        return TransverseSemi(delta) if level == "semi" else TransverseFull(delta)
    return TransverseReduced(delta, int(level.removeprefix("order-")))
