"""End states at a fixed time by every method on one core, and reference values.

A method is a function `prepare(omegas, rtol) -> task`. It prepares the parts that depend on the
problem and the tolerance; only the task, which returns the end states, is timed.
"""

import functools
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers import with_diffrax
from benchmarks.problems import mixed_basin

try:
    import heyoka

    from benchmarks.peers import with_heyoka
except ImportError:
    heyoka = None

DELTA, AMPLITUDE, TIME = -0.2, 0.2, 1000.0
MAX_STEPS = 4096
CHUNK = 512  # starts in one vmap of diffrax: the fastest of 32, 128, 512 and 4096
SCIPY = "scipy DOP853"  # so slow that it gets a few starts, and one run
FEW = 64

Starts = Float[np.ndarray, "n 3"]
Task = Callable[[], Starts]
Method = Callable[[Starts, float], Task]


def starts(n: int) -> Starts:
    """Return isotropic starts; start i does not depend on n."""
    return mixed_basin.isotropic(n, AMPLITUDE)


def by_dipoletop(omegas: Starts, rtol: float, engine: str) -> Task:
    """Prepare dipoletop, all starts in the queue of an engine."""
    size = len(omegas)
    atol, last = jnp.full(size, rtol * AMPLITUDE), jnp.full(size, TIME)
    bounds = engines.limits(rtol, atol, MAX_STEPS, last)
    equation = dt.TransverseReduced(jnp.full(size, DELTA))

    def advance() -> Starts:
        y0 = omegas.T if engine == "native" else jnp.asarray(omegas.T)
        return np.asarray(engines.integrate(engine, equation, y0, bounds, until="time").y).T

    return advance


@functools.cache
def _solver(as_tuple: bool) -> Callable[..., Any]:
    settings: Any = {"as_tuple": as_tuple, "max_steps": MAX_STEPS}

    def solve(omega: Any, delta: Any, rtol: Any) -> Any:
        return with_diffrax.end_state(delta, omega, rtol, rtol * AMPLITUDE, TIME, **settings)[0]

    return jax.jit(jax.vmap(solve, in_axes=(0, None, None)))


def by_diffrax(omegas: Starts, rtol: float, as_tuple: bool) -> Task:
    """Prepare diffrax, Dopri8 under vmap, the state a tuple of scalars or a vector (3,)."""
    chunks = range(0, len(omegas), CHUNK)
    solve = _solver(as_tuple)
    return lambda: np.concatenate([solve(omegas[k : k + CHUNK], DELTA, rtol) for k in chunks])


def _system(amplitude: float) -> list[tuple[Any, Any]]:
    """Return the equation for heyoka, with the amplitude as the unit of ω, its inverse of time."""
    y = heyoka.make_vars("y1", "y2", "y3")
    return list(zip(y, mixed_basin.rate(DELTA, y, amplitude), strict=True))


def heyoka_batch(omegas: Starts, rtol: float) -> Task:
    """Prepare heyoka in batch mode, scaled by |ω₀|, since its tolerance is absolute below 1.

    All coefficients are compile-time constants (the other methods get δ at run time). Batches of
    two and four times the SIMD width are no faster, and two threads are no faster than one.
    """
    integrator = with_heyoka.batch_integrator(_system(AMPLITUDE), rtol)

    def advance() -> None:
        integrator.set_time(0.0)
        integrator.propagate_until(AMPLITUDE * TIME)

    scaled, no_parameters = omegas.T / AMPLITUDE, np.zeros((0, len(omegas)))
    return lambda: AMPLITUDE * with_heyoka.in_batches(integrator, scaled, no_parameters, advance).T


def _one_by_one(integrator: Any, omegas: Starts, last: Any) -> Starts:
    """Advance one start after another to a time, in the arithmetic of that time."""
    ends = omegas.copy()
    for end in ends:
        integrator.state[:] = end
        integrator.time = 0 * last
        integrator.propagate_until(last)
        end[:] = integrator.state
    return ends


def heyoka_scalar(omegas: Starts, rtol: float) -> Task:
    """Prepare heyoka, one start after another, scaled as in batch mode."""
    settings = {"compact_mode": False, "fast_math": True}
    integrator = heyoka.taylor_adaptive(_system(AMPLITUDE), np.zeros(3), tol=rtol, **settings)
    return lambda: AMPLITUDE * _one_by_one(integrator, omegas / AMPLITUDE, AMPLITUDE * TIME)


def by_scipy(omegas: Starts, rtol: float) -> Task:
    """Prepare scipy's DOP853 for the first few starts, one after another."""

    def end(omega: Any) -> Any:
        def rate(t: float, y: Any) -> Any:
            return mixed_basin.rate(DELTA, y)

        span, scale = (0.0, TIME), rtol * AMPLITUDE
        return solve_ivp(rate, span, omega, method="DOP853", rtol=rtol, atol=scale).y[:, -1]

    return lambda: np.array([end(omega) for omega in omegas[:FEW]])


def _in_long_double(omegas: Starts) -> Starts:
    """Return end states by heyoka, one start after another, in extended precision."""
    integrator = heyoka.taylor_adaptive(
        _system(1.0),
        np.zeros(3, np.longdouble),
        fp_type=np.longdouble,
        tol=np.longdouble(1e-19),
    )
    return _one_by_one(integrator, omegas, np.longdouble(TIME))


def reference(omegas: Starts) -> tuple[Starts, str]:
    """Return reference end states and their source; without heyoka for a few starts only."""
    few = by_scipy(omegas, 1e-13)()
    extended = np.finfo(np.longdouble).eps < 1e-18
    if heyoka is None or not extended:
        return few, f"scipy DOP853, rtol 1e-13, {len(few)} starts: errors below 1e-12 mean little"
    ends = _in_long_double(omegas)
    apart = np.max(np.abs(few - ends[: len(few)])) / AMPLITUDE
    about = f"heyoka in 80-bit arithmetic, tolerance 1e-19 (scipy DOP853 at 1e-13: {apart:.0e} off)"
    return ends, about


def methods() -> tuple[dict[str, Method], list[str]]:
    """Return the methods that can run here by name, and a line for each that cannot."""
    everybody: dict[str, Method] = {
        "dipoletop, native engine": partial(by_dipoletop, engine="native"),
        "dipoletop, JAX engine": partial(by_dipoletop, engine="jax"),
        "diffrax vmap, tuple": partial(by_diffrax, as_tuple=True),
        "diffrax vmap, (3,)": partial(by_diffrax, as_tuple=False),
    }
    missing = []
    if heyoka is None:
        missing.append("heyoka: left out (not installed)")
    else:
        heyoka.llvm_state.set_diskcache_enabled(False)  # all methods compile
        everybody |= {"heyoka batch": heyoka_batch, "heyoka scalar": heyoka_scalar}
    return everybody | {SCIPY: by_scipy}, missing
