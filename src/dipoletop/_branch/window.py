"""A stretch of physical motion of a full equation, as a boundary-value problem.

On the physical branch ω is known at the start; the fast part a of the state, which runs away
forwards in time, is known at the end, because whatever is wrong with it there decays backwards.
Such a problem is well posed where no integration in one direction is. The stretch is cut into
elements, on each of which the state is a polynomial (Chebyshev collocation in integral form):

    ω(τ) = ω(left) + ∫ω̇ dτ from the left,    a(τ) = a(right) − ∫ȧ dτ to the right,

and solved by Newton's method, element by element (condensation), with damping.
"""

import functools
import itertools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .. import radiation
from .._base import dense as _dense
from .._base.chebyshev import collocation_rule

NODES, ELEMENTS = 16, 4
ITERATIONS = 20
CONVERGED = 1e-10  # relative size of the last step, after which the error is far smaller
SUBSTEPS = 2  # of the first guess, between two nodes


class Window(NamedTuple):
    """The physical motion from a start on, over ELEMENTS elements of NODES nodes each."""

    span: Float[Array, ""]
    """How long it is."""
    bend: Float[Array, ""]
    """κ of the map τ = span·(e^{κσ} − 1)/(e^κ − 1): a motion slows down as it is braked."""
    times: Float[Array, "E K"]
    """Times of the nodes, since the start."""
    weights: Float[Array, "E K K"]
    """∫ from the left end of the element to node j = Σ weights[e, j, k] (value at node k)."""
    states: Float[Array, "E K n"]
    converged: Bool[Array, ""]
    iterations: Int[Array, ""]
    tail: Float[Array, "E"]
    """How well each element is resolved, over |ω₀|: the last coefficients of ω, and of ∫a dτ."""
    wrong_end: Float[Array, ""]
    """Estimated error of the fast part at the far end."""


def solve(equation: Any, omega0: Float[Array, "3"], span: Any) -> Window:
    """The physical motion of a full equation over a time `span` from ω₀ on.

    Args:
        equation: a full equation: a state (ω, a), `omega_dot(y)`, the `fast` part of an ω̇, and
            the levels that approach its branch, `reduced(order)` and `semi`.
        omega0: start.
        span: length; the far end, some runaway times long, only serves to fix the rest.
    """
    dtype = omega0.dtype
    sigma, integral, transform = (jnp.asarray(table, dtype) for table in collocation_rule(NODES))
    size = jnp.max(jnp.abs(omega0))
    lower = equation.semi

    # Braking halves ω in a time ~ 1/rate; the nodes follow ln(1 + 2 rate τ).
    start = lower(0.0, omega0)
    energy = radiation.kinetic_energy(equation.body, omega0)
    power = radiation.radiated_power(equation.body, omega0, start)
    rate = power / (2 * jnp.where(energy > 0, energy, 1.0))
    bend = jnp.maximum(jnp.log1p(2 * rate * span), 1e-3)
    along = (jnp.arange(ELEMENTS, dtype=dtype)[:, None] + sigma[None]) / ELEMENTS
    times = span * jnp.expm1(bend * along) / jnp.expm1(bend)
    speed = span * bend / ELEMENTS * jnp.exp(bend * along) / jnp.expm1(bend)
    forward = integral[None] * speed[:, None, :]
    backward = forward[:, -1:] - forward

    first = _guess(lower, omega0, times)
    fast = jax.vmap(jax.vmap(lambda w: equation.fast(_slowed(lower, w))))
    states = jnp.concatenate([first, fast(first)], axis=-1)
    problem = _Problem(equation, omega0, forward, backward)
    states, converged, iterations, wrong_end = _solution(problem, states)
    coefficients = jnp.einsum("kj,ejn->ekn", transform, states, precision="highest")
    last = jnp.max(jnp.abs(coefficients[:, -2:]), axis=1)
    lengths = jnp.diff(times[:, -1], prepend=0.0)
    tail = jnp.maximum(jnp.max(last[:, :3], axis=1), lengths * jnp.max(last[:, 3:], axis=1))
    tail = tail / jnp.where(size > 0, size, 1.0)
    return Window(span, bend, times, forward, states, converged, iterations, tail, wrong_end)


