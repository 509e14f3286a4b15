"""Work and precision: end states at a fixed time, cost against true error.

4096 isotropic starts with |ω| = 0.2 of the top with δ = −1/5, at τ = 1000. The error is the
largest component of the difference from a reference, over |ω₀|.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

import dipoletop as dt
import measure
import problem
from dipoletop import lanes, native

try:
    import heyoka
except ImportError:
    heyoka = None

DELTA, AMPLITUDE, TIME = -0.2, 0.2, 1000.0
TOLERANCES = tuple(10.0**-k for k in range(6, 13))
MAX_STEPS = 4096
CHUNK = 512  # starts in one vmap of diffrax: the fastest of 32, 128, 512 and 4096

Starts = Float[np.ndarray, "n 3"]
Advance = Callable[[Starts, float], Starts]


def starts(n: int) -> Starts:
    """Isotropic starts; the i-th does not depend on how many there are."""
    _, omegas = problem.mixed_basin(n)
    return AMPLITUDE * omegas / np.linalg.norm(omegas, axis=1)[:, None]


def by_lanes(omegas: Starts, rtol: float, engine: Any = native) -> Starts:
    """dipoletop, an engine in one thread."""
    size = len(omegas)
    atol = jnp.full(size, rtol * AMPLITUDE)
    limits = lanes.Limits(jnp.asarray(rtol), atol, jnp.full(size, TIME), jnp.asarray(MAX_STEPS))
    equation = dt.TransverseReduced(jnp.full(size, DELTA))
    return np.asarray(engine.integrate(equation, jnp.asarray(omegas.T), limits, until="time").y.T)


def by_lanes_everywhere(omegas: Starts, rtol: float) -> Starts:
    """dipoletop, one thread for each core."""
    parts = np.array_split(omegas, measure.cores())
    with ThreadPoolExecutor(len(parts)) as threads:
        return np.concatenate(list(threads.map(partial(by_lanes, rtol=rtol), parts)))


@jax.jit
@partial(jax.vmap, in_axes=(0, None, None))
def _solve(omega: Any, delta: Any, rtol: Any) -> Any:
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: problem.rate(args, y)),
        diffrax.Dopri8(),
        0.0,
        TIME,
        None,
        tuple(omega),
        args=delta,
        saveat=diffrax.SaveAt(t1=True),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * AMPLITUDE),
        adjoint=diffrax.ForwardMode(),
        max_steps=MAX_STEPS,
        throw=False,
    )
    return jnp.stack(solution.ys)[:, 0]  # pyright: ignore[reportArgumentType]


def by_diffrax(omegas: Starts, rtol: float) -> Starts:
    """diffrax, Dopri8 under vmap, the state a tuple of scalars."""
    chunks = range(0, len(omegas), CHUNK)
    return np.concatenate([_solve(omegas[k : k + CHUNK], DELTA, rtol) for k in chunks])


def heyoka_batch(rtol: float) -> Callable[[Starts], Starts]:
    """heyoka in batch mode; scaled by |ω₀|, because its tolerance is absolute below 1.

    All coefficients are numbers known to its compiler (the others are told δ at run time). Twice
    and four times the SIMD width are no faster, and two threads are no faster than one.
    """
    assert heyoka is not None
    width = heyoka.recommended_simd_size()
    y = heyoka.make_vars("y1", "y2", "y3")
    integrator = heyoka.taylor_adaptive_batch(
        list(zip(y, problem.rate(DELTA, y, AMPLITUDE), strict=True)),
        np.zeros((3, width)),
        tol=rtol,
        compact_mode=False,
        fast_math=True,
    )

    def advance(omegas: Starts) -> Starts:
        batches = -(-len(omegas) // width)
        padded = np.minimum(np.arange(batches * width), len(omegas) - 1)
        scaled = (omegas[padded] / AMPLITUDE).reshape(batches, width, 3)
        blocks = np.ascontiguousarray(scaled.swapaxes(1, 2))
        state = integrator.state  # a view
        for block in blocks:
            state[:] = block
            integrator.set_time(0.0)
            integrator.propagate_until(AMPLITUDE * TIME)
            block[:] = state
        return AMPLITUDE * blocks.swapaxes(1, 2).reshape(-1, 3)[: len(omegas)]

    return advance


def _by_scipy(omegas: Starts) -> Starts:
    def end(omega: Any) -> Any:
        def rate(t: float, y: Any) -> Any:
            return problem.rate(DELTA, y)

        scale = {"rtol": 1e-13, "atol": 1e-14 * AMPLITUDE}
        return solve_ivp(rate, (0.0, TIME), omega, method="DOP853", **scale).y[:, -1]

    return np.array([end(omega) for omega in omegas])


def _in_long_double(omegas: Starts) -> Starts:
    """heyoka, one start after another, in extended precision."""
    assert heyoka is not None
    w = heyoka.make_vars("w1", "w2", "w3")
    integrator = heyoka.taylor_adaptive(
        list(zip(w, problem.rate(DELTA, w), strict=True)),
        np.zeros(3, np.longdouble),
        fp_type=np.longdouble,
        tol=np.longdouble(1e-19),
    )
    ends = np.empty_like(omegas)
    for end, omega in zip(ends, omegas, strict=True):
        integrator.time = np.longdouble(0)
        integrator.state[:] = omega
        integrator.propagate_until(np.longdouble(TIME))
        end[:] = integrator.state
    return ends


def reference(omegas: Starts) -> tuple[Starts, str]:
    """The end states to compare with, and where they come from."""
    extended = np.finfo(np.longdouble).eps < 1e-18
    if heyoka is None or not extended:
        return _by_scipy(omegas), "scipy DOP853, rtol 1e-13: errors below 1e-12 mean little"
    ends = _in_long_double(omegas)
    few = omegas[:64]
    apart = np.max(np.abs(_by_scipy(few) - ends[: len(few)])) / AMPLITUDE
    about = f"heyoka in 80-bit arithmetic, tolerance 1e-19 (scipy DOP853 at 1e-13: {apart:.0e} off)"
    return ends, about


def compare(n: int, repeats: int, tolerances: tuple[float, ...] = TOLERANCES) -> dict[str, Any]:
    """Cost and true error of all methods at all tolerances."""
    omegas = starts(n)
    truth, about = reference(omegas)
    methods: dict[str, Callable[[float], Callable[[Starts], Starts]]] = {
        "dipoletop, native engine": lambda rtol: partial(by_lanes, rtol=rtol),
        f"the same, {measure.cores()} threads": (
            lambda rtol: partial(by_lanes_everywhere, rtol=rtol)
        ),
        "dipoletop, JAX engine": lambda rtol: partial(by_lanes, rtol=rtol, engine=lanes),
        "diffrax vmap, tuple": lambda rtol: partial(by_diffrax, rtol=rtol),
    }
    if heyoka is not None:
        heyoka.llvm_state.set_diskcache_enabled(False)  # everybody compiles
        methods["heyoka batch"] = heyoka_batch
    cases, first = {}, {}
    for name, prepare in methods.items():
        for rtol in tolerances:
            ready, clocks = measure.timed(lambda p=prepare, rtol=rtol: _warm(p(rtol), omegas))
            first.setdefault(name, clocks["seconds"])
            cases[name, rtol] = partial(_case, ready, omegas)
    records = measure.interleaved(cases, repeats)
    rows = [
        measure.summary(found) | {"name": name, "rtol": rtol} | _errors(found[0]["ends"], truth)
        for (name, rtol), found in records.items()
    ]
    return {"starts": n, "reference": about, "first_seconds": first, "rows": rows}


def _warm(advance: Callable[[Starts], Starts], omegas: Starts) -> Callable[[Starts], Starts]:
    advance(omegas)
    return advance


def _case(advance: Callable[[Starts], Starts], omegas: Starts) -> dict[str, Any]:
    ends, clocks = measure.timed(lambda: advance(omegas))
    return clocks | {"ends": ends}


def _errors(ends: Starts, truth: Starts) -> dict[str, float]:
    error = np.max(np.abs(ends - truth), axis=1) / AMPLITUDE
    return {"largest_error": float(np.max(error)), "median_error": float(np.median(error))}
