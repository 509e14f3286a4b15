"""Are the derivatives of motions right? Along random changes, against differences.

Numbers: [directions.json](directions.json). Command:

    python -m benchmarks.accuracy.directions --of semi --what motion    a look
    python -m benchmarks.accuracy.directions --write                    each kind kept here

One random change of everything that a problem depends on at once: δ and ω₀, or tensor, dipole and
ω₀. Differentiated are the end state at τ = 20 and the terms of the energy balance there
(`simulate(…, balance=True)`), the time in which half the energy is lost (`decay_time`), and ω∞
(`residual_rotation`). First derivatives are taken by `jax.jvp` and by `jax.vjp`, and the larger
error of the two is shown; second ones are `jax.jvp` of `jax.jvp`, compared with differences of
the first.

Starts are random with |ω₀| in 0.1 … 0.3 whose ω∞ is certain before τ = 1000; for decay times and ω∞
at full levels a fifth of them, so `--starts 500` makes 100. Errors are relative to the derivative
itself, which may be small along that change; **shown** counts the starts where differences agree to
1e-8. At rtol 1e-12 all errors are below that, too; at 1e-10 all but those of single starts.
"""

from typing import Any

from benchmarks.reporting.tables import Table, bullets, layout

ORDERS, RTOLS = ("first", "second"), ("1e-10", "1e-12")


def body(rows: list[dict[str, Any]]) -> str:
    """The table, and the commands that it came from."""
    return f"{table(rows)}\n\n{bullets(dict.fromkeys(row['run'] for row in rows))}"


def table(rows: list[dict[str, Any]]) -> str:
    """Median and largest error."""
    lines: Table = [["of", "what", "starts"]]
    for order in ORDERS:
        lines[0] += [f"{order}: shown", *(f"rtol {rtol}" for rtol in RTOLS), "differences"]
    for row in rows:
        line = [row["of"], row["what"], str(row["starts"])]
        for order in ORDERS:
            errors = [row[order][name] for name in (*RTOLS, "apart")]
            line += [str(row[order]["shown"])]
            line += [f"{error['median']:.1e} / {error['largest']:.1e}" for error in errors]
        lines.append(line)
    return layout(lines, text=2)
