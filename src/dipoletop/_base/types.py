"""Types common to all modules: arrays, outcomes, verdicts, and the interface of an equation."""

import enum
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
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
ErrorScale = Callable[[State], State]
"""A function from a state to the scale of the relative error of each component."""
OmegaScale = Callable[[Vector], Vector]
"""A function from an angular velocity to the scale of its relative error."""


class Outcome(enum.IntEnum):
    """How a run ended."""

    FAILED = -1
    """NaN, step-size underflow, or a runaway: nothing is known about the top."""
    UNDECIDED = 0
    """The maximum number of steps was reached before the outcome was certain."""
    RESIDUAL = 1
    """ω tends to the residual rotation ω∞ ≠ 0 along the dipole."""
    STOP = 2
    """ω tends to 0."""


class Stop(enum.IntEnum):
    """The way in which a top stops; NONE for every other outcome."""

    NONE = 0
    AXIS = 1
    """A decaying rotation about a fixed axis of the body (or no rotation at all)."""
    ROTATING = 2
    """The angular velocity keeps precessing about the symmetry axis while it decays."""
    WOBBLING = 3
    """The angular velocity oscillates about the axis across the dipole while it decays."""
    TUMBLING = 4
    """Free rotation of a general body whose energy and angular momentum decay."""


class Fate(enum.IntEnum):
    """How a motion ends, in full: outcome, sense of a residual rotation, kind of a stop.

    A prediction has a probability for each member from POSITIVE to WOBBLING, in this order. A run
    knows a stop by its `Stop`, which tells no axis; it has the members from AXIS on, or WOBBLING.
    Numbers below POSITIVE are those of motions whose fate is not known, or not in full.
    """

    RESIDUAL = -3
    """Residual rotation of unknown sense."""
    FAILED = -2
    UNDECIDED = -1
    """No outcome."""
    POSITIVE = 0
    """Residual rotation with ω∞ > 0."""
    NEGATIVE = 1
    """Residual rotation with ω∞ < 0."""
    AXIS_1 = 2
    """A stop in pure spin about the principal axis of J₁, the smallest moment."""
    AXIS_2 = 3
    """A stop in pure spin about the principal axis of J₂."""
    AXIS_3 = 4
    """A stop in pure spin about the principal axis of J₃, the largest moment."""
    TUMBLING_LOW = 5
    """A stop while tumbling, with h = 2E/L² below 1/J₂."""
    TUMBLING_HIGH = 6
    """A stop while tumbling, with h above 1/J₂."""
    WOBBLING = 7
    """A stop while oscillating about the axis across the dipole (the middle one of a needle)."""
    AXIS = 8
    """A stop about a fixed axis."""
    ROTATING = 9
    """A stop while the angular velocity precesses about the symmetry axis."""
    TUMBLING = 10
    """A stop while tumbling."""
    STOP = 11
    """A stop of unknown kind."""


PREDICTED_FATES = tuple(fate for fate in Fate if 0 <= fate <= Fate.WOBBLING)
"""The fates that have probabilities: POSITIVE to WOBBLING."""
RESIDUAL_FATES = slice(Fate.POSITIVE, Fate.NEGATIVE + 1)
"""The residual rotations among them."""
STOP_FATES = slice(Fate.AXIS_1, Fate.WOBBLING + 1)
"""The stops among them."""


class Regime(enum.IntEnum):
    """The law that decided how a motion ends."""

    RESOLVED = 0
    """Integration of the equation of motion, turn by turn."""
    SLOW_FLOW = 1
    """The average over the free rotation of a body with three different moments."""
    AVERAGED = 2
    """The average over the free rotation of a body with two equal moments."""
    UNFOLDED = 3
    """The limit of small amplitudes of a body with two nearly equal moments, rotating across its
    symmetry axis."""
    EXACT = 4
    """A solution in closed form."""


def implied_probability(outcome: Any, xp: ModuleType = np) -> Any:
    """Return the probability of residual rotation from the outcome alone: 1, 0 (STOP) or NaN.

    `xp` is NumPy or its counterpart in JAX.
    """
    residual = xp.where(outcome == Outcome.RESIDUAL, 1.0, 0.0)
    return xp.where(outcome > Outcome.UNDECIDED, residual, xp.nan)


def fate_of(outcome: Any, stop: Any, omega_inf: Any) -> Any:
    """Return the fates of runs, as numbers: the sense of a rotation follows from ω∞, if known.

    In NumPy, unless an argument is traced.
    """
    xp: Any = jnp if isinstance(outcome, Tracer) else np
    sense = xp.where(omega_inf < 0, Fate.NEGATIVE, Fate.RESIDUAL)
    sense = xp.where(omega_inf > 0, Fate.POSITIVE, sense)
    kinds = xp.asarray([Fate[kind.name] if kind else Fate.STOP for kind in Stop])
    others = xp.where(outcome == Outcome.FAILED, Fate.FAILED, Fate.UNDECIDED)
    fate = xp.where(outcome == Outcome.RESIDUAL, sense, others)
    return xp.where(outcome == Outcome.STOP, kinds[xp.asarray(stop)], fate)


