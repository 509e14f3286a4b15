"""Work and precision: end states at a fixed time, cost against true error.

Isotropic starts with |ω| = 0.2 of the top with δ = −1/5, at τ = 1000. The error is the largest
component of the difference from a reference, over |ω₀|.

A method is `prepare(omegas, rtol) -> task`: what depends on the problem and the tolerance is made
once, and the task, which gives the end states, is what is timed. Everybody has one core, in a
process that was given no other, for XLA counts them once: `python benchmarks/bench_precision.py
16384 7 1e-6 1e-9` prints one line of JSON.
"""

import functools
import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float
from scipy.integrate import solve_ivp

import dipoletop as dt
import measure
import problem
from dipoletop._engines.interface import Engine, Limits
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine

try:
    import heyoka
except ImportError:
    heyoka = None

DELTA, AMPLITUDE, TIME = -0.2, 0.2, 1000.0
TOLERANCES = tuple(10.0**-k for k in range(6, 13))
MAX_STEPS = 4096
CHUNK = 512  # starts in one vmap of diffrax: the fastest of 32, 128, 512 and 4096
SCIPY = "scipy DOP853"  # so slow that a few starts, once, must do
FEW = 64

Starts = Float[np.ndarray, "n 3"]
Task = Callable[[], Starts]
Method = Callable[[Starts, float], Task]


def starts(n: int) -> Starts:
    """Isotropic starts; the i-th does not depend on how many there are."""
    return problem.isotropic(n, AMPLITUDE)


def by_lanes(omegas: Starts, rtol: float, engine: Engine | None = None) -> Task:
    """dipoletop, all starts in the queue of an engine."""
    size = len(omegas)
    atol, ends = jnp.full(size, rtol * AMPLITUDE), jnp.full(size, TIME)
    limits = Limits(jnp.asarray(rtol), atol, ends, jnp.asarray(MAX_STEPS))
    equation = dt.TransverseReduced(jnp.full(size, DELTA))
    engine = engine or NativeEngine()

    def advance() -> Starts:
        begun = omegas.T if isinstance(engine, NativeEngine) else jnp.asarray(omegas.T)
        return np.asarray(engine.end_states(equation, begun, limits, until="time").y).T

    return advance


@functools.cache
def _solver(as_tuple: bool) -> Callable[..., Any]:
    def field(t: Any, y: Any, delta: Any) -> Any:
        rate = problem.rate(delta, y)
        return rate if as_tuple else jnp.stack(rate)

    def solve(omega: Any, delta: Any, rtol: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            0.0,
            TIME,
            None,
            tuple(omega) if as_tuple else omega,
            args=delta,
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * AMPLITUDE),
            adjoint=diffrax.ForwardMode(),
            max_steps=MAX_STEPS,
            throw=False,
        )
        end = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
        return jnp.stack(end) if as_tuple else end

    return jax.jit(jax.vmap(solve, in_axes=(0, None, None)))


def by_diffrax(omegas: Starts, rtol: float, as_tuple: bool) -> Task:
    """diffrax, Dopri8 under vmap, the state a tuple of scalars or a vector (3,)."""
    chunks = range(0, len(omegas), CHUNK)
    solve = _solver(as_tuple)
    return lambda: np.concatenate([solve(omegas[k : k + CHUNK], DELTA, rtol) for k in chunks])


def heyoka_batch(omegas: Starts, rtol: float) -> Task:
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

    def advance() -> Starts:
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


def heyoka_scalar(omegas: Starts, rtol: float) -> Task:
    """heyoka, one start after another, scaled as in batch mode."""
    assert heyoka is not None
    y = heyoka.make_vars("y1", "y2", "y3")
    integrator = heyoka.taylor_adaptive(
        list(zip(y, problem.rate(DELTA, y, AMPLITUDE), strict=True)),
        np.zeros(3),
        tol=rtol,
        compact_mode=False,
        fast_math=True,
    )

    def advance() -> Starts:
        ends = omegas / AMPLITUDE
        state = integrator.state  # a view
        for end in ends:
            state[:] = end
            integrator.time = 0.0
            integrator.propagate_until(AMPLITUDE * TIME)
            end[:] = state
        return AMPLITUDE * ends

    return advance


