"""A window: a stretch of physical motion of a full equation, as a boundary-value problem.

A full equation has a state (ω, a) whose fast part a runs away from the physical branch: near the
branch a = A(ω) a distance δa = a − A(ω) obeys δa′ ≈ λ δa, λ > 0 being the runaway rate. It grows
as e^{λτ} forwards in time, so an initial-value problem is ill posed; and it decays as fast
backwards. Therefore ω is given at the left end and a at the right end T. This problem has a
dichotomy, and so is well posed (Ascher, Mattheij, Russell, *Numerical Solution of Boundary Value
Problems for Ordinary Differential Equations*, SIAM 1995).

At T the value of a comes from the asymptotic series of A(ω), with an error ε that is not small. At
an earlier τ about ε e^{−λ(T − τ)} of it is left. To bring it below a tolerance, T must lie
ln(ε/tolerance) runaway e-foldings past the part of the window that is kept: 36 of them for the
rounding error of float64. The rest of the error is not estimated by λ, which torques change, but by
the linear response of the window to a change of its end value.

The window is cut into elements, on each of which the state is a polynomial (Chebyshev collocation
in integral form):

    ω(τ) = ω(left) + ∫ω̇ dτ from the left,    a(τ) = a(right) − ∫ȧ dτ to the right.

An attitude on which a torque depends is slow, too: it follows ω in the state and is treated alike.

These equations are solved by Newton's method with damping. A step first eliminates the nodes of
each element, as functions of the values at its two ends, and then solves the small system for
these values (static condensation).
"""

import functools
import itertools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .. import radiation
from .._base.chebyshev import collocation_rule
from .._base.dense import solve_dense
from ..equations._common import elements_of, jumps_of
from ..equations.rigid import free_rotation
from .mesh import NODES, Mesh, mesh_of

ITERATIONS = 20  # largest number of steps of Newton's method
LEAST_DAMPING = 0.02  # below, a step is accepted even if the residual does not fall
CONVERGED = 1e-10  # relative size of a last step, after which the error is far smaller
NEGLIGIBLE = 1e-15  # relative size of the following step that also shows convergence, at least
REMAINDER = 1e-3  # size of that following step over the tolerance
REVISED = 4  # iterations in which the correction of the end value follows the states
FALLING = 0.03  # largest ratio of one step to the one before if convergence is quadratic
SUBSTEPS = 2  # substeps of the initial guess between two nodes


class Window(NamedTuple):
    """The physical motion from ω₀ on, on elements of NODES nodes each."""

    span: Float[Array, ""]
    """The length of the window."""
    sizes: Float[Array, "E"]
    """The largest component of ω in each element, to which its errors are compared.

    A torque may change ω by orders of magnitude within a window."""
    mesh: Mesh
    states: Float[Array, "E K n"]
    converged: Bool[Array, ""]
    iterations: Int[Array, ""]
    truncation: Float[Array, "E"]
    """The truncation error of each element over its size, by the last coefficients of ω, ∫a dτ."""
    end_error: Float[Array, "E"]
    """The error of the slow part of each element over its size that the end value causes."""
    first_error: Float[Array, ""]
    """The error of the fast part at the left end that the end value causes."""
    retained: Float[Array, ""]
    """The part of a change of the fast part at the far end that remains at the left end."""


