"""The effect of each saving in steps and right-hand sides: counts, equal on every machine.

They are for one seeded sample of the mixed basin, unless a row says otherwise. Every tried step
counts; a right-hand side is one call for one start.
"""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers import end_states
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.speed import default_map, precision
from dipoletop import adaptive

RTOL = 1e-8
LATE = (0.9, 0.99)  # shares of the runs that have their value by the late times
SOLVERS = (diffrax.Bosh3(), diffrax.Tsit5(), diffrax.Dopri5(), diffrax.Dopri8())
TOLERANCES = tuple(10.0**-k for k in range(3, 13))
ERRORS = tuple(10.0**-k for k in range(4, 13, 2))
BUDGET = 10_000_000  # steps of a run with a method of low order

Deltas = Float[np.ndarray, " n"]
Omegas = Float[np.ndarray, "n 3"]


class Sizes(NamedTuple):
    """Sizes of the measurement."""

    starts: int = 32768
    points: int = 128
    """Number of points on each axis of the map's symmetry cell."""
    fine: int = 4096
    """Number of points on each axis of the refined map."""
    precise: int = 256
    """Number of starts for the comparison of methods."""
    tolerances: tuple[float, ...] = TOLERANCES
    solvers: tuple[Any, ...] = SOLVERS
    engines: tuple[str, ...] = engines.NAMES
    dense: bool = True


FEW = Sizes(
    starts=64,
    points=8,
    fine=512,
    precise=16,
    tolerances=(1e-3, 1e-6),
    solvers=(diffrax.Tsit5(), diffrax.Dopri8()),
    engines=("native",),
    dense=False,
)


def integrate(
    deltas: Deltas,
    omegas: Omegas,
    until: str,
    *,
    rtol: float = RTOL,
    t1: float = np.inf,
    engine: str = "native",
    max_steps: int = mixed_basin.MAX_STEPS,
    **settings: Any,
) -> engines.EndStates:
    """Integrate the starts in one queue of an engine."""
    y0 = jnp.asarray(omegas.T)
    atol, last = rtol * jnp.linalg.norm(y0, axis=0), jnp.full(len(omegas), t1)
    bounds = engines.limits(rtol, atol, max_steps, last)
    equation = dt.TransverseReduced(jnp.asarray(deltas))
    return engines.integrate(engine, equation, y0, bounds, until=until, **settings)


def _row(name: str, saved: Any, plain: Any, starts: tuple[int, int], note: str) -> dict[str, Any]:
    """Return a row with steps and right-hand sides with and without the saving."""
    counts = {}
    for which, steps, many in zip(("with", "without"), (saved, plain), starts, strict=True):
        made = int(np.sum(steps))
        counts[which] = {"steps": made, "evaluations": int(measure.evaluations(made, many))}
    return {"name": name, "note": note} | counts


def by_symmetry(points: int) -> dict[str, Any]:
    """Count one symmetry cell of the default map against the whole plane of φ and ω₃."""
    cell = dt.symmetry_cell(points, points)
    w3, turn = cell.axes["w3"], cell.axes["phi"]
    plane = dt.Grid(w3=np.concatenate([-w3[:0:-1], w3]), phi=np.concatenate([turn, turn + np.pi]))
    part, whole = (default_map.sweep("order-1", g, -0.2, RTOL, "native") for g in (cell, plane))
    differ = int(np.sum(dt.plots.unfold(part).outcome != whole.outcome))
    note = f"the default map with value, {differ} of {whole.outcome.size} labels differ"
    sizes = part.outcome.size, whole.outcome.size
    return _row("one symmetry cell, not the whole plane", part.steps, whole.steps, sizes, note)


