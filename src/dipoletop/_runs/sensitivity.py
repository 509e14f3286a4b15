"""How the residual rotation, and the time to reach it, move with the body and with the start."""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .. import radiation
from .._base.checks import check_body, check_single, check_verdict, or_nan, real, where_valid
from .._base.forward_mode import forward_differentiable
from .._base.linalg import dot, length, scale
from .._base.tolerances import MAX_STEPS, absolute, budget, tolerance
from .._base.types import Equation
from .._branch import march as manifold
from .._engines.step_sizes import Controller
from ..equations._common import Sizes, scales_of, sizes_of
from ..equations._verdicts.nonsmooth import infinity
from ..equations.tangent import Together
from .classify_many import UNCHECKED, Value, classified
from .conditioning import is_known


def residual_rotation(
    equation: Equation,
    omega0: Any,
    *,
    rtol: Any = 1e-10,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
) -> Float[Array, ""]:
    """ω∞ = lim n·ω(τ), the residual rotation of dω/dτ = equation(ω) from ω(0) = ω₀.

    May be jitted, vmapped, and differentiated with respect to the arrays of the equation and to
    ω₀: forwards, backwards and again, at a memory that does not grow with the run. ω∞ is constant
    along a trajectory, so its derivative is that of the local formula ω∞(p, y) at the end of the
    run, carried there by the first variations; the run goes on until this formula's derivatives
    are certain, so that they are those of the limit, not of the moment of stopping.

    Args:
        equation: an equation with a `verdict`.
        omega0: start ω₀, shape (3,), dimensionless, body axes.
        rtol: relative tolerance of every step. The errors of ω∞ and of its derivatives are larger
            where these change fast with ω₀; those of second ones are rtol^(4/5) or so.
        atol: absolute tolerance; None means none, since errors are measured by the present |ω|.
        max_steps: budget.

    Returns:
        ω∞ in units of 1/τ₀, signed, along the dipole: 0 for a stop; NaN if the run failed or is
        undecided, or if the estimated error exceeds ω∞. Derivatives are 0 where the top stops as
        all its neighbours do, and NaN where there are none: of what is undecided or failed, so near
        to a boundary that a stop is not
        sure within the tolerances, and on an axis of decaying spin (a boundary) but for axis 3. A
        derivative with respect to one element of an inertia tensor breaks its symmetry; only those
        along symmetric changes have a meaning. Derivatives are infinite (1e302, or the like, since
        that times 0 is 0) along changes that turn the dipole away from its principal axis, which
        ends all residual rotation, and along those from where ω₁ is constant to where it is not,
        if ω∞ has a jump or a kink there: δ = 0 (of a body: equal moments across the dipole) with
        ω₁ = 0, and at order 1 ω₃ = 0 with ω₁ = 0 or δ ≤ −1/2. Each number of the body is taken
        alone: so also along changes that only together keep the dipole on its axis, as turning
        all does. But if it lies there but for rounding, as in a body that lies askew, derivatives
        hold along changes that keep it there. A `sweep`, which knows the change, tells them apart.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import jax, dipoletop as dt
        >>> omega0 = dt.cylindrical(0.2, 0.2, jax.numpy.pi / 30)
        >>> slope = jax.grad(lambda d: dt.residual_rotation(dt.TransverseReduced(d), omega0))(-0.2)
        >>> f"{slope:.8f}"
        '2.01941471'
    """
    check_verdict(equation)
    check_single(equation)
    equation = manifold.physical(equation)
    start = real("omega0", omega0, (3,), batch=False)
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten((arrays, start))
    rtol = tolerance("rtol", rtol)
    limits = rtol, absolute(atol, rtol, start)

    def ends(equation: Any, start: Any, limits: Any, value: Value) -> Any:
        rtol, atol = limits
        return classified(equation, start, rtol=rtol, atol=atol, max_steps=max_steps, value=value)

    def value(leaves: Any, limits: Any) -> Float[Array, ""]:
        arrays, start = jax.tree.unflatten(structure, leaves)
        return ends(eqx.combine(arrays, rest), start, limits, True).omega_inf

    def with_slopes(x: Float[Array, "n"], settings: Any) -> Float[Array, "1+n"]:
        back, limits = settings
        arrays, start = jax.tree.unflatten(structure, back(x))
        _, push = jax.linearize(back, x)
        parameters, starts = jax.tree.unflatten(structure, jax.vmap(push)(jnp.eye(x.size)))
        # Else +s in one and −s in another would leave a plausible number of what is infinite.
        irregular = 2 + jnp.cos(jnp.arange(1.0, 1 + x.size, dtype=x.dtype))  # independent numbers
        equation = Together(eqx.combine(arrays, rest), parameters, starts, length(start))
        found = ends(equation, start, limits, UNCHECKED)
        endless = infinity(x.dtype) * (irregular + jnp.sum(x - jax.lax.stop_gradient(x)))
        slopes = jnp.where(jnp.isinf(found.slopes), endless, found.slopes)
        by_start = found.slopes[-3:]  # the start is what varies last, always
        each = jnp.where(jnp.isinf(by_start), 0.0, by_start) * scales_of(equation)(start)
        return or_nan(jnp.append(found.omega_inf, slopes), is_known(found, length(each), limits))

    return _with_gradient(value, with_slopes)(leaves, limits)