def by_scipy(omegas: Starts, rtol: float) -> Task:
    """scipy's DOP853, one start after another, the first few of them."""

    def end(omega: Any) -> Any:
        def rate(t: float, y: Any) -> Any:
            return problem.rate(DELTA, y)

        span, scale = (0.0, TIME), rtol * AMPLITUDE
        return solve_ivp(rate, span, omega, method="DOP853", rtol=rtol, atol=scale).y[:, -1]

    return lambda: np.array([end(omega) for omega in omegas[:FEW]])


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
    """The end states to compare with, and where they come from; of a few without heyoka."""
    few = by_scipy(omegas, 1e-13)()
    extended = np.finfo(np.longdouble).eps < 1e-18
    if heyoka is None or not extended:
        return few, f"scipy DOP853, rtol 1e-13, {len(few)} starts: errors below 1e-12 mean little"
    ends = _in_long_double(omegas)
    apart = np.max(np.abs(few - ends[: len(few)])) / AMPLITUDE
    about = f"heyoka in 80-bit arithmetic, tolerance 1e-19 (scipy DOP853 at 1e-13: {apart:.0e} off)"
    return ends, about


def methods() -> tuple[dict[str, Method], list[str]]:
    """Everybody who can take part here by name, and a line for each who cannot."""
    found: dict[str, Method] = {
        "dipoletop, native engine": by_lanes,
        "dipoletop, JAX engine": partial(by_lanes, engine=JaxEngine()),
        "diffrax vmap, tuple": partial(by_diffrax, as_tuple=True),
        "diffrax vmap, (3,)": partial(by_diffrax, as_tuple=False),
    }
    missing = []
    if heyoka is None:
        missing.append("heyoka: left out (not installed)")
    else:
        heyoka.llvm_state.set_diskcache_enabled(False)  # everybody compiles
        found |= {"heyoka batch": heyoka_batch, "heyoka scalar": heyoka_scalar}
    try:
        peer: Any = importlib.import_module("peer_numbalsoda")
    except ImportError as error:
        missing.append(f"numbalsoda: left out ({error})")
    else:
        given = {"delta": DELTA, "amplitude": AMPLITUDE, "time": TIME}
        for name in peer.SOLVERS:
            found[f"numbalsoda {name}"] = partial(peer.prepare, solver=name, **given)
    return found | {SCIPY: by_scipy}, missing


def alone(n: int, repeats: int, tolerances: tuple[float, ...] = TOLERANCES) -> dict[str, Any]:
    """`compare` in a process with one core."""
    command = [sys.executable, __file__, *map(str, (n, repeats, *tolerances))]
    with measure.confined(1):
        run = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(run.stdout)


def compare(n: int, repeats: int, tolerances: tuple[float, ...]) -> dict[str, Any]:
    """Cost and true error of all methods at all tolerances."""
    omegas = starts(n)
    truth, about = reference(omegas)
    everybody, missing = methods()
    cases, first = {}, {}
    for name, prepare in everybody.items():
        for rtol in tolerances:
            ready, clocks = measure.timed(lambda p=prepare, rtol=rtol: _warm(p(omegas, rtol)))
            first.setdefault(name, clocks["seconds"])
            cases[name, rtol] = partial(_case, ready)
    slow = tuple(case for case in cases if case[0] == SCIPY)
    records = measure.interleaved(cases, repeats, once=slow)
    rows = [
        measure.summary(found) | {"name": name, "rtol": rtol} | _errors(found[0]["ends"], truth)
        for (name, rtol), found in records.items()
    ]
    about = {"starts": n, "repeats": repeats, "reference": about, "missing": missing}
    return about | {"scipy": scipy.__version__, "first_seconds": first, "rows": rows}


def _warm(task: Task) -> Task:
    task()
    return task


def _case(task: Task) -> dict[str, Any]:
    ends, clocks = measure.timed(task)
    return clocks | {"ends": ends}


def _errors(ends: Starts, truth: Starts) -> dict[str, float]:
    """Over the starts that both have."""
    both = min(len(ends), len(truth))
    return {"starts": len(ends)} | errors(ends[:both], truth[:both])


def errors(ends: Starts, truth: Starts) -> dict[str, float]:
    """The largest and the median error of all starts."""
    error = np.max(np.abs(ends - truth), axis=1) / AMPLITUDE
    return {"largest_error": float(np.max(error)), "median_error": float(np.median(error))}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    print(json.dumps(compare(int(sys.argv[1]), int(sys.argv[2]), tuple(map(float, sys.argv[3:])))))
