"""The levels of approximation of the equation of motion, by name."""

import enum
from typing import Any

from .._base.refusals import refuse

WITH_TORQUE = ", with a torque"
"""The end of the label of a level with a torque from outside."""


class Level(enum.StrEnum):
    """How closely an equation of motion approximates the full one.

    The radiation torque contains ω′ and ω″. The full equation keeps both and has runaways; the
    other levels replace one or both by functions of ω, as in the order reduction of the
    Abraham–Lorentz equation by Landau and Lifshitz. The values are the words of the command line.
    """

    ORDER_1 = "order-1"
    """The paper's reduced equation: ω′ and ω″ in the torque are taken from free rotation."""
    ORDER_2 = "order-2"
    """ω′ and ω″ in the torque are taken from order 1, and so on for the next orders. The sequence
    is the asymptotic expansion of the physical branch."""
    ORDER_3 = "order-3"
    ORDER_4 = "order-4"
    SEMI = "semi"
    """Semi-reduced: ω″ in the torque is taken from free rotation; ω′ is kept and solved for."""
    FULL = "full"
    """The full equation, restricted to its physical branch: the slow manifold without runaways."""

    @classmethod
    def of_order(cls, order: int) -> "Level":
        """Return the reduced level of an order from 1 to 4."""
        return cls(f"order-{order}")

    @classmethod
    def named(cls, level: str, argument: str = "level") -> "Level":
        """Return the level with a given value; errors call the argument `argument`."""
        if level not in list(cls):
            refuse(argument, f"be one of {', '.join(cls)}", f"is {level!r}")
        return cls(level)

    @classmethod
    def labelled(cls, label: str) -> "Level":
        """Return the level with a given label."""
        return next(level for level in cls if level.label == label)

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
        """Whether every term of leading order in small |ω| is kept; order 1 omits one."""
        return self is not Level.ORDER_1

    @property
    def caveat(self) -> str:
        """A warning about the level; empty if it is consistent."""
        return "" if self.consistent else "Order 1 lacks a leading term of the full equation"


def level_of(equation: Any) -> str:
    """Return the label of an equation: its `level`, else the name of its class."""
    return getattr(equation, "level", type(equation).__name__)
