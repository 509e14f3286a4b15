"""Derivatives of the residual rotation, and of the time to reach it, by the body and the start."""

import math
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .. import radiation
from .._base.checks import (
    ArrayLike,
    NumberLike,
    check_body,
    check_single,
    check_verdict,
    or_nan,
    real,
    where_valid,
)
from .._base.compiling import compiled_soon
from .._base.dependence import dependence
from .._base.forward_mode import forward_differentiable
from .._base.integration import integrated
from .._base.linalg import dot, length, scale
from .._base.tolerances import MAX_STEPS, TANGENT_SLACK_ALONE, Tolerances, budget, step_tolerances
from .._base.types import Equation, State
from .._branch.march import crossing
from .._engines.step_sizes import Controller, ending_at_jumps
from ..equations._common import error_scale_of, is_full, omega_scale_of, physical
from ..equations._verdicts.nonsmooth import infinity
from ..equations.tangent import Tangent
from .classification import UNCHECKED, Value
from .classify import classify_with_tangents
from .conditioning import is_larger_than_its_error


def residual_rotation(
    equation: Equation,
    omega0: ArrayLike,
    *,
    rtol: NumberLike = 1e-10,
    atol: NumberLike | None = None,
    max_steps: int | np.integer = MAX_STEPS,
) -> Float[Array, ""]:
    """Compute ω∞ = lim n·ω(τ), the residual rotation of dω/dτ = equation(ω) from ω(0) = ω₀.

    May be jitted, vmapped, and differentiated with respect to the arrays of the equation and to
    ω₀: in forward and reverse mode, and repeatedly, with a memory that does not grow with the run.
    ω∞ is constant along a trajectory, so its derivative follows from the local formula ω∞(p, y) at
    the end of the run and from the first variations there. The run continues until the derivatives
    of this formula are certain, so that they equal the derivatives of the limit.

    | case | derivatives |
    |---|---|
    | the top and all its neighbours stop | 0 |
    | undecided, failed, or the estimated error of ω∞ exceeds ω∞ | NaN |
    | a stop so near to a boundary that it is uncertain within the tolerances | NaN |
    | on an axis of decaying spin, which is a boundary, other than axis 3 | NaN |
    | along a change that turns the dipole off its principal axis | infinite |
    | δ = 0 (a body: equal moments across the dipole), along changes of δ, if ω₁ = 0 | infinite |
    | order 1 with ω₃ = 0, along changes of ω₃, if ω₁ = 0 or δ ≤ −1/2 | infinite |

    Derivatives are infinite where ω∞ has a jump or a kink: in the first case all residual rotation
    ends, in the others ω₁ is no longer constant. Infinity is a number such as 1e302, since its
    product with 0 is 0. Partial derivatives are taken component by component: they are infinite
    even where a combined change, such as a rotation of the whole body, would keep the dipole on its
    principal axis. If the dipole lies there only to rounding, as in a body with oblique axes,
    derivatives hold along changes that keep it there. A `sweep` knows the change, and distinguishes
    these cases. A change of one element of an inertia tensor breaks its symmetry; only derivatives
    along symmetric changes have a meaning.

    Args:
        equation: an equation with a `verdict`.
        omega0: start ω₀, shape (3,), dimensionless, body axes.
        rtol: relative tolerance of every step. The errors of ω∞ and of its derivatives are larger
            where these change fast with ω₀; errors of second derivatives are about rtol^(4/5).
        atol: absolute tolerance of every step; None means 0, since errors are measured by the
            present |ω|.
        max_steps: largest number of steps; a run that needs more is undecided.

    Returns:
        ω∞ in units of 1/τ₀, signed, along the dipole: 0 for a stop; NaN if the run failed or is
        undecided, or if the estimated error exceeds ω∞.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import jax, dipoletop as dt
        >>> omega0 = dt.cylindrical(0.2, 0.2, jax.numpy.pi / 30)
        >>> slope = jax.grad(lambda d: dt.residual_rotation(dt.TransverseReduced(d), omega0))(-0.2)
        >>> f"{slope:.8f}"
        '2.01941471'
    """
    equation, start, tolerances = _checked(equation, omega0, rtol, atol)
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten((arrays, start))
    return _with_gradient(_Runs(rest, structure, budget("max_steps", max_steps)))(
        leaves, tolerances
    )


def _checked(equation: Any, omega0: Any, rtol: Any, atol: Any) -> tuple[Any, Array, Tolerances]:
    """Return the equation to integrate, ω₀ and the tolerances."""
    check_verdict(equation)
    check_single(equation)
    start = real("omega0", omega0, (3,), batch=False)
    return physical(equation), start, step_tolerances(rtol, atol, start)


