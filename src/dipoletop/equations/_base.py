"""What several equations share: labels, checks, and states that are ω itself."""

from typing import Any

from .._checks import refuse
from .._types import Vector


def check_order(order: Any) -> None:
    """Orders beyond 4 cost about four times more each, and the series diverges."""
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= 4:
        refuse("order", "be 1, 2, 3 or 4", f"is {order!r}")


def order_label(order: int) -> str:
    """What a reduced equation is called in tables and pictures."""
    return f"reduced, order {order}" + (" (the paper's)" if order == 1 else "")


def unchanged(self: Any, omega: Vector) -> Vector:
    """The state is the angular velocity itself, shape (3,) or (3, B)."""
    return omega