def by_refinement(points: int) -> dict[str, Any]:
    """Count a fine map refined only next to its boundaries against all of its runs."""
    grid = dt.symmetry_cell(points, points)
    whole = default_map.sweep("order-1", grid, -0.2, RTOL, "native")
    few = adaptive.refine(default_map.tops("order-1", -0.2), grid, rtol=RTOL, engine="native")
    runs, size = few.attrs["computed"], whole.outcome.size
    differ = int(np.sum(few.outcome != whole.outcome))
    off = np.nanmax(np.abs(few.omega_inf - whole.omega_inf)) / np.nanmax(np.abs(whole.omega_inf))
    fewer = f"{runs} of {size} starts, {size / runs:.0f} times fewer"
    note = f"{fewer}; {differ} labels differ, ω∞ by {off:.1e} of the largest at most"
    name = f"refined next to the boundaries only, {points} × {points}"
    return _row(name, few.steps, whole.steps, (runs, size), note)


def by_ending(deltas: Deltas, omegas: Omegas) -> list[dict[str, Any]]:
    """Count runs that end when a result is certain against runs to one late time."""
    n = len(omegas)
    soon, later = (integrate(deltas, omegas, until) for until in ("outcome", "value"))
    finished = np.asarray(later.status) == engines.FINISHED
    steps, valued = np.asarray(soon.steps), np.asarray(later.steps)
    at_once = steps == 0
    many = int(np.sum(at_once)), int(np.sum(at_once))
    rows = []
    for share in LATE:
        late = float(np.quantile(np.asarray(later.t)[finished], share))
        fixed = integrate(deltas, omegas, "time", t1=late)
        plain, open_ = np.asarray(fixed.steps), _undecided(deltas, fixed)
        when = f"all to τ = {late:.3g}, by when {share:.0%} have their value"
        left = f"{open_} undecided there, with certain ends {int(np.sum(~finished))}"
        inside = f"{many[0]} of {n} starts are in a region already"
        rows += [
            _row("end when the outcome is certain", steps, plain, (n, n), f"{when}; {left}"),
            _row("end when ω∞ is known to 1e-8", valued, plain, (n, n), when),
            _row("no step if decided", steps[at_once], plain[at_once], many, f"{inside}; {when}"),
        ]
        if share == LATE[0]:
            rows.append(_exact_sets(late))
    note = "`value=False` against `value=True`"
    return [*rows, _row("outcomes only, no ω∞", steps, valued, (n, n), note)]


def _undecided(deltas: Deltas, ends: engines.EndStates) -> int:
    """Return the number of undecided end states."""
    verdict = dt.TransverseReduced(jnp.asarray(deltas)).verdict(ends.y)
    return int(np.sum(np.asarray(verdict.outcome) == dt.Outcome.UNDECIDED))


def _exact_sets(late: float, n: int = 128) -> dict[str, Any]:
    """Count starts on the invariant sets, which have measure zero and are not in the sample."""
    deltas, omegas = mixed_basin.sample(2 * n)
    omegas[:n, 2] = 0.0  # keeps ω₁
    omegas[n:, :2] = 0.0  # the axis
    known, plain = integrate(deltas, omegas, "value"), integrate(deltas, omegas, "time", t1=late)
    note = f"{n} starts with ω₃ = 0 and {n} along axis 3; all to τ = {late:.3g}"
    name = "exact values on invariant sets"
    return _row(name, known.steps, plain.steps, (2 * n, 2 * n), note)


def by_refill(deltas: Deltas, omegas: Omegas, engine: str) -> list[dict[str, Any]]:
    """Count lane steps, including idle lanes, of refilled lanes against lockstep blocks."""
    n = len(omegas)
    ends = integrate(deltas, omegas, "outcome", engine=engine)
    steps, widths = np.asarray(ends.steps), engines.block_widths(engine, n)
    paid = int(engines.block_steps(ends) @ widths)
    sorted_ = steps[np.argsort(np.linalg.norm(omegas, axis=1))]
    ways = {
        f"blocks of {widths[0]} in lockstep": lockstep(steps, widths[0]),
        f"blocks of {widths[0]} in lockstep, sorted by amplitude": lockstep(sorted_, widths[0]),
        "one lockstep block of all": lockstep(steps, n),
    }
    name, made = f"lanes refilled, {engine} engine", f"{int(steps.sum())} lane steps needed; "
    return [_row(name, paid, plain, (n, n), made + way) for way, plain in ways.items()]


