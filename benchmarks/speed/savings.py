"""The effect of each saving in steps and right-hand sides: counts, equal on every machine.

They are for one seeded sample of the mixed basin, unless a row says otherwise. Every tried step
counts; a right-hand side is one call for one start.
"""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers import end_states
from benchmarks.problems import mixed_basin
from benchmarks.speed import default_map, precision
from dipoletop import adaptive

RTOL = 1e-8
LATE = (0.9, 0.99)  # shares of the runs that have their value by the late times
SOLVERS = (diffrax.Bosh3(), diffrax.Tsit5(), diffrax.Dopri5(), diffrax.Dopri8())
ERRORS = tuple(10.0**-k for k in range(4, 13, 2))
BUDGET = 10_000_000  # steps of a run with a method of low order

Deltas = Float[np.ndarray, " n"]
Omegas = Float[np.ndarray, "n 3"]


def _row(name: str, saved: Any, plain: Any, starts: tuple[int, int], note: str) -> dict[str, Any]:
    """Steps and right-hand sides with the saving and without it."""
    row: dict[str, Any] = {"name": name, "note": note}
    for which, steps, many in zip(("with", "without"), (saved, plain), starts, strict=True):
        made = int(np.sum(steps))
        row[which] = {"steps": made, "evaluations": int(engines.evaluations(made, many))}
    return row


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
    """Runs that end when something is certain, or at one late time for all."""
    n, verdicts = len(omegas), dt.TransverseReduced(jnp.asarray(deltas))
    soon, later = (engines.integrate_tops(deltas, omegas, u, RTOL) for u in ("outcome", "value"))
    finished = np.asarray(later.status) == engines.FINISHED
    steps, valued = np.asarray(soon.steps), np.asarray(later.steps)
    at_once, many = steps == 0, int(np.sum(steps == 0))
    rows = []
    for share in LATE:
        late = float(np.quantile(np.asarray(later.t)[finished], share))
        fixed = engines.integrate_tops(deltas, omegas, "time", RTOL, t1=late)
        plain = np.asarray(fixed.steps)
        left = int(np.sum(np.asarray(verdicts.verdict(fixed.y).outcome) == dt.Outcome.UNDECIDED))
        when = f"all to τ = {late:.3g}, by when {share:.0%} have their value"
        open_ = f"{when}; {left} undecided there, with certain ends {int(np.sum(~finished))}"
        inside = f"{many} of {n} starts are in a region already; {when}"
        rows += [
            _row("end when the outcome is certain", steps, plain, (n, n), open_),
            _row("end when ω∞ is known to 1e-8", valued, plain, (n, n), when),
            _row("no step if decided", steps[at_once], plain[at_once], (many, many), inside),
        ]
        if share == LATE[0]:
            rows.append(_exact_sets(late))
    note = "`value=False` against `value=True`"
    return [*rows, _row("outcomes only, no ω∞", steps, valued, (n, n), note)]


def _exact_sets(late: float, n: int = 128) -> dict[str, Any]:
    """Count starts on the invariant sets, which have measure zero and are not in the sample."""
    deltas, omegas = mixed_basin.sample(2 * n)
    omegas[:n, 2] = 0.0  # keeps ω₁
    omegas[n:, :2] = 0.0  # the axis
    known = engines.integrate_tops(deltas, omegas, "value", RTOL)
    plain = engines.integrate_tops(deltas, omegas, "time", RTOL, t1=late)
    note = f"{n} starts with ω₃ = 0 and {n} along axis 3; all to τ = {late:.3g}"
    return _row("exact values on invariant sets", known.steps, plain.steps, (2 * n, 2 * n), note)


def by_refill(deltas: Deltas, omegas: Omegas, engine: str) -> list[dict[str, Any]]:
    """Count lane steps, including idle lanes, of refilled lanes against lockstep blocks."""
    n = len(omegas)
    ends = engines.integrate_tops(deltas, omegas, "outcome", RTOL, engine=engine)
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
    """Calls of the right-hand side that diffrax makes, without and with dense output."""
    calls: list[int] = []
    note = "diffrax's Dopri8, one start to τ = 1000, calls counted: its interpolation needs no more"
    row: dict[str, Any] = {"name": "no dense output", "note": note}

    def field(t: Any, y: Any, args: Any) -> Any:
        jax.debug.callback(lambda: calls.append(1))
        return jnp.stack(mixed_basin.rate(end_states.DELTA, y))

    ways = {"with": diffrax.SaveAt(t1=True), "without": diffrax.SaveAt(dense=True)}
    for name, saveat in ways.items():
        start = jnp.asarray(end_states.starts(1)[0])
        problem = diffrax.ODETerm(field), diffrax.Dopri8(), 0.0, end_states.TIME, None, start
        control = diffrax.PIDController(RTOL, RTOL * end_states.AMPLITUDE)
        solution = diffrax.diffeqsolve(*problem, saveat=saveat, stepsize_controller=control)
        jax.effects_barrier()
        row[name] = {"steps": int(solution.stats["num_steps"]), "evaluations": len(calls)}
        calls.clear()
    return row


def by_method(n: int, tolerances: list[float], solvers: tuple[Any, ...]) -> dict[str, Any]:
    """Right-hand sides for each start against the true error, at τ = 1000, for each method."""
    omegas, rows, crossings = end_states.starts(n), [], {}
    truth, about = end_states.reference(omegas)
    settings: Any = {"t1": end_states.TIME, "max_steps": BUDGET}
    for solver in solvers:
        mine = []
        for rtol in tolerances:
            deltas = np.full(n, end_states.DELTA)
            ends = engines.integrate_tops(deltas, omegas, "time", rtol, solver=solver, **settings)
            made = float(np.mean(np.asarray(ends.steps)))
            cost = {"steps": made, "evaluations": engines.evaluations(made, 1, solver)}
            error = precision.errors(np.asarray(ends.y.T), truth)
            mine.append({"solver": type(solver).__name__, "rtol": rtol} | cost | error)
        crossings[type(solver).__name__] = _crossings(mine)
        rows += mine
    about = {"starts": n, "reference": about, "errors": ERRORS}
    return about | {"rows": rows, "evaluations_at_error": crossings}


def _crossings(rows: list[dict[str, Any]]) -> list[float | None]:
    """Return right-hand sides at each of `ERRORS`, interpolated by power laws; None outside."""
    errors, costs = (np.log([r[k] for r in rows]) for k in ("median_error", "evaluations"))
    order = np.argsort(errors)
    costs_at = np.interp(np.log(ERRORS), errors[order], costs[order], left=np.nan, right=np.nan)
    return [None if np.isnan(x) else float(np.exp(x)) for x in costs_at]


def compare(small: bool) -> dict[str, Any]:
    """All savings, and which method is the cheapest."""
    n, points, fine, precise = (64, 8, 512, 16) if small else (32768, 128, 4096, 256)
    sample = mixed_basin.sample(n)
    rows = [by_symmetry(points), by_refinement(fine), *by_ending(*sample)]
    for engine in engines.NAMES[: 1 if small else 2]:
        rows += by_refill(*sample, engine)
    rows.append(by_dense_output())
    tolerances = [1e-3, 1e-6] if small else [10.0**-k for k in range(3, 13)]
    methods = by_method(precise, tolerances, SOLVERS[1::2] if small else SOLVERS)
    return {"starts": n, "rtol": RTOL, "rows": rows, "methods": methods}
