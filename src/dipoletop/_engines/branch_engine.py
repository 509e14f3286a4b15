"""The branch engine, which integrates full equations along their physical branch."""

from dataclasses import dataclass
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.parallel import Device
from .._base.stopping import BROKEN, EXHAUSTED, FINISHED, RUNNING, Until, decided
from .._base.tolerances import Tolerances
from .._branch.march import advance_window, start_march
from ..equations.tangent import Tangent
from .interface import EndStates, Finish, Limits, Queue, T, lifted, on_device


@final
@dataclass(frozen=True)
class BranchEngine:
    """An engine in JAX for full equations on their physical branch; a step is a window."""

    name: ClassVar[str] = "branch"
    has_own_threads: ClassVar[bool] = False
    compiles_for_size: ClassVar[bool] = True

    def end_states(
        self, equation: Any, y0: Float[Array, "n N"], limits: Limits, *, until: Until = "value"
    ) -> EndStates:
        """Integrate along the branch from ω of `y0`, which determines the rest of the state.

        Verdicts are evaluated only at the ends of the elements of a window.
        """
        return _integrate(equation, y0, limits, until)

    def classify(
        self, finish: Finish[T], queue: Queue, device: Device, threads: int = 1
    ) -> tuple[T, None]:
        """Lift the starts, integrate along the branch, and apply `finish` to the end states."""
        equation, omegas, limits, until, *_ = on_device(queue, device)
        ends = self.end_states(equation, lifted(equation, omegas), limits, until=until)
        return _finished(finish, equation, omegas, ends, limits.tolerances), None


@eqx.filter_jit
def _finished(
    finish: Finish[T], equation: Any, omegas: Array, ends: EndStates, tolerances: Tolerances
) -> T:
    return finish(equation, omegas, ends, tolerances)


@eqx.filter_jit
def _integrate(equation: Any, y0: Array, limits: Limits, until: Until) -> EndStates:
    arrays, static = eqx.partition(equation, eqx.is_array)

    def one_run(lane: Any) -> EndStates:
        parameters, start, atol, t1 = lane
        own = Limits(limits.rtol, atol, t1, limits.max_steps)
        return end_on_branch(eqx.combine(parameters, static), start, own, until)

    lane = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), (arrays, y0, limits.atol, limits.t1))
    # One run after another: in a batch all would wait for the slowest, and nothing is gained.
    ends = jax.lax.map(one_run, lane)
    block_steps = jnp.stack([jnp.sum(ends.steps), 0])
    return EndStates(ends.y.T, ends.t, ends.steps, ends.status, block_steps)


def end_on_branch(equation: Any, y0: Float[Array, "n"], limits: Limits, until: Until) -> EndStates:
    """Return the end state of one run along the branch; with t1 ≤ 0 its start."""
    if isinstance(equation, Tangent):
        return _with_variations(equation, y0, limits, until)

    def ends(y: Array) -> Bool[Array, ""]:
        # The decision to end has no derivative, and derivatives of a verdict are long programs.
        fixed, state = jax.lax.stop_gradient((eqx.filter(equation, eqx.is_array), y))
        return decided(eqx.combine(fixed, equation), state, limits.tolerances, until)

    def running(carry: Any) -> Bool[Array, ""]:
        return carry[3] == RUNNING

    def advance(carry: Any) -> Any:
        state, y, _, _ = carry
        new, window, accepted = advance_window(equation, state, limits.rtol)
        # The first state is tested with the first window: XLA compiles a long verdict only once.
        states = jnp.concatenate([y[None], window.states[:, -1]])
        times = state.time + jnp.append(0.0, window.mesh.times[:, -1])
        done = jax.vmap(ends)(states) & (jnp.arange(times.size) <= accepted)
        which = jnp.where(jnp.any(done), jnp.argmax(done), accepted)
        most = limits.max_steps.astype(new.windows.dtype)
        status = jnp.where(new.windows < most, RUNNING, EXHAUSTED)
        status = jnp.where(new.failed, BROKEN, status)
        status = jnp.where(jnp.any(done), FINISHED, status).astype("int32")
        return new, states[which], times[which], status

    state = start_march(equation, equation.omega(y0), 0.0)
    idle = jnp.where(limits.t1 > 0, RUNNING, FINISHED)
    status = jnp.where(state.failed, BROKEN, idle)
    begun = state, y0, state.time, status.astype("int32")
    state, y, time, status = jax.lax.while_loop(running, advance, begun)
    return EndStates(y, time, state.windows, status)


def _with_variations(
    equation: Tangent, y0: Float[Array, "n"], limits: Limits, until: Until
) -> EndStates:
    """Return the end state of one motion together with its variations."""
    base, n = equation.equation, y0.shape[0] // (1 + equation.m)
    arrays, rest = eqx.partition(base, eqx.is_inexact_array)

    def end(arrays: Any, omega: Array) -> Any:
        varied = eqx.combine(arrays, rest)
        ends = end_on_branch(varied, varied.lift(omega), limits, until)
        return ends.y, (ends.t, ends.steps, ends.status)

    def along(parameters: Any, variation: Array) -> Any:
        return jax.jvp(end, (arrays, omega), (parameters, variation), has_aux=True)

    omega = base.omega(y0[:n])
    y, variations, others = jax.vmap(along, out_axes=(None, 0, None))(
        equation.parameter_variations, equation.start_variations
    )
    return EndStates(jnp.concatenate([y, variations.ravel()]), *others)