def solve_window(
    equation: Any, time: Any, slow0: Float[Array, "m"], span: Any, rtol: Any = 0.0
) -> Window:
    """Return the physical motion of a full equation over a time `span` from a slow state on.

    Args:
        equation: a full equation, with the levels that approach its branch (`FullEquation`).
        time: τ at the left end.
        slow0: the slow part of the state there; it begins with ω.
        span: length, several runaway e-foldings longer than the part that will be kept.
        rtol: the relative error that is allowed; the error of Newton's method is far smaller.
    """
    dtype, omega0 = slow0.dtype, slow0[:3]
    transform = jnp.asarray(collocation_rule(NODES).coefficients, dtype)

    # Braking halves ω in a time ~ 1/rate; the nodes follow ln(1 + 2 rate τ). A torque that
    # accelerates ω where it is small does not count as braking.
    omega_dot, _ = free_rotation(equation.body, omega0)
    energy = radiation.kinetic_energy(equation.body, omega0)
    power = radiation.radiated_power(equation.body, omega0, omega_dot)
    rate = power / (2 * jnp.where(energy > 0, energy, 1.0))
    bend = jnp.maximum(jnp.log1p(2 * rate * span), 1e-3)
    mesh = mesh_of(time, span, bend, elements_of(equation), jumps_of(equation))
    tau, forward = mesh.tau, mesh.weights
    backward = forward[:, -1:] - forward

    field = functools.partial(_damped_rate, equation.semi)
    slow = _guess(field, time, slow0, mesh.times)
    fast = jax.vmap(jax.vmap(lambda t, s: equation.fast(field(t, s)[:3])))(tau, slow)
    guess = jnp.concatenate([slow, fast], axis=-1)
    negligible = jnp.maximum(jnp.asarray(REMAINDER * rtol, dtype), NEGLIGIBLE)
    parts = equation, tau, slow0, forward, backward, _sizes(slow), negligible
    states, converged, iterations, end = _solution(_Problem(*parts), guess)
    coefficients = jnp.einsum("kj,ejn->ekn", transform, states, precision="highest")
    last = jnp.max(jnp.abs(coefficients[:, -2:]), axis=1)
    m = slow0.shape[0]
    last = jnp.concatenate([last[:, :m], mesh.lengths[:, None] * last[:, m:]], axis=-1)
    sizes = _sizes(states)
    scale = _scale(sizes, m, last.shape[-1])
    truncation = jnp.max(last / scale, axis=1)
    end_error = end.error * jnp.max(end.response[..., :m] / scale[:, None, :m], axis=(1, 2))
    first = jnp.max(end.response[0, 0, m:])
    outcome = converged, iterations, truncation, end_error, end.error * first, first
    return Window(span, sizes, mesh, states, *outcome)


def _sizes(states: Float[Array, "E K n"]) -> Float[Array, "E"]:
    """Return the largest component of ω in each element; 1 where it is 0."""
    sizes = jnp.max(jnp.abs(states[..., :3]), axis=(1, 2))
    return jax.lax.stop_gradient(jnp.where(sizes > 0, sizes, 1.0))


def _scale(sizes: Float[Array, "E"], m: int, n: int) -> Float[Array, "E n"]:
    """Return the scale of the errors of n components, m of them slow; 1 for an attitude."""
    sizes = jnp.broadcast_to(sizes[:, None], (sizes.shape[0], n))
    return sizes.at[:, 3:m].set(1.0)


class _End(NamedTuple):
    """The value of the fast part at the far end."""

    correction: Float[Array, "f"]
    """The difference of the value from the semi-reduced level."""
    error: Float[Array, ""]
    """The estimated error of the value."""
    response: Float[Array, "E K n"]
    """The response of the states to a change of the value by 1 in any direction."""


class _NewtonState(NamedTuple):
    """The state of Newton's method."""

    states: Float[Array, "E K n"]
    defect: Float[Array, ""]
    """The relative size of the residual at `states`."""
    step: Float[Array, "E K n"]
    """The full step, to be subtracted next."""
    before: Float[Array, ""]
    """The relative size of the step before it, if that was a full one; else 0."""
    damping: Float[Array, ""]
    """The factor of the step."""
    end: _End
    count: Int[Array, ""]

    def converged(self, problem: "_Problem") -> Bool[Array, ""]:
        """Return whether the error after the next step is negligible.

        That step is then small itself, or the one after it would be negligible: with quadratic
        convergence this is the cube of a step over the square of the one before.
        """
        change = problem.largest(self.step)
        falls = change < FALLING * self.before
        expected = change * (change / jnp.where(falls, self.before, 1.0)) ** 2
        return (change <= CONVERGED) | (falls & (expected <= problem.negligible))


