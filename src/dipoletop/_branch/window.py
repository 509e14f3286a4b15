"""A window: a stretch of physical motion of a full equation, as a boundary-value problem.

A full equation has a state (ω, a) whose fast part a runs away from the physical branch: near the
branch a = A(ω) a distance δa = a − A(ω) obeys δa′ ≈ λ δa, λ > 0 being the runaway rate. It grows
as e^{λτ} forwards in time, so an initial-value problem is ill posed; and it decays as fast
backwards. Therefore ω is given at the left end and a at the right end T. This problem is well
posed: it is dichotomic, as the theory of boundary-value problems says (Ascher, Mattheij, Russell,
*Numerical Solution of Boundary Value Problems for Ordinary Differential Equations*, SIAM 1995).

At T the value of a comes from the asymptotic series of A(ω), with an error ε that is not small. At
an earlier τ only ε e^{−λ(T − τ)} of it is left. To bring it below a tolerance, T must lie
ln(ε/tolerance) runaway e-foldings past the part of the window that is kept: 36 of them for the
rounding error of float64.

The window is cut into elements, on each of which the state is a polynomial (Chebyshev collocation
in integral form):

    ω(τ) = ω(left) + ∫ω̇ dτ from the left,    a(τ) = a(right) − ∫ȧ dτ to the right.

An attitude on which a torque depends is slow, too: it stands behind ω and is treated as ω is.

These equations are solved by Newton's method with damping. A step of it eliminates the nodes of
each element first, as functions of what enters at its two ends, and then solves the small system
for the values that enter (static condensation).
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
from ..equations._common import elements_of
from ..equations.rigid import free_rotation

NODES = 16  # of an element
ITERATIONS = 20  # of Newton's method, at most
LEAST_DAMPING = 0.02  # below, a step is accepted even if the residual does not fall
CONVERGED = 1e-10  # relative size of the last step, after which the error is far smaller
NEGLIGIBLE = 1e-15  # relative size of the step after it that also tells so, at least
REMAINDER = 1e-3  # of the tolerance: what that step may be
FALLING = 0.03  # of one step over that before it, at most, where convergence is quadratic
SUBSTEPS = 2  # of the initial guess, between two nodes


class Window(NamedTuple):
    """The physical motion from ω₀ on, on elements of NODES nodes each."""

    span: Float[Array, ""]
    """Length."""
    size: Float[Array, ""]
    """The largest component of ω, to which errors are compared."""
    bend: Float[Array, ""]
    """κ of the map τ = span·(e^{κσ} − 1)/(e^κ − 1): a motion slows down as it is braked."""
    times: Float[Array, "E K"]
    """Times of the nodes, since the start."""
    weights: Float[Array, "E K K"]
    """∫ from the left end of the element to node j = Σ weights[e, j, k] (value at node k)."""
    states: Float[Array, "E K n"]
    converged: Bool[Array, ""]
    iterations: Int[Array, ""]
    truncation: Float[Array, "E"]
    """Truncation error of each element over `size`: the last coefficients of ω, and of ∫a dτ."""
    end_error: Float[Array, ""]
    """Estimated error of the fast part at the far end."""


def solve_window(
    equation: Any, time: Any, slow0: Float[Array, "m"], span: Any, rtol: Any = 0.0
) -> Window:
    """The physical motion of a full equation over a time `span` from a slow state on.

    Args:
        equation: a full equation, with the levels that approach its branch (`FullEquation`).
        time: τ at the left end.
        slow0: the slow part of the state there; it begins with ω.
        span: length, several runaway e-foldings more than what will be kept.
        rtol: the relative error that is allowed; Newton's method leaves far less.
    """
    dtype, omega0, elements = slow0.dtype, slow0[:3], elements_of(equation)
    sigma, integral, transform = (jnp.asarray(table, dtype) for table in collocation_rule(NODES))

    # Braking halves ω in a time ~ 1/rate; the nodes follow ln(1 + 2 rate τ). A torque that
    # accelerates ω where it is small does not count as braking.
    omega_dot, _ = free_rotation(equation.body, omega0)
    energy = radiation.kinetic_energy(equation.body, omega0)
    power = radiation.radiated_power(equation.body, omega0, omega_dot)
    rate = power / (2 * jnp.where(energy > 0, energy, 1.0))
    bend = jnp.maximum(jnp.log1p(2 * rate * span), 1e-3)
    along = (jnp.arange(elements, dtype=dtype)[:, None] + sigma[None]) / elements
    times = span * jnp.expm1(bend * along) / jnp.expm1(bend)
    speed = span * bend / elements * jnp.exp(bend * along) / jnp.expm1(bend)
    forward = integral[None] * speed[:, None, :]
    backward = forward[:, -1:] - forward

    field = functools.partial(_damped_rate, equation.semi)
    slow = _guess(field, time, slow0, times)
    fast = jax.vmap(jax.vmap(lambda t, s: equation.fast(field(t, s)[:3])))(time + times, slow)
    guess = jnp.concatenate([slow, fast], axis=-1)
    # A torque may set a body in motion that rests at the left end.
    size = jnp.maximum(jnp.max(jnp.abs(omega0)), jnp.max(jnp.abs(slow[..., :3])))
    size = jax.lax.stop_gradient(jnp.where(size > 0, size, 1.0))
    negligible = jnp.maximum(jnp.asarray(REMAINDER * rtol, dtype), NEGLIGIBLE)
    problem = _Problem(equation, time + times, slow0, forward, backward, size, negligible)
    states, converged, iterations, end_error = _solution(problem, guess)
    coefficients = jnp.einsum("kj,ejn->ekn", transform, states, precision="highest")
    last = jnp.max(jnp.abs(coefficients[:, -2:]), axis=1)
    lengths, m = jnp.diff(times[:, -1], prepend=0.0), slow0.shape[0]
    last = jnp.concatenate([last[:, :m], lengths[:, None] * last[:, m:]], axis=-1)
    truncation = jnp.max(last / problem.scale(last.shape[-1])[None], axis=1)
    return Window(
        span, size, bend, times, forward, states, converged, iterations, truncation, end_error
    )


class _NewtonState(NamedTuple):
    """State of Newton's method."""

    states: Float[Array, "E K n"]
    defect: Float[Array, ""]
    """The relative size of the residual there."""
    step: Float[Array, "E K n"]
    """The full step, to be subtracted next."""
    before: Float[Array, ""]
    """The relative size of the step before it, if that was a full one; else 0."""
    damping: Float[Array, ""]
    """The factor of the step."""
    end_error: Float[Array, ""]
    count: Int[Array, ""]

    def converged(self, problem: "_Problem") -> Bool[Array, ""]:
        """Whether the error after the next step is negligible.

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
    size: Float[Array, ""]
    """The largest component of ω."""
    negligible: Float[Array, ""]
    """The relative size of errors that Newton's method may leave."""

    def scale(self, n: int) -> Float[Array, "n"]:
        """What errors of n components are compared to: `size`, and 1 for an attitude."""
        attitude = jnp.ones(self.slow0.shape[0] - 3, self.size.dtype)
        omega, fast = jnp.full(3, self.size), jnp.full(n - self.slow0.shape[0], self.size)
        return jnp.concatenate([omega, attitude, fast])

    def largest(self, states: Float[Array, "E K n"]) -> Float[Array, ""]:
        """The largest component, relative to `scale`."""
        return jnp.max(jnp.abs(states) / self.scale(states.shape[-1])[None, None])

    def end_value(self, slow: Array) -> tuple[Array, Array]:
        """The fast part on the branch by the asymptotic series, and its estimated error."""
        levels = (self.equation.semi, self.equation.reduced(2), self.equation.reduced(3))
        rates = [self.equation.fast(level(self.times[-1, -1], slow)[:3]) for level in levels]
        early, late = (jnp.max(jnp.abs(b - a)) for a, b in itertools.pairwise(rates))
        converges = late < early
        error = jnp.minimum(early, late)
        return jnp.where(converges, rates[2], rates[0]), error

    def residual(self, states: Array) -> tuple[Array, Array]:
        """The defects of the two integral equations at every node; the error at the far end."""
        m = self.slow0.shape[0]
        rates = jax.vmap(jax.vmap(self.equation))(self.times, states)
        end, error = self.end_value(states[-1, -1, :m])
        left = jnp.concatenate([self.slow0[None], states[:-1, -1, :m]])
        right = jnp.concatenate([states[1:, 0, m:], end[None]])
        from_left = jnp.einsum("ejk,eki->eji", self.forward, rates[..., :m], precision="highest")
        to_right = jnp.einsum("ejk,eki->eji", self.backward, rates[..., m:], precision="highest")
        slow = states[..., :m] - left[:, None] - from_left
        fast = states[..., m:] - right[:, None] + to_right
        return jnp.concatenate([slow, fast], axis=-1), error

    def newton(self, guess: Float[Array, "E K n"]) -> _NewtonState:
        """Newton's method, its steps halved until the residual falls."""

        def unfinished(now: _NewtonState) -> Bool[Array, ""]:
            return ~now.converged(self) & (now.count < ITERATIONS) | (now.count == 0)

        def iterate(now: _NewtonState) -> _NewtonState:
            new = now.states - now.damping * now.step
            residual, error = self.residual(new)
            defect = self.largest(residual)
            accept = defect < now.defect * (1 - now.damping / 4)
            accept = accept | (now.damping < LEAST_DAMPING)
            keep = functools.partial(jnp.where, accept)
            return _NewtonState(
                keep(new, now.states),
                keep(defect, now.defect),
                keep(self.newton_step(new, residual), now.step),
                jnp.where(accept & (now.damping == 1), self.largest(now.step), 0.0),
                keep(1.0, now.damping / 2),
                error,
                now.count + 1,
            )

        infinite, one = jnp.asarray(jnp.inf, guess.dtype), jnp.ones_like(self.size)
        zero = jnp.zeros_like(self.size)
        begun = _NewtonState(
            guess, infinite, 0 * guess, zero, one, infinite, jnp.zeros((), "int32")
        )
        return jax.lax.while_loop(unfinished, iterate, begun)

    def newton_step(
        self, states: Float[Array, "E K n"], residual: Float[Array, "E K n"]
    ) -> Float[Array, "E K n"]:
        """Newton's step by static condensation."""
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

        # The slow part at the right end of the element before enters an element, and a at the left
        # end of the one behind it.
        last = self.times[-1, -1]
        slope = jax.jacfwd(lambda s: self.equation.fast(self.equation.semi(last, s)[:3]))
        slope = slope(states[-1, -1, :m])
        coupled = jnp.eye(count * n, dtype=states.dtype)
        known = jnp.zeros((count, n), states.dtype)
        for e in range(count):
            low, high = slice(e * n, e * n + m), slice(e * n + m, (e + 1) * n)
            if e > 0:
                before = slice((e - 1) * n, e * n)
                coupled = coupled.at[low, before].add(-response[e - 1, -1, :m])
                known = known.at[e, :m].set(own[e - 1, -1, :m])
            if e < count - 1:
                behind = slice((e + 1) * n, (e + 2) * n)
                coupled = coupled.at[high, behind].add(-response[e + 1, 0, m:])
                known = known.at[e, m:].set(own[e + 1, 0, m:])
            else:
                coupled = coupled.at[high, e * n : (e + 1) * n].add(-slope @ response[e, -1, :m])
                known = known.at[e, m:].set(slope @ own[e, -1, :m])
        enter = solve_dense(coupled, known.reshape(-1, 1)).reshape(count, n)
        return own + jnp.einsum("ekil,el->eki", response, enter, precision="highest")