def _with_gradient(value: Callable[..., Array], with_slopes: Callable[..., Array]) -> Any:
    """`value(leaves, settings)`, differentiated by `with_slopes(x, (back, settings))`.

    There x holds the leaves that vary, and the last one in any case; back(x) is all leaves. The
    value comes first.
    """

    @jax.custom_jvp
    def wrapped(leaves: Any, settings: Any) -> Array:
        return value(leaves, settings)

    def rule(primals: Any, tangents: Any) -> Any:
        (leaves, settings), (changes, _) = primals, tangents
        still = [isinstance(change, SymbolicZero) for change in changes]
        moving = [k for k in range(len(leaves)) if not still[k] or k == len(leaves) - 1]
        x, unravel = ravel_pytree([leaves[k] for k in moving])
        along = [jnp.zeros_like(leaves[k]) if still[k] else changes[k] for k in moving]
        change, _ = ravel_pytree(along)
        back = _Back(
            tuple(moving), unravel, [None if k in moving else leaf for k, leaf in enumerate(leaves)]
        )
        found, *slopes = forward_differentiable(with_slopes)(x, (back, settings))
        return found, jnp.stack(slopes) @ change

    wrapped.defjvp(rule, symbolic_zeros=True)
    return wrapped


class _Back(eqx.Module):
    """From the vector of what varies to all leaves."""

    moving: tuple[int, ...] = eqx.field(static=True)
    unravel: Callable[..., Any] = eqx.field(static=True)
    fixed: list[Any]

    def __call__(self, x: Float[Array, "n"]) -> list[Array]:
        leaves = list(self.fixed)
        for k, leaf in zip(self.moving, self.unravel(x), strict=True):
            leaves[k] = leaf
        return leaves


