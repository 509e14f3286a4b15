"""The levels of approximation of the equation of motion, by name."""

import enum

from .._base.checks import refuse

LACKS = "Order 1 lacks a leading term of the full equation"


class Level(enum.StrEnum):
    """How closely an equation of motion follows the full one.

    The torque of radiation holds the first and the second derivative of ω. The levels differ in
    what they put in their place; the value is the word of the command line.
    """

    ORDER_1 = "order-1"
    """The paper's reduced equation: both derivatives are those of free rotation."""
    ORDER_2 = "order-2"
    """Both derivatives are those of order 1; and so on for the next ones."""
    ORDER_3 = "order-3"
    ORDER_4 = "order-4"
    SEMI = "semi"
    """Semi-reduced: only the second derivative is replaced, by that of free rotation."""
    FULL = "full"
    """The full equation, on its physical branch."""

    @classmethod
    def of_order(cls, order: int) -> "Level":
        """The reduced level of an order from 1 to 4."""
        return cls(f"order-{order}")

    @classmethod
    def named(cls, level: str, argument: str = "level") -> "Level":
        """The level of a name; `argument` is what an error calls it."""
        if level not in list(cls):
            refuse(argument, f"be one of {', '.join(cls)}", f"is {level!r}")
        return cls(level)

    @property
    def order(self) -> int | None:
        """The order of a reduced level, else None."""
        word, _, number = self.value.partition("-")
        return int(number) if word == "order" else None

    @property
    def label(self) -> str:
        """The name in tables and pictures, `equation.level`."""
        if self is Level.SEMI:
            return "semi-reduced"
        if self is Level.FULL:
            return "full"
        return f"reduced, order {self.order}" + (" (the paper's)" if self.order == 1 else "")

    @property
    def consistent(self) -> bool:
        """Whether it holds every term of leading order in small |ω|; order 1 lacks one."""
        return self is not Level.ORDER_1


CONSISTENT = Level.SEMI
"""The consistent level that costs no more than order 1."""
