"""Noise turn by turn: paths of a reduced equation in a bath."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.attitudes import normalised, quaternion_rate, unit_quaternion
from .._base.checks import NumberLike, check_body, check_equation, instance, positive
from .._base.compiling import compiled_soon
from .._base.linalg import matvec
from .._base.refusals import refuse
from .._base.shown import Shown
from .._base.types import Equation, State
from ..equations._common import follows_attitude, is_full
from ..equations.torque_driven import Driven
from .bath import Bath, Kicks
from .ensembles import Ensemble
from .paths import follow, kicked, schedule, starts_of, times

ANGLE = 0.1
"""The angle by which the fastest rotation turns in a step, by default."""
FASTEST = 4.0  # times the thermal speed about the axis of the smallest moment


class Noisy(Shown):
    """A reduced equation in a bath; see `with_noise`."""

    equation: Equation
    bath: Bath
    is_noisy = True


def with_noise(equation: Equation, bath: Bath) -> Noisy:
    """Return an equation with the friction and the noise of a bath, for `ensemble`.

        Iω̇ = …equation… − γω + noise,

    with the noise of `noise.bath`. The equilibrium of the radiation torque with its noise is exact
    to first order in τ₀ω, of which the equation is an expansion; that of a gas is exact.

    Args:
        equation: a reduced or the semi-reduced equation of a body; also with torques.
        bath: the bath. Its drag comes in addition to torques of the equation.

    Raises:
        ValueError: a full equation, or one without a body; another `bath`.
    """
    check_equation(equation)
    instance("bath", bath, Bath)
    check_body(equation)
    if is_full(equation):
        refuse("equation", "be a reduced or the semi-reduced one", "is a full one")
    return Noisy(equation, bath)


class _Turning(eqx.Module):
    """A step of an equation and of the forces of its bath; ω, and an attitude behind it."""

    equation: Any
    kicks: Kicks
    has_attitude: bool = eqx.field(static=True)
    """Whether an attitude follows the state of the equation."""

    @property
    def draws(self) -> int:
        """The number of random numbers of a step."""
        return self.kicks.draws

    def __call__(self, t: Any, y: State, h: Any, z: Float[Array, "d *#lanes"]) -> State:
        """Return the state at t + h."""
        equation = self.equation
        if isinstance(equation, Driven):  # a torque is a function of one top
            equation = _in_lanes(equation, y.shape[1:])

        def change(y: State, t: Any) -> State:
            inner = y[:-4] if self.has_attitude else y
            rate = h * equation(jnp.broadcast_to(t, y.shape[1:]), inner, None)
            momentum = matvec(self.kicks.inertia, inner[:3])
            thermal = self.kicks.thermal(momentum, h, z)
            parts = [rate[:3] + matvec(self.kicks.inverse, thermal), rate[3:]]
            if self.has_attitude:
                parts.append(h * quaternion_rate(y[-4:], y[:3]))
            return jnp.concatenate(parts)

        y = kicked(change, y, t, h)
        if y.shape[0] >= 7:
            y = jnp.concatenate([y[:-4], normalised(y[-4:])])
        return y


def ensemble(
    noisy: Noisy,
    omega0: Any,
    ts: Any,
    *,
    n: int = 1000,
    seed: int = 0,
    step: NumberLike | None = None,
    attitude: Any = None,
) -> Ensemble:
    """Integrate n paths of an equation with noise, on all cores.

    Args:
        noisy: the equation, a result of `with_noise`.
        omega0: ω₀ of all paths, shape (3,), or of each, shape (n, 3).
        ts: the times τ to save, ascending, at least two; paths begin at the first one.
        n: the number of paths.
        seed: seed of the noise; path i depends on (seed, i) only, not on n.
        step: the longest step; None means a turn by 0.1 of the fastest rotation, and a tenth of the
            time of the drag. It does not know of torques of the equation, such as a field. Steps
            end at the times to save.
        attitude: the attitude of all paths at the start, a unit quaternion, shape (4,); None does
            not follow it, unless the equation does.

    Returns:
        An `Ensemble`.

    Raises:
        ValueError: bad arguments; a path that needs more than five million steps
            (`averaged_ensemble` follows those).

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> body = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.9]], [0.1, 0.1, 0.0])
        >>> bath = dt.noise.Bath(heat=1.0, drag=0.5)
        >>> noisy = dt.noise.with_noise(dt.Reduced(body, order=1), bath)
        >>> found = dt.noise.ensemble(noisy, [0.0, 0.0, 0.0], [0.0, 10.0], n=2000)
        >>> energy, error = found.mean(found.energy[:, -1])
        >>> bool(abs(energy - 1.5) < 4 * error)  # 3kT/2
        True
    """
    instance("noisy", noisy, Noisy, "be an equation with noise (`noise.with_noise` makes it)")
    equation: Any = noisy.equation
    body = check_body(equation)
    given, kicks = times(ts), _kicks(body, noisy.bath, noisy.bath.acting)
    starts = jnp.asarray(starts_of(omega0, n))
    if step is None:
        moments = np.linalg.eigvalsh(np.asarray(body.inertia))
        thermal = FASTEST * np.sqrt(float(noisy.bath.highest) / moments[0])
        fastest = max(float(np.max(np.linalg.norm(np.asarray(starts), axis=0))), thermal)
        spread = moments[2] / moments[0]  # the precession is faster than the rotation
        braking = float(np.max(np.linalg.eigvalsh(np.asarray(noisy.bath.drag)))) / moments[0]
        rate = max(fastest * max(spread - 1, 1.0), braking, float(np.finfo(float).tiny))
        step = ANGLE / rate
    longest = float(positive("step", step, batch=False))
    first = None if attitude is None else unit_quaternion("attitude", attitude)
    if follows_attitude(equation):
        if first is not None:
            refuse("attitude", "be None, as the equation has one", "is given")
        first = equation.start
    if first is not None:
        lanes = jnp.broadcast_to(first[:, None], (4, starts.shape[1]))
        starts = jnp.concatenate([starts, lanes])
    turning = _Turning(equation, kicks, attitude is not None)
    found = follow(turning, starts, schedule(given, lambda t: longest), seed)
    return Ensemble(given, found[..., :3], None if first is None else found[..., 3:], body)


_kicks = compiled_soon(Kicks)


def _in_lanes(equation: Any, lanes: tuple[int, ...]) -> Any:
    """Return an equation whose arrays have lanes behind."""
    arrays, rest = eqx.partition(equation, eqx.is_array)
    wide = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, *lanes)), arrays)
    return eqx.combine(wide, rest)