def decay_time(
    equation: Equation,
    omega0: Any,
    share: Any = 0.5,
    *,
    rtol: Any = 1e-10,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
) -> Float[Array, ""]:
    """τ at which a top has lost a share of the energy that it will ever lose.

    E(τ) = E₀ − share (E₀ − E∞), E = ½ ω·Iω, E∞ = ½ (n·In) ω∞², for the first time. May be jitted,
    vmapped, and differentiated as `residual_rotation` (up to second order).

    Args:
        equation: an equation with a `verdict` and a `body`; a full one is followed along its
            physical branch.
        omega0: start ω₀, shape (3,), dimensionless, body axes.
        share: between 0 and 1, both excluded.
        rtol: relative tolerance.
        atol: absolute tolerance; None means none, since errors are measured by the present |ω|.
        max_steps: budget.

    Returns:
        τ in units of τ₀; NaN, as are its derivatives, where ω∞ is not known, and if the top has
        nothing to lose.

    Raises:
        ValueError: bad arguments.

    Example:
        Spin about axis 2 obeys (2.4): E falls to one half when 1 + 2ω₀²τ = 2.

        >>> import dipoletop as dt
        >>> f"{dt.decay_time(dt.TransverseReduced(0.3), [0.0, 0.5, 0.0]):.8f}"
        '2.00000000'
    """
    check_verdict(equation)
    check_single(equation)
    check_body(equation)
    equation = manifold.physical(equation)
    start = real("omega0", omega0, (3,), batch=False)
    part = real("share", share, batch=False)
    part = where_valid("share", part, (part > 0) & (part < 1), "lie between 0 and 1")
    rtol = tolerance("rtol", rtol)
    limits = rtol, absolute(atol, rtol, start)
    steps = budget("max_steps", max_steps)
    inf = residual_rotation(equation, start, rtol=rtol, atol=limits[1], max_steps=steps)
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    x, back = ravel_pytree((arrays, start, inf, part))

    def time(x: Float[Array, "n"], limits: Any) -> Float[Array, ""]:
        arrays, start, inf, part = back(x)
        return _time_of_energy(eqx.combine(arrays, rest), start, (inf, part), (*limits, steps))

    return forward_differentiable(time)(x, limits)


@eqx.filter_jit
def _time_of_energy(equation: Any, start: Array, wanted: Any, limits: Any) -> Float[Array, ""]:
    """τ at which the energy has fallen far enough, wanted = (ω∞, share)."""
    inf, share = wanted
    dipole = equation.body.dipole
    along = scale(inf / jnp.sqrt(dot(dipole, dipole)), dipole)

    def energy(y: Array) -> Array:
        return radiation.kinetic_energy(equation.body, equation.omega(y))

    y0 = equation.lift(start)
    first, last = energy(y0), radiation.kinetic_energy(equation.body, along)
    level = first - share * (first - last)
    falls = (first > last) & jnp.isfinite(inf)
    if manifold.is_full(equation):
        rtol, _, windows = limits
        windows = jnp.where(falls, windows, 0)
        return manifold.crossing(equation, start, lambda y: energy(y) - level, rtol, windows)
    below = diffrax.Event(lambda t, y, args, **_: energy(y) <= level)
    until = jnp.where(falls, jnp.inf, 0.0)
    size = sizes_of(equation)
    step = _solve(equation, until, y0, limits, size, event=below)

    # Back from the end of that step to the level, with the energy as the independent variable.
    def field(s: Any, y: Array, args: Any) -> Array:
        rate = equation(0.0, y[:-1], None)
        power = jax.jvp(energy, (y[:-1],), (rate,))[1]
        # The last component is the time in units of the first guess, whose error is relative.
        return jnp.append(rate, 1 / late) * (level - energy(end)) / power

    end, late = step.ys[-1], step.ts[-1]
    sizes = Partial(lambda size, y: jnp.append(size(y[:-1]), 1.0), size)
    found = _solve(field, 1.0, jnp.append(end, 1.0), limits, sizes)
    good = falls & diffrax.is_successful(found.result)
    return jnp.where(good, late * found.ys[-1, -1], jnp.nan * first)  # no derivative, either


def _solve(field: Any, t1: Any, y0: Array, limits: Any, sizes: Sizes, event: Any = None) -> Any:
    """An integration from 0 to t1 that can be differentiated forwards."""
    rtol, atol, max_steps = limits
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        0.0,
        t1,
        None,
        y0,
        stepsize_controller=Controller(rtol, atol, sizes),
        event=event,
        max_steps=max_steps,
        adjoint=diffrax.ForwardMode(),
        throw=False,
    )