class _Search(NamedTuple):
    """Where Newton's method stands."""

    states: Float[Array, "E K n"]
    missing: Float[Array, ""]
    """The largest component of the residual there."""
    step: Float[Array, "E K n"]
    """To be subtracted next."""
    part: Float[Array, ""]
    """How much of it."""
    wrong_end: Float[Array, ""]
    count: Int[Array, ""]


class _Problem(NamedTuple):
    """The equations for the states at the nodes."""

    equation: Any
    omega0: Float[Array, "3"]
    forward: Float[Array, "E K K"]
    backward: Float[Array, "E K K"]

    def field(self, y: Array) -> Array:
        return self.equation(0.0, y)

    def end(self, omega: Array) -> tuple[Array, Array]:
        """The fast part on the branch, by the asymptotic series, and its error."""
        levels = (self.equation.semi, self.equation.reduced(2), self.equation.reduced(3))
        rates = [self.equation.fast(level(0.0, omega)) for level in levels]
        early, late = (jnp.max(jnp.abs(b - a)) for a, b in itertools.pairwise(rates))
        better = late < early  # or the series diverges here
        error = jnp.minimum(early, late)
        return jnp.where(better, rates[2], rates[0]), error

    def residual(self, states: Array) -> tuple[Array, Array]:
        """What is missing in the two integral equations at every node; the error at the end."""
        rates = jax.vmap(jax.vmap(self.field))(states)
        end, error = self.end(states[-1, -1, :3])
        left = jnp.concatenate([self.omega0[None], states[:-1, -1, :3]])
        right = jnp.concatenate([states[1:, 0, 3:], end[None]])
        gained = jnp.einsum("ejk,eki->eji", self.forward, rates[..., :3], precision="highest")
        coming = jnp.einsum("ejk,eki->eji", self.backward, rates[..., 3:], precision="highest")
        slow = states[..., :3] - left[:, None] - gained
        return jnp.concatenate([slow, states[..., 3:] - right[:, None] + coming], axis=-1), error

    def solved(self, states: Array, size: Array) -> _Search:
        """Newton's method, its steps halved until the residual falls."""

        def going(at: _Search) -> Bool[Array, ""]:
            change = jnp.max(jnp.abs(at.step))
            return (change > CONVERGED * size) & (at.count < ITERATIONS) | (at.count == 0)

        def tried(at: _Search) -> _Search:
            new = at.states - at.part * at.step
            residual, error = self.residual(new)
            missing = jnp.max(jnp.abs(residual))
            good = (missing < at.missing * (1 - at.part / 4)) | (at.part < 0.02)
            keep = functools.partial(jnp.where, good)
            return _Search(
                keep(new, at.states),
                keep(missing, at.missing),
                keep(self.step(new, residual), at.step),
                keep(1.0, at.part / 2),
                error,
                at.count + 1,
            )

        infinite, one = jnp.asarray(jnp.inf, size.dtype), jnp.ones_like(size)
        start = _Search(states, infinite, 0 * states, one, infinite, jnp.zeros((), "int32"))
        return jax.lax.while_loop(going, tried, start)

    def step(self, states: Array, residual: Array) -> Array:
        """Newton's step: each element for itself, as a function of what enters at its ends."""
        count, nodes, n = states.shape
        inner = jax.vmap(jax.vmap(jax.jacfwd(self.field)))(states)  # e, k, i, l
        slow = (jnp.arange(n) < 3)[None, None, :, None]
        weight = jnp.where(slow, -self.forward[:, :, None], self.backward[:, :, None])  # e, j, i, k
        matrix = weight[..., None] * jnp.swapaxes(inner, 1, 2)[:, None]  # e, j, i, k, l
        eye = jnp.eye(n, dtype=states.dtype)
        matrix = matrix.reshape(count, nodes * n, nodes * n)
        matrix = matrix + jnp.eye(nodes * n, dtype=states.dtype)[None]
        entering = jnp.broadcast_to(jnp.tile(eye, (nodes, 1)), (count, nodes * n, n))
        sides = jnp.concatenate([residual.reshape(count, -1, 1), entering], axis=-1)
        solved = jax.vmap(_dense.solve)(matrix, sides).reshape(count, nodes, n, 1 + n)
        own, response = solved[..., 0], solved[..., 1:]

        # What enters an element: ω at the end of the one before, a at the start of the one behind.
        slope = jax.jacfwd(lambda w: self.equation.fast(self.equation.semi(0.0, w)))
        slope = slope(states[-1, -1, :3])
        whole = jnp.eye(count * n, dtype=states.dtype)
        known = jnp.zeros((count, n), states.dtype)
        for e in range(count):
            low, high = slice(e * n, e * n + 3), slice(e * n + 3, (e + 1) * n)
            if e > 0:
                before = slice((e - 1) * n, e * n)
                whole = whole.at[low, before].add(-response[e - 1, -1, :3])
                known = known.at[e, :3].set(own[e - 1, -1, :3])
            if e < count - 1:
                behind = slice((e + 1) * n, (e + 2) * n)
                whole = whole.at[high, behind].add(-response[e + 1, 0, 3:])
                known = known.at[e, 3:].set(own[e + 1, 0, 3:])
            else:
                whole = whole.at[high, e * n : (e + 1) * n].add(-slope @ response[e, -1, :3])
                known = known.at[e, 3:].set(slope @ own[e, -1, :3])
        enter = _dense.solve(whole, known.reshape(-1, 1)).reshape(count, n)
        return own + jnp.einsum("ekil,el->eki", response, enter, precision="highest")