@eqx.filter_custom_jvp
def _solution(problem: _Problem, guess: Float[Array, "E K n"]) -> tuple[Array, ...]:
    """States that solve a problem, whether they do, iterations, and the error at the far end."""
    last = problem.newton(guess)
    return last.states - last.step, last.converged(problem), last.count, last.end_error


@_solution.def_jvp
def _(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """R(p, y) = 0 implies dy = −(∂R/∂y)⁻¹ (∂R/∂p) dp, which is one Newton step."""
    problem, guess = primals
    states, *others = _solution(problem, guess)

    def residual(problem: _Problem) -> Array:
        return problem.residual(states)[0]

    _, moved = eqx.filter_jvp(residual, (problem,), tangents[:1])
    return (states, *others), (-problem.newton_step(states, moved), None, None, None)


def evaluate(
    window: Window, values: Float[Array, "E K n"], times: Float[Array, "T"]
) -> Float[Array, "T n"]:
    """Interpolate values at the nodes of a window to times since its left end."""
    elements = window.times.shape[0]
    sigma = jnp.log1p(times / window.span * jnp.expm1(window.bend)) / window.bend * elements
    element = jnp.clip(jnp.floor(sigma), 0, elements - 1)
    x = jnp.clip(2 * (sigma - element) - 1, -1.0, 1.0)
    basis = chebyshev(x)
    transform = jnp.asarray(collocation_rule(NODES).coefficients, x.dtype)
    coefficients = jnp.einsum("kj,ejn->ekn", transform, values, precision="highest")
    here = coefficients[element.astype(int)]
    return jnp.einsum("kt,tkn->tn", jnp.stack(basis), here, precision="highest")


def chebyshev(x: Array) -> list[Array]:
    """The first NODES Chebyshev polynomials, on [−1, 1]."""
    basis = [jnp.ones_like(x), x]  # by recurrence: arccos has no derivative at the ends
    while len(basis) < NODES:
        basis.append(2 * x * basis[-1] - basis[-2])
    return basis


def _damped_rate(level: Any, time: Any, slow: Array) -> Array:
    """The rates of a first-order level, that of ω reduced at large |ω| as in a plane rotator."""
    rate = level(time, slow)
    omega_dot = rate[:3] / jnp.sqrt(1 + 2 * jnp.sum(slow[:3] ** 2))
    return jnp.concatenate([omega_dot, rate[3:]])


def _guess(
    field: Any, time: Any, slow0: Float[Array, "m"], times: Float[Array, "E K"]
) -> Float[Array, "E K m"]:
    """An initial guess of the slow part at the nodes: the classical Runge–Kutta method."""

    def substep(_: Any, carry: Any) -> Any:
        t, s, h = carry
        k1 = field(t, s)
        k2 = field(t + h / 2, s + h / 2 * k1)
        k3 = field(t + h / 2, s + h / 2 * k2)
        return t + h, s + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(t + h, s + h * k3)), h

    def between_nodes(now: Any, gap: Array) -> tuple[Any, Array]:
        t, slow, _ = jax.lax.fori_loop(0, SUBSTEPS, substep, (*now, gap / SUBSTEPS))
        return (t, slow), slow

    gaps = jnp.diff(times.reshape(-1), prepend=0.0)
    _, motion = jax.lax.scan(between_nodes, (jnp.asarray(time, slow0.dtype), slow0), gaps)
    return motion.reshape(*times.shape, slow0.shape[0])