class _Problem(NamedTuple):
    """The equations for the states at the nodes."""

    equation: Any
    times: Float[Array, "E K"]
    """τ at the nodes."""
    slow0: Float[Array, "m"]
    forward: Float[Array, "E K K"]
    backward: Float[Array, "E K K"]
    sizes: Float[Array, "E"]
    """The largest component of ω in each element of the initial guess."""
    negligible: Float[Array, ""]
    """The relative size of errors that Newton's method may leave."""

    def largest(self, states: Float[Array, "E K n"]) -> Float[Array, ""]:
        """Return the largest component, relative to the size of its element."""
        scale = _scale(self.sizes, self.slow0.shape[0], states.shape[-1])
        return jnp.max(jnp.abs(states) / scale[:, None])

    def end_value(self, slow: Array) -> tuple[Array, Array, Array]:
        """Return the fast part at the semi-reduced level, its correction, and the error."""
        levels = (self.equation.semi, self.equation.reduced(2), self.equation.reduced(3))
        rates = [self.equation.fast(level(self.times[-1, -1], slow)[:3]) for level in levels]
        early, late = (jnp.max(jnp.abs(b - a)) for a, b in itertools.pairwise(rates))
        correction = jnp.where(late < early, rates[2] - rates[0], 0.0)
        return rates[0], correction, jnp.minimum(early, late)

    def residual(self, states: Array, kept: Any = None) -> tuple[Array, tuple[Array, Array]]:
        """Return the defects of the two integral equations at every node.

        Also return the correction of the end value and its error. `kept`, a pair of a flag and a
        correction, may keep an earlier correction: then the end value has the slope that Newton's
        method assumes, and the error includes the change of the correction.
        """
        m = self.slow0.shape[0]
        rates = jax.vmap(jax.vmap(self.equation))(self.times, states)
        semi, correction, error = self.end_value(states[-1, -1, :m])
        if kept is not None:
            used = jnp.where(kept[0], kept[1], correction)
            error = jnp.maximum(error, jnp.max(jnp.abs(used - correction)))
            correction = used
        end = semi + correction
        left = jnp.concatenate([self.slow0[None], states[:-1, -1, :m]])
        right = jnp.concatenate([states[1:, 0, m:], end[None]])
        from_left = jnp.einsum("ejk,eki->eji", self.forward, rates[..., :m], precision="highest")
        to_right = jnp.einsum("ejk,eki->eji", self.backward, rates[..., m:], precision="highest")
        slow = states[..., :m] - left[:, None] - from_left
        fast = states[..., m:] - right[:, None] + to_right
        return jnp.concatenate([slow, fast], axis=-1), (correction, error)

    def newton(self, guess: Float[Array, "E K n"]) -> _NewtonState:
        """Run Newton's method, with steps that are halved until the residual falls."""

        def unfinished(now: _NewtonState) -> Bool[Array, ""]:
            return ~now.converged(self) & (now.count < ITERATIONS) | (now.count == 0)

        def iterate(now: _NewtonState) -> _NewtonState:
            new = now.states - now.damping * now.step
            residual, far = self.residual(new, (now.count > REVISED, now.end.correction))
            defect = self.largest(residual)
            accept = defect < now.defect * (1 - now.damping / 4)
            accept = accept | (now.damping < LEAST_DAMPING)
            keep = functools.partial(jnp.where, accept)
            step, response = self.newton_step(new, residual)
            end = _End(*map(keep, (*far, response), now.end))
            return _NewtonState(
                keep(new, now.states),
                keep(defect, now.defect),
                keep(step, now.step),
                jnp.where(accept & (now.damping == 1), self.largest(now.step), 0.0),
                keep(1.0, now.damping / 2),
                end,
                now.count + 1,
            )

        zero, one, infinite = (jnp.asarray(x, guess.dtype) for x in (0.0, 1.0, jnp.inf))
        none = jnp.zeros(guess.shape[-1] - self.slow0.shape[0], guess.dtype)
        unknown = _End(none, infinite, jnp.full_like(guess, jnp.inf))
        count = jnp.zeros((), "int32")
        begun = _NewtonState(guess, infinite, 0 * guess, zero, one, unknown, count)
        return jax.lax.while_loop(unfinished, iterate, begun)

    def newton_step(
        self, states: Float[Array, "E K n"], residual: Float[Array, "E K n"]
    ) -> tuple[Float[Array, "E K n"], Float[Array, "E K n"]]:
        """Return Newton's step by static condensation, and the response to the end value.

        The response is the root of the sum of squares over changes of ω̇ by 1 along each axis.
        """
        (count, nodes, n), m = states.shape, self.slow0.shape[0]
        jacobian = jax.jacfwd(self.equation, argnums=1)
        jacobians = jax.vmap(jax.vmap(jacobian))(self.times, states)  # e, k, i, l
        slow = (jnp.arange(n) < m)[None, None, :, None]
        weight = jnp.where(slow, -self.forward[:, :, None], self.backward[:, :, None])  # e, j, i, k
        matrix = weight[..., None] * jnp.swapaxes(jacobians, 1, 2)[:, None]  # e, j, i, k, l
        eye = jnp.eye(n, dtype=states.dtype)
        matrix = matrix.reshape(count, nodes * n, nodes * n)
        matrix = matrix + jnp.eye(nodes * n, dtype=states.dtype)[None]
        entering = jnp.broadcast_to(jnp.tile(eye, (nodes, 1)), (count, nodes * n, n))
        sides = jnp.concatenate([residual.reshape(count, -1, 1), entering], axis=-1)
        columns = jax.vmap(solve_dense)(matrix, sides).reshape(count, nodes, n, 1 + n)
        own, response = columns[..., 0], columns[..., 1:]

        # An element depends on the slow part at the right end of the element before it, and on a
        # at the left end of the element after it.
        last = self.times[-1, -1]
        slope = jax.jacfwd(lambda s: self.equation.fast(self.equation.semi(last, s)[:3]))
        slope = slope(states[-1, -1, :m])
        coupled = jnp.eye(count * n, dtype=states.dtype)
        known = jnp.zeros((count, n, 4), states.dtype)
        known = known.at[-1, m:, 1:].set(jax.jacfwd(self.equation.fast)(jnp.zeros(3, states.dtype)))
        for e in range(count):
            low, high = slice(e * n, e * n + m), slice(e * n + m, (e + 1) * n)
            if e > 0:
                before = slice((e - 1) * n, e * n)
                coupled = coupled.at[low, before].add(-response[e - 1, -1, :m])
                known = known.at[e, :m, 0].set(own[e - 1, -1, :m])
            if e < count - 1:
                behind = slice((e + 1) * n, (e + 2) * n)
                coupled = coupled.at[high, behind].add(-response[e + 1, 0, m:])
                known = known.at[e, m:, 0].set(own[e + 1, 0, m:])
            else:
                coupled = coupled.at[high, e * n : (e + 1) * n].add(-slope @ response[e, -1, :m])
                known = known.at[e, m:, 0].set(slope @ own[e, -1, :m])
        enter = solve_dense(coupled, known.reshape(count * n, -1)).reshape(known.shape)
        follow = jnp.einsum("ekil,elc->ekic", response, enter, precision="highest")
        return own + follow[..., 0], jnp.sqrt(jnp.sum(follow[..., 1:] ** 2, axis=-1))


