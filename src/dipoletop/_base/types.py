"""Words that every module shares: outcomes, the ways of stopping, and a verdict."""

import enum
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
from jaxtyping import Array, Bool, Float, Int

Real = Float[Array, "*#lanes"]
"""One real number for each lane; no lane axis for a single top."""
Vector = Float[Array, "3 *#lanes"]
"""Three body-frame components on axis 0, lanes (if any) behind."""
Matrix = Float[Array, "3 3 *#lanes"]
"""A 3×3 matrix in body axes, its two indices on axes 0 and 1, lanes (if any) behind."""
Flag = Bool[Array, "*#lanes"]
"""One truth value for each lane."""
State = Float[Array, "n *#lanes"]
"""The state of an equation: components on axis 0, lanes (if any) behind."""


class Outcome(enum.IntEnum):
    """How a run ended."""

    FAILED = -1
    """Not a number, a step size underflow, or a runaway: no statement about the top."""
    UNDECIDED = 0
    """The budget of steps ran out before the outcome was certain."""
    RESIDUAL = 1
    """ω tends to ω∞ ≠ 0 along the dipole."""
    STOP = 2
    """ω tends to 0."""


class Stop(enum.IntEnum):
    """In which way a top stops; NONE for every other outcome."""

    NONE = 0
    AXIS = 1
    """Spin about a fixed axis that decays by itself (or no rotation at all)."""
    ROTATING = 2
    """The angular velocity keeps turning about the symmetry axis while it decays."""
    WOBBLING = 3
    """The angular velocity swings about the axis across the dipole while it decays."""
    TUMBLING = 4
    """Free rotation of a general body whose energy and angular momentum decay."""


class Verdict(NamedTuple):
    """What an equation says of a state: is its fate certain, and what is it?

    Every field but `equation` has one value for each lane. An equation may return a plain tuple
    of the first fields, too: that is never certified.
    """

    outcome: Int[Array, "*lanes"]
    """`Outcome.UNDECIDED` while the state does not decide."""
    omega_inf: Real
    """Residual angular velocity, signed, along the dipole; 0 for STOP, NaN if undecided."""
    certified: Bool[Array, "*lanes"]
    """Whether the region that was entered is proven to decide, for the motions of `equation`."""
    stop: Int[Array, "*lanes"] | int = 0
    """A member of `Stop`."""
    error: Real | float = 0.0
    """Estimated error of `omega_inf`, relative to it; 0 where that is a constant of the motion."""
    slope: Real | float = 0.0
    """Estimated error of the derivatives of `omega_inf` with respect to state and parameters."""
    equation: type | None = None
    """The class of equation that the regions belong to. `certified` counts only where that very
    class is integrated: not with another `__call__`, nor with a torque added from outside."""

    def belongs_to(self, equation: Any) -> bool:
        """Whether the regions are those of this equation."""
        return self.equation is type(equation)

    def certified_for(self, equation: Any) -> Any:
        """`certified`, unless the regions are those of another equation."""
        return self.certified & self.belongs_to(equation)


# The class of an equation is no array: it stays out of what is traced.
jax.tree_util.register_pytree_node(
    Verdict, lambda verdict: (verdict[:-1], verdict[-1]), lambda kind, rest: Verdict(*rest, kind)
)


@runtime_checkable
class Equation(Protocol):
    """What the library asks of a first-order equation of motion, yours included.

    Make it an `equinox.Module` whose array fields are its parameters. A method `verdict(y)` is
    needed only by runs that are to end at an outcome: it returns a `Verdict`, whose last field,
    `equation`, is the class itself, written out, if its regions are proven for that class.
    """

    def __call__(self, t: Any, y: State, args: Any = None, /) -> State:
        """The right-hand side dy/dτ."""
        ...

    def lift(self, omega0: Vector, /) -> State:
        """The state that starts at the angular velocity `omega0`."""
        ...

    def omega(self, y: State, /) -> Vector:
        """The angular velocity of a state, in body axes."""
        ...
