"""The rate of ω on the physical branch of a full equation, at one angular velocity."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._base.checks import check_single, finite, or_nan
from .._base.compiling import compiled_soon
from .._base.forward_mode import forward_differentiable
from .._base.refusals import refuse
from .._base.tolerances import tolerance
from ..equations._common import is_full, physical, rate_of_omega
from .march import EFOLDS, PREVIOUS_ELEMENT, depends_on_time, start_march
from .window import solve_window


def slow_manifold(
    equation: Any, omega: Any, *, time: Any = 0.0, rtol: Any = None, with_error: bool = False
) -> Any:
    """Return Ω̇ on the physical branch of a full equation at the angular velocity Ω.

    The motion from Ω on is solved for as a boundary-value problem over several e-foldings of a
    runaway (see `_branch.window`). May be jitted, vmapped and differentiated, in forward and in
    reverse mode.

    Args:
        equation: a full equation, such as `TransverseFull` or `Full`.
        omega: Ω, shape (3,), dimensionless, body axes. A torque that depends on the attitude is
            evaluated at the initial attitude of the equation.
        time: τ, for a torque that depends on it.
        rtol: the accuracy wanted, relative to the largest component of Ω̇; None means the best
            possible. A looser tolerance needs a shorter window and converges up to larger |Ω|.
        with_error: also return an estimate of the error.

    Returns:
        Ω̇, shape (3,); NaN where no branch was found, or not to `rtol`. With `with_error` a pair
        of Ω̇ and the estimated largest error of its components.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> start = dt.cylindrical(w_perp=0.2, w3=0.2, phi=jnp.pi / 30)
        >>> rate = dt.slow_manifold(dt.TransverseFull(-0.2), start)
        >>> [f"{x:.8f}" for x in rate.tolist()]
        ['-0.00083623', '0.00913023', '-0.00967855']
    """
    if not is_full(equation):
        refuse("equation", "be a full equation", f"is {type(equation).__name__}")
    check_single(equation)
    start, now = finite("omega", omega, (3,), batch=False), finite("time", time, batch=False)
    wanted = jnp.asarray(jnp.inf) if rtol is None else tolerance("rtol", rtol)
    if physical(equation) is not equation:
        rate, error = _known_branch(equation, start, now, wanted)
        return (rate, error) if with_error else rate
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    varies = now if depends_on_time(equation) else None
    x, unravel = ravel_pytree((arrays, start, varies))

    def rate_and_error(x: Array, settings: Any) -> Array:
        (arrays, omega, varies), (wanted, fixed) = unravel(x), settings
        time = fixed if varies is None else varies
        return jnp.append(*_by_window(eqx.combine(arrays, rest), omega, time, wanted))

    result = forward_differentiable(rate_and_error)(x, (wanted, now))
    return (result[:3], result[3]) if with_error else result[:3]


def _known_branch(
    equation: Any, omega: Float[Array, "3"], time: Float[Array, ""], wanted: Float[Array, ""]
) -> tuple[Array, Array]:
    """Return Ω̇ and its error where the branch is known in closed form."""
    branch = physical(equation)
    y = branch.lift(omega)
    rate = rate_of_omega(branch, time, y)
    error = 10 * jnp.finfo(omega.dtype).eps * jnp.max(jnp.abs(rate))
    return or_nan(rate, error <= wanted * jnp.max(jnp.abs(rate))), error


@compiled_soon
def _by_window(
    equation: Any, omega: Float[Array, "3"], time: Float[Array, ""], wanted: Float[Array, ""]
) -> tuple[Array, Array]:
    """Return Ω̇ and its error at the left end of a window."""
    # The error at the far end may be as large as Ω̇ itself; it must decay below the wanted one.
    efolds = jnp.where(wanted < 1, jnp.clip(4 - jnp.log(wanted), 8.0, EFOLDS), EFOLDS)
    begun, runaway = start_march(equation, omega, time), equation.runaway_rate
    runaway = jax.lax.stop_gradient(runaway)  # only the length of the window depends on it
    window = solve_window(equation, begun.time, begun.slow, efolds / runaway)
    rate = rate_of_omega(equation, begun.time, window.states[0, 0])
    size = jnp.max(jnp.abs(rate))
    # Three errors: the rest of the error at the far end; the truncation of every element, as a
    # rate, which affects the elements before it little; and rounding.
    far = window.first_error
    lengths = window.mesh.times[:, -1] - window.mesh.times[:, 0]
    passed_on = PREVIOUS_ELEMENT ** -jnp.arange(lengths.shape[0], dtype=lengths.dtype)
    decayed = jnp.exp(-runaway * window.mesh.times[:, 0])
    truncations = window.truncation * window.sizes * jnp.minimum(passed_on, decayed) / lengths
    truncation = jnp.max(truncations)
    error = 3 * far + 10 * (truncation + jnp.finfo(omega.dtype).eps * size)
    good = window.converged & ((error <= wanted * size) | (wanted >= 1))
    return or_nan(rate, good), or_nan(error, window.converged)