class _Runs(eqx.Module):
    """Runs of one equation as functions of the numbers in its arrays and in ω₀."""

    rest: Any
    """The equation without its arrays."""
    structure: Any = eqx.field(static=True)
    """The structure of the arrays of the equation and ω₀."""
    max_steps: int

    def omega_inf(self, leaves: list[Array], tolerances: Tolerances) -> Float[Array, ""]:
        """Return ω∞; NaN if its estimated error exceeds it."""
        arrays, start = jax.tree.unflatten(self.structure, leaves)
        equation = eqx.combine(arrays, self.rest)
        return self._classified(equation, start, tolerances, True).omega_inf

    @compiled_soon
    def omega_inf_and_slopes(
        self, x: Float[Array, "n"], leaves_of: "_Leaves", tolerances: Tolerances
    ) -> Float[Array, "1+n"]:
        """Return ω∞, and its derivatives by the varying numbers x."""
        arrays, start = jax.tree.unflatten(self.structure, leaves_of(x))
        _, push = jax.linearize(leaves_of, x)
        parameters, starts = jax.tree.unflatten(self.structure, jax.vmap(push)(jnp.eye(x.size)))
        variations = eqx.combine(arrays, self.rest), parameters, starts, length(start)
        (varies,) = dependence(push, x)  # of ω₀, too, the last leaf
        options = {"tangent_slack": TANGENT_SLACK_ALONE, "varying": (varies[:-1],) * x.size}
        equation = Tangent(*variations, basis=True, **options)
        run = self._classified(equation, start, tolerances, UNCHECKED)
        slopes = jnp.where(jnp.isinf(run.slopes), _infinities(x), run.slopes)
        by_start = run.slopes[-3:]  # the last varying numbers are always ω₀
        gradient = jnp.where(jnp.isinf(by_start), 0.0, by_start) * omega_scale_of(equation)(start)
        known = is_larger_than_its_error(run, length(gradient), tolerances)
        return or_nan(jnp.append(run.omega_inf, slopes), known)

    def _classified(self, equation: Any, start: Array, tolerances: Tolerances, value: Value) -> Any:
        """Return a `Classification` in arrays of JAX."""
        rtol, atol = tolerances
        return classify_with_tangents(
            equation, start, rtol=rtol, atol=atol, max_steps=self.max_steps, value=value
        )


def _infinities(x: Float[Array, "n"]) -> Float[Array, "n"]:
    """Return large numbers in place of infinity, one for each variable.

    They and their derivatives are unequal, so that infinite contributions of several variables
    cannot cancel to a sum that looks finite.
    """
    unequal = 2 + jnp.cos(jnp.arange(1.0, 1 + x.size, dtype=x.dtype))
    return infinity(x.dtype) * (unequal + jnp.sum(x - jax.lax.stop_gradient(x)))


def _with_gradient(runs: _Runs) -> Callable[..., Float[Array, ""]]:
    """Return the function `runs.omega_inf`, with derivatives from `runs.omega_inf_and_slopes`.

    The vector x of the latter holds the leaves that vary, and always the last leaf, ω₀.
    """
    wrapped = jax.custom_jvp(runs.omega_inf)

    def rule(primals: Any, tangents: Any) -> Any:
        (leaves, tolerances), (changes, _) = primals, tangents
        leaves = [jnp.asarray(leaf) for leaf in leaves]  # some are literal numbers
        fixed = [isinstance(change, SymbolicZero) for change in changes]
        varies = [not still for still in fixed[:-1]] + [True]
        along = [
            jnp.zeros_like(leaf) if still else change
            for leaf, change, still in zip(leaves, changes, fixed, strict=True)
        ]
        varying, others = eqx.partition(leaves, varies)
        leaves_of = _Leaves(tuple(None if x is None else x.shape for x in varying), others)

        def values(x: Float[Array, "n"], constants: Any) -> Float[Array, "1+n"]:
            return runs.omega_inf_and_slopes(x, *constants)

        found = forward_differentiable(values)(_raveled(varying), (leaves_of, tolerances))
        return _value_and_change(found, _raveled(eqx.filter(along, varies)))

    wrapped.defjvp(rule, symbolic_zeros=True)
    return wrapped