def lockstep(steps: Int[np.ndarray, " n"], width: int) -> int:
    """Return the lane steps of blocks that run until their slowest lane is finished."""
    blocks = np.pad(steps, (0, -len(steps) % width)).reshape(-1, width)
    return int(width * blocks.max(axis=1).sum())


def by_dense_output() -> dict[str, Any]:
    """Count diffrax's calls of the right-hand side without and with dense output."""
    start = end_states.starts(1)[0]
    calls: list[int] = []
    counts = {}
    controller = diffrax.PIDController(RTOL, RTOL * end_states.AMPLITUDE)

    def field(t: Any, y: Any, args: Any) -> Any:
        jax.debug.callback(lambda: calls.append(1))
        return jnp.stack(mixed_basin.rate(end_states.DELTA, y))

    ways = {"with": diffrax.SaveAt(t1=True), "without": diffrax.SaveAt(dense=True)}
    for name, saveat in ways.items():
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            0.0,
            end_states.TIME,
            None,
            jnp.asarray(start),
            saveat=saveat,
            stepsize_controller=controller,
        )
        jax.effects_barrier()
        counts[name] = {"steps": int(solution.stats["num_steps"]), "evaluations": len(calls)}
        calls.clear()
    note = "diffrax's Dopri8, one start to τ = 1000, calls counted: its interpolation needs no more"
    return {"name": "no dense output", "note": note} | counts


def by_method(n: int, tolerances: tuple[float, ...], solvers: tuple[Any, ...]) -> dict[str, Any]:
    """Count right-hand sides for each start against the true error at τ = 1000, by method."""
    omegas = end_states.starts(n)
    truth, about = end_states.reference(omegas)
    deltas, rows = np.full(n, end_states.DELTA), []
    settings: Any = {"t1": end_states.TIME, "max_steps": BUDGET}
    for solver in solvers:
        for rtol in tolerances:
            ends = integrate(deltas, omegas, "time", rtol=rtol, solver=solver, **settings)
            made = float(np.mean(np.asarray(ends.steps)))
            cost = {"steps": made, "evaluations": measure.evaluations(made, 1, solver)}
            error = precision.errors(np.asarray(ends.y.T), truth)
            rows.append({"solver": type(solver).__name__, "rtol": rtol} | cost | error)
    names = list(dict.fromkeys(row["solver"] for row in rows))
    crossings = {name: _crossings([r for r in rows if r["solver"] == name]) for name in names}
    about = {"starts": n, "reference": about, "errors": ERRORS}
    return about | {"rows": rows, "evaluations_at_error": crossings}


def _crossings(rows: list[dict[str, Any]]) -> list[float | None]:
    """Return right-hand sides at each of `ERRORS`, interpolated by power laws; None outside."""
    errors, costs = (np.log([r[k] for r in rows]) for k in ("median_error", "evaluations"))
    order = np.argsort(errors)
    costs_at = np.interp(np.log(ERRORS), errors[order], costs[order], left=np.nan, right=np.nan)
    return [None if np.isnan(x) else float(np.exp(x)) for x in costs_at]


def compare(sizes: Sizes) -> dict[str, Any]:
    """Count all savings, and find the cheapest method."""
    deltas, omegas = mixed_basin.sample(sizes.starts)
    rows = [by_symmetry(sizes.points), by_refinement(sizes.fine), *by_ending(deltas, omegas)]
    for engine in sizes.engines:
        rows += by_refill(deltas, omegas, engine)
    if sizes.dense:
        rows.append(by_dense_output())
    methods = by_method(sizes.precise, sizes.tolerances, sizes.solvers)
    return {"starts": sizes.starts, "rtol": RTOL, "rows": rows, "methods": methods}
