"""What derivatives cost, over the value alone in the same run, and their errors.

Numbers: [speed.json](speed.json). Command: `python benchmarks/run.py --write`.

Derivatives of ω∞ come from first variations. They are compared with central differences
(`accuracy/differences.py`) unless a line says otherwise.

- **In sweeps**: the mixed basin with ω∞, at most 4096 steps, without derivatives and with those
  by δ, by δ and ω₃, by δ, ω₃ and ω₁ (`derivatives=`); orders 2 to 4, which run away at large
  amplitudes, with a quarter of these amplitudes. Derivatives cost more steps, because a run goes
  on until they are certain too, and more for each step; a column gives the second part. Errors
  are relative, each derivative over its own size, against the same sweep at rtol 1e-13: median
  and 99 % quantile over the residual starts. The line without derivatives gives the errors of ω∞,
  which next to a boundary are large as well. "Residual, but none": starts that the sweep without
  derivatives calls residual and that have no derivative. Labels are compared where both sweeps
  decide; what the budget left undecided is in a column of its own.
- **Of one start**: `dt.residual_rotation`, jitted: its value, `jax.grad` by δ, by δ and ω₀, and
  `jax.hessian`; with `--large` also of a general body by its principal moments, its dipole's
  length and its start. There the tensor has nine entries, so nine variations, and the dipole
  three. The error is the largest over the largest element; a Hessian is compared with differences
  of a sweep's derivatives.
- **Over many rotations**: a general body at order 1, |ω₀| = 1, that radiates ever more weakly, so
  that it rotates ever more often before it is slow. A unit of time shorter by 1 + a makes ω₀ and
  ω∞ larger by 1 + a and |d|² smaller, so ∂ω∞/∂a = ω∞. Relative errors, of ω∞ against a sweep at
  rtol 1e-13. Those of a derivative grow about as the square of the number of rotations, since the
  phase difference between neighbouring bodies grows; they fall as the tolerance does.
- **Memory**: temporary memory of the compiled gradient by δ, as XLA reports it, for two budgets.
  The program is the same for every start; the table gives the steps of runs of different length.
  The last lines are a gradient through `simulate` with diffrax's `RecursiveCheckpointAdjoint`.
- **Of end states**: ω₁ at τ = 1000 by `simulate`, jitted: alone, with its derivative by δ
  (`jax.jvp`), and with all four by δ and ω₀ (`jax.value_and_grad`); one start, and 256 under
  `vmap`, which all wait for the slowest.
"""

from typing import Any

from benchmarks.reporting.speed import machine
from benchmarks.reporting.tables import ABSENT, Table, both_clocks, layout, number, pair, per_start


def body(results: dict[str, Any]) -> str:
    """All tables of this page."""
    return f"{machine(results)}\n\n{_tables(results['gradients'])}"


def _tables(scenes: dict[str, Any]) -> str:
    """A table for each scene."""
    starts = scenes["sweeps"][0]["starts"]
    title = f"## Derivatives in sweeps: mixed basin, {starts} starts, rtol {scenes['rtol']:.0e}"
    parts = [title, layout(_sweeps(scenes["sweeps"]), text=2)]
    parts += ["## Derivatives of one start, rtol 1e-10", layout(_single(scenes["single"]), text=2)]
    parts += [f"## Over many rotations: {scenes['turns'][0]['starts']} starts of a general body"]
    parts += [layout(_turns(scenes["turns"]))]
    parts += ["## Temporary memory of a gradient by δ", layout(_memory(scenes["memory"]))]
    return "\n\n".join(parts + _end(scenes["end"]))


def _sweeps(rows: list[dict[str, Any]]) -> Table:
    head = ["level", "engine", "derivatives", "µs/start, wall / processor"]
    head += ["× plain, wall / processor", "steps/start", "a step × plain, processor"]
    head += ["median error", "99 % error", "residual, but none", "undecided", "labels that differ"]
    table = [[*head, "first sweep, s"]]
    for row in rows:
        costs = [both_clocks(row), pair(row["over_plain"].values())]
        steps = [f"{row['steps']:.1f}", number(row["step_over_plain"])]
        errors = [f"{row[k]:.1e}" for k in ("median_error", "high_error")]
        counts = [str(row[k]) for k in ("missing", "undecided", "differ")]
        about = [row["level"], row["engine"], str(row["derivatives"])]
        table.append([*about, *costs, *steps, *errors, *counts, number(row["first_seconds"])])
    return table


def _single(rows: list[dict[str, Any]]) -> Table:
    head = ["level", "", "µs, wall, min / median", "µs, processor, median"]
    table = [[*head, "× ω∞, processor", "error", "compiled in, s"]]
    for row in rows:
        wall = pair(per_start(row, "seconds", w) for w in ("min", "median"))
        costs = [wall, number(per_start(row, "processor_seconds")), number(row["over_plain"])]
        compiled = number(row["compile_seconds"])
        table.append([row["of"], row["name"], *costs, f"{row['error']:.1e}", compiled])
    return table


def _turns(rows: list[dict[str, Any]]) -> Table:
    head = ["\\|d\\|²", "rtol", "steps/start, plain / by a"]
    table = [[*head, "error of ω∞, median / largest", "of ∂ω∞/∂a, median / largest"]]
    for row in rows:
        steps = " / ".join(f"{count:.0f}" for count in row["steps"])
        errors = [" / ".join(f"{e:.1e}" for e in row["errors"][k]) for k in ("value", "slope")]
        table.append([f"{row['strength']:g}", f"{row['rtol']:.0e}", steps, *errors])
    return table


def _memory(rows: list[dict[str, Any]]) -> Table:
    table = [["of", "max_steps", "bytes", "steps of runs that it did", "compiled in, s"]]
    for row in rows:
        served = ", ".join(map(str, row["steps"])) or ABSENT
        sizes = [str(row["max_steps"]), str(row["bytes"])]
        table.append([row["name"], *sizes, served, number(row["compile_seconds"])])
    return table


def _end(rows: list[dict[str, Any]]) -> list[str]:
    head = ["`simulate` to τ = 1000", "starts", "compiled and run once, s"]
    table = [[*head, "µs/start, wall, min / median", "× the end state"]]
    for row in rows:
        wall = pair(per_start(row, "seconds", w) for w in ("min", "median"))
        first, over = number(row["first_seconds"]), number(row["over_plain"])
        table.append([row["name"], str(row["starts"]), first, wall, over])
    apart = max(row["apart"] for row in rows)
    said = f"Derivatives by δ forwards and backwards differ by {apart:.0e} of the largest."
    return ["## Derivatives of an end state, rtol 1e-10", layout(table), said]