@eqx.filter_jit
def _raveled(leaves: list[Array | None]) -> Float[Array, "n"]:
    """Return all numbers of the leaves in one vector."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in leaves if leaf is not None])


@eqx.filter_jit
def _value_and_change(found: Float[Array, "m"], change: Float[Array, "n"]) -> Any:
    """Return ω∞ and its derivative along a change, from ω∞ and its partial derivatives."""
    return found[0], found[1:] @ change


class _Leaves(eqx.Module):
    """The function from the vector of varying numbers to all leaves."""

    shapes: tuple[tuple[int, ...] | None, ...] = eqx.field(static=True)
    """The shapes of the leaves that vary; None for the others."""
    others: list[Any]

    def __call__(self, x: Float[Array, "n"]) -> list[Array]:
        leaves, first = [], 0
        for shape, other in zip(self.shapes, self.others, strict=True):
            if shape is not None:
                size = math.prod(shape)
                leaves.append(x[first : first + size].reshape(shape))
                first += size
            else:
                leaves.append(other)
        return leaves


def decay_time(
    equation: Equation,
    omega0: ArrayLike,
    share: NumberLike = 0.5,
    *,
    rtol: NumberLike = 1e-10,
    atol: NumberLike | None = None,
    max_steps: int | np.integer = MAX_STEPS,
) -> Float[Array, ""]:
    """Return τ at which a top has lost a share of the energy that it will ever lose.

    E(τ) = E₀ − share (E₀ − E∞), E = ½ ω·Iω, E∞ = ½ (n·In) ω∞², for the first time. May be jitted,
    vmapped, and differentiated as `residual_rotation` (up to second order).

    Args:
        equation: an equation with a `verdict` and a `body`; a full one is followed along its
            physical branch.
        omega0: start ω₀, shape (3,), dimensionless, body axes.
        share: between 0 and 1, both excluded.
        rtol: relative tolerance of every step.
        atol: absolute tolerance of every step; None means 0, since errors are measured by the
            present |ω|.
        max_steps: largest number of steps; a run that needs more is undecided.

    Returns:
        τ in units of τ₀; NaN, as are its derivatives, where ω∞ is not known, and if the top has
        no energy to lose.

    Raises:
        ValueError: bad arguments.

    Example:
        Spin about axis 2 obeys (2.4): E falls to one half when 1 + 2ω₀²τ = 2.

        >>> import dipoletop as dt
        >>> f"{dt.decay_time(dt.TransverseReduced(0.3), [0.0, 0.5, 0.0]):.8f}"
        '2.00000000'
    """
    equation, start, tolerances = _checked(equation, omega0, rtol, atol)
    check_body(equation)
    part = real("share", share, batch=False)
    part = where_valid("share", part, (part > 0) & (part < 1), "lie between 0 and 1")
    steps = budget("max_steps", max_steps)
    rtol, atol = tolerances
    omega_inf = residual_rotation(equation, start, rtol=rtol, atol=atol, max_steps=steps)
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    variables, unravel = ravel_pytree((arrays, start, omega_inf, part))

    def time(variables: Float[Array, "n"], tolerances: Tolerances) -> Float[Array, ""]:
        arrays, start, omega_inf, part = unravel(variables)
        varied = eqx.combine(arrays, rest)
        return _time_of_energy(varied, start, (omega_inf, part), tolerances, steps)

    return forward_differentiable(time)(variables, tolerances)


@compiled_soon
def _time_of_energy(
    equation: Any, start: Array, target: tuple[Array, Array], tolerances: Tolerances, max_steps: int
) -> Float[Array, ""]:
    """Compute τ at which the energy has fallen far enough, target = (ω∞, share)."""
    omega_inf, share = target
    dipole = equation.body.dipole
    residual_omega = scale(omega_inf / jnp.sqrt(dot(dipole, dipole)), dipole)

    def energy(y: State) -> Array:
        return radiation.kinetic_energy(equation.body, equation.omega(y))

    y0 = equation.lift(start)
    first, last = energy(y0), radiation.kinetic_energy(equation.body, residual_omega)
    level = first - share * (first - last)
    falls = (first > last) & jnp.isfinite(omega_inf) & jnp.isfinite(share)
    if is_full(equation):
        windows = jnp.where(falls, max_steps, 0)
        return crossing(equation, start, lambda y: energy(y) - level, tolerances.rtol, windows)
    below = diffrax.Event(lambda t, y, args, **_: energy(y) <= level)
    t1 = jnp.where(falls, jnp.inf, 0.0)
    sizes = error_scale_of(equation)
    controller = ending_at_jumps(Controller(*tolerances, sizes), equation)
    run = integrated(equation, (0.0, t1), y0, controller, max_steps, event=below)
    end, late = run.ys[-1], run.ts[-1]

    # Integrate back from the end of that step to the level, with the energy as the independent
    # variable: s from 0 to 1 is the fraction of the way, and the last component is the time over
    # `late`, whose error is then relative.
    def by_energy(s: Any, y: Array, args: Any) -> Array:
        rate = equation(late * y[-1], y[:-1], None)
        power = jax.jvp(energy, (y[:-1],), (rate,))[1]
        return jnp.append(rate, 1 / late) * (level - energy(end)) / power

    with_time = Partial(lambda sizes, y: jnp.append(sizes(y[:-1]), 1.0), sizes)
    controller = Controller(*tolerances, with_time)
    span = 0.0, jnp.where(falls, 1.0, 0.0)
    back = integrated(by_energy, span, jnp.append(end, 1.0), controller, max_steps)
    found = falls & diffrax.is_successful(back.result)
    return jnp.where(found, late * back.ys[-1, -1], jnp.nan * first)  # no derivative, either