class Verdict(NamedTuple):
    """The outcome that follows from a state, if it is certain, with ω∞ and estimates of errors.

    Every field except `equation` has one value for each lane. An equation may also return a plain
    tuple of the first fields; that is never certified.
    """

    outcome: Int[Array, "*lanes"]
    """A member of `Outcome`; UNDECIDED while the outcome is not certain."""
    omega_inf: Real
    """Residual angular velocity, signed, along the dipole; 0 for STOP, NaN if undecided."""
    certified: Bool[Array, "*lanes"]
    """Whether the region that contains the state is proven to decide, for motions of `equation`."""
    stop: Int[Array, "*lanes"] | int = 0
    """A member of `Stop`."""
    error: Real | float = 0.0
    """Estimated error of `omega_inf`, relative to it; 0 if ω∞ is a constant of the motion."""
    slope: Real | float = 0.0
    """Estimated error of the derivatives of `omega_inf` with respect to state and parameters."""
    size: Real | None = None
    """An approximation of |ω∞| that costs less, for the test after each step; None: |ω∞| itself."""
    equation: type | None = None
    """The class of equation for which the regions are proven. `certified` counts only if exactly
    this class is integrated, without another `__call__` or a torque added from outside."""

    def belongs_to(self, equation: Any) -> bool:
        """Return whether the regions are proven for the class of this equation."""
        return self.equation is type(equation)

    def certified_for(self, equation: Any) -> Any:
        """Return `certified`, or False if the regions belong to another class."""
        return self.certified & self.belongs_to(equation)


# A class cannot be traced: `equation` is static data of the pytree.
jax.tree_util.register_pytree_node(
    Verdict, lambda verdict: (verdict[:-1], verdict[-1]), lambda kind, rest: Verdict(*rest, kind)
)


@runtime_checkable
class Equation(Protocol):
    """An equation of motion dy/dτ = F(y), with the members that the library needs to integrate it.

    Make it an `equinox.Module` whose array fields are its parameters. `DecidingEquation` adds the
    end of a run and `FullEquation` the physical branch; `OptionalMembers` lists further members
    that an equation may have.
    """

    def __call__(self, t: Any, y: State, args: Any = None, /) -> State:
        """Return the right-hand side dy/dτ."""
        ...

    def lift(self, omega0: Vector, /) -> State:
        """Return the initial state whose angular velocity is `omega0`."""
        ...

    def omega(self, y: State, /) -> Vector:
        """Return the angular velocity of a state, in body axes."""
        ...


@runtime_checkable
class DecidingEquation(Equation, Protocol):
    """An equation that can end a run, as `classify`, `sweep` and functions based on them need."""

    def verdict(self, y: State, /) -> Verdict:
        """Return the outcome, as soon as the state makes it certain; cheap enough for every step.

        The last field of the `Verdict`, `equation`, is the class itself, written out, if its
        regions are proven for that class. A plain tuple of the first fields is accepted, too.
        """
        ...


class FullEquation(DecidingEquation, Protocol):
    """A full equation: runaways leave a slow manifold, its physical branch, exponentially.

    The state is (s, a): a is the part of ω′ that is free; s is ω, followed by the attitude if the
    equation has a `start` (see `OptionalMembers`). `_branch` follows the branch by boundary-value
    problems and needs every member. An equation with a `branch` needs only `runaway_rate`.
    """

    @property
    def runaway_rate(self) -> Real | float:
        """The slowest rate at which a distance from the branch grows near rest, per unit of τ.

        An equation is full if this member exists and is not None (`_common.is_full`).
        """
        ...

    @property
    def body(self) -> Any:
        """The `Body` that moves."""
        ...

    def fast(self, omega_dot: Vector, /) -> State:
        """Return a, the part of a given ω′ that belongs to the state."""
        ...

    def reduced(self, order: int, /) -> Callable[..., Vector]:
        """Return the reduced level of an order, which approximates the branch: s′ = f(τ, s)."""
        ...

    @property
    def semi(self) -> Callable[..., Vector]:
        """The semi-reduced level, which approximates the branch: s′ = f(τ, s)."""
        ...


class OptionalMembers(Protocol):
    """Members that any equation may have; the library can do without them."""

    level: str
    """The label in tables and pictures; if missing, the name of the class (`levels.level_of`)."""
    body: Any
    """The `Body` that moves: energies, powers, spectra and decay times need it.

    A field of that name is a parameter, whose moments and dipole may vary independently;
    derivatives of ω∞ allow for this (`_common.has_body_field`)."""
    order: int
    """The order of a reduced level; an equation without one counts as semi-reduced.

    Derivatives of ω∞ with respect to a `body` field depend on it."""
    branch: DecidingEquation
    """The equation of the physical branch of a full equation, if known in closed form
    (`_common.physical`)."""
    prepare: Callable[[], Any]
    """A function that returns the quantities in verdicts that depend on the parameters only: a
    pytree of arrays, lanes last. An engine calls it once for a run, for `verdict(y, prepared)`."""
    torque: Callable[..., Vector]
    """A torque from outside, M(τ, y) in body axes, whose work enters the balance of energy
    (`_common.energy_flows`)."""
    start: Any
    """The attitude at the start, if states contain one (`_common.slow_start`)."""
    attitude: Callable[[State], Any]
    """The attitude of a state, a unit quaternion, if states contain one."""
    elements: int
    """Number of elements into which `_branch` divides a window of a full equation; if missing, 4
    (`_common.elements_of`)."""
    omega_scale: OmegaScale
    """The scale of relative errors of ω: a static function, or one that can be hashed. If missing,
    the largest component (`_common.omega_scale_of`)."""
    error_scale: ErrorScale
    """The scale of relative errors of the components of a state; if missing, from ω at that state
    (`_common.error_scale_of`)."""