@eqx.filter_custom_jvp
def _solution(problem: _Problem, guess: Float[Array, "E K n"]) -> tuple[Array, ...]:
    """States that solve a problem, whether they do, tries, and the error at the far end."""
    size = jnp.max(jnp.abs(problem.omega0))
    search = problem.solved(guess, size)
    converged = jnp.max(jnp.abs(search.step)) <= CONVERGED * size
    return search.states - search.step, converged, search.count, search.wrong_end


@_solution.def_jvp
def _(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """R(p, y) = 0 has dy = −(∂R/∂y)⁻¹ (∂R/∂p) dp: a step of Newton's, whatever the search was."""
    problem, guess = primals
    states, *others = _solution(problem, guess)

    def residual(problem: _Problem) -> Array:
        return problem.residual(states)[0]

    _, moved = eqx.filter_jvp(residual, (problem,), tangents[:1])
    return (states, *others), (-problem.step(states, moved), None, None, None)


def evaluate(window: Window, values: Float[Array, "E K n"], at: Float[Array, "T"]) -> Array:
    """Polynomials on the elements of a window, given at its nodes, at times since its start."""
    sigma = jnp.log1p(at / window.span * jnp.expm1(window.bend)) / window.bend * ELEMENTS
    element = jnp.clip(jnp.floor(sigma), 0, ELEMENTS - 1)
    x = jnp.clip(2 * (sigma - element) - 1, -1.0, 1.0)
    basis = [jnp.ones_like(x), x]  # by their recurrence: arccos has no derivative at the ends
    while len(basis) < NODES:
        basis.append(2 * x * basis[-1] - basis[-2])
    transform = jnp.asarray(collocation_rule(NODES).coefficients, x.dtype)
    coefficients = jnp.einsum("kj,ejn->ekn", transform, values, precision="highest")
    here = coefficients[element.astype(int)]
    return jnp.einsum("kt,tkn->tn", jnp.stack(basis), here, precision="highest")


def _slowed(lower: Any, omega: Array) -> Array:
    """A first-order rate, and what is left of it where it is large, as for a plane rotator."""
    return lower(0.0, omega) / jnp.sqrt(1 + 2 * jnp.sum(omega**2))


def _guess(lower: Any, omega0: Array, times: Array) -> Array:
    """A motion to begin with, by short Runge–Kutta steps of a first-order level."""
    field = functools.partial(_slowed, lower)

    def small(_: Any, carry: Any) -> Any:
        w, h = carry
        k1 = field(w)
        k2 = field(w + h / 2 * k1)
        k3 = field(w + h / 2 * k2)
        return w + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(w + h * k3)), h

    def step(w: Array, gap: Array) -> tuple[Array, Array]:
        new, _ = jax.lax.fori_loop(0, SUBSTEPS, small, (w, gap / SUBSTEPS))
        return new, new

    gaps = jnp.diff(times.reshape(-1), prepend=0.0)
    _, motion = jax.lax.scan(step, omega0, gaps)
    return motion.reshape(*times.shape, 3)