@eqx.filter_custom_jvp
def _solution(problem: _Problem, guess: Float[Array, "E K n"]) -> tuple[Any, ...]:
    """Return the solution, whether it converged, the number of iterations, and the far end."""
    last = problem.newton(guess)
    return last.states - last.step, last.converged(problem), last.count, last.end


@_solution.def_jvp
def _(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """Compute dy = −(∂R/∂y)⁻¹ (∂R/∂p) dp from R(p, y) = 0, which is one Newton step."""
    problem, guess = primals
    states, *others = _solution(problem, guess)

    def residual(problem: _Problem) -> Array:
        return problem.residual(states)[0]

    _, moved = eqx.filter_jvp(residual, (problem,), tangents[:1])
    constant = jax.tree.map(lambda _: None, others)
    return (states, *others), (-problem.newton_step(states, moved)[0], *constant)


def _damped_rate(level: Any, time: Any, slow: Array) -> Array:
    """Return the rates of a first-order level, with ω̇ reduced at large |ω| as in a rotator."""
    rate = level(time, slow)
    omega_dot = rate[:3] / jnp.sqrt(1 + 2 * jnp.sum(slow[:3] ** 2))
    return jnp.concatenate([omega_dot, rate[3:]])


def _guess(
    field: Any, time: Any, slow0: Float[Array, "m"], times: Float[Array, "E K"]
) -> Float[Array, "E K m"]:
    """Guess the slow part at the nodes by the classical Runge–Kutta method."""
    tableau = jnp.asarray([[0.0, 0.5, 0.5, 1.0], [1.0, 2.0, 2.0, 1.0]], slow0.dtype)
    ahead, weights = tableau

    def substep(_: Any, carry: Any) -> Any:
        t, s, h = carry

        def stage(k: Any, rates: Any) -> Any:  # a loop, since the rates take long to compile
            last, total = rates
            rate = field(t + ahead[k] * h, s + ahead[k] * h * last)
            return rate, total + weights[k] * rate

        _, total = jax.lax.fori_loop(0, 4, stage, (0 * s, 0 * s))
        return t + h, s + h / 6 * total, h

    def between_nodes(now: Any, gap: Array) -> tuple[Any, Array]:
        t, slow, _ = jax.lax.fori_loop(0, SUBSTEPS, substep, (*now, gap / SUBSTEPS))
        return (t, slow), slow

    gaps = jnp.diff(times.reshape(-1), prepend=0.0)
    _, motion = jax.lax.scan(between_nodes, (jnp.asarray(time, slow0.dtype), slow0), gaps)
    return motion.reshape(*times.shape, slow0.shape[0])
