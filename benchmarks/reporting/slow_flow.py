"""Is the prediction of slow motions right? Against the same motions turn by turn.

Numbers: [slow_flow.json](slow_flow.json). Command:

    python -m benchmarks.accuracy.slow_flow --small     a look
    python -m benchmarks.accuracy.slow_flow --write     all, kept here

`dt.predict` averages over free rotation. Here the same starts are integrated turn by turn with the
semi-reduced equation, which keeps all orders (rtol 1e-10; the label by `value=False`).

- **refused**: too fast to be averaged; the estimated error exceeds 0.5, and `predict` says so.
- **L∞/L₀**, **E**: relative differences of residual rotation, and of the energy at one time: the
  half time, or 30 braking times J₃³/(2κL₀²) if that is earlier, or 0.3 of them where the half time
  is a matter of chance. Prediction and run begin with the same ω₀, so they differ by the
  oscillations of a turn: the order is |ω|.
- **over**: the largest difference over `prediction.error`.
- **order**: the median of d ln(difference)/d ln|ω| between neighbouring amplitudes.

Runs that are out of steps have a label but no L∞/L₀. Captures of needles are a matter of chance:
their table compares distributions, with an L∞/L₀ too small to be known as 0. **off** is a deviation
in units of its standard error.

What the motions beyond the estimate have in common: all are energies, not one is a residual value.

- Dipoles on J₂, or 1e-3 off an axis, that start next to the separatrix or cross it. What is lost
  there depends on the phase.
- Dipoles off all axes. The torque across L tilts the rotation by an angle of the order |ω|, so the
  rates themselves change by such a part, whatever the phase. Near the axis of J₃ this part is
  −2n₁n₂n₃²Ω₃/(1 − n₃²) times 1/(J₃ − J₂) − 1/(J₃ − J₁), with κ = 1: it is large for thin bodies.
- Needles shortly before their capture. A turn about the long axis is then no longer fast, and
  averages over it are wrong by up to about 1/q, q = 2δ|ω₃|/ω⊥².
"""

from typing import Any

from benchmarks.reporting.tables import ABSENT, bullets, layout

Row = dict[str, Any]


def body(results: Row) -> str:
    """Sentences, tables, and the command that they came from."""
    random, rows = results["random"], results["bodies"]["rows"]
    parts = [
        _sentence(results),
        "## Forty bodies\n\n" + table(rows, ["family", "amplitude"]),
        "Orders:\n\n" + _orders(results["bodies"]["orders"]),
        f"## {random['rows'][-1]['n']} motions at random\n\n" + table(random["rows"], ["kind"]),
        f"Of {random['compared']} motions {random['within']} are within the estimate "
        f"({random['within'] / random['compared']:.1%}). The others:\n\n"
        + _beyond(random["beyond"]),
    ]
    optional = {"needles": _needles, "full": _full, "balance": _balance}
    parts += [make(results[name]) for name, make in optional.items() if results[name]]
    parts.append("## Cost\n\n" + _costs(results["costs"]))
    command = f"`{results['command']}`, {results['date']}, {results['cores']} cores"
    return "\n\n".join([*parts, bullets([command])])


def _sentence(results: Row) -> str:
    random = results["random"]
    every = [*results["bodies"]["rows"], random["rows"][-1]]
    labels, wrong, signs, against, failed = (
        sum(row[name] for row in every)
        for name in ("labels", "wrong", "signs", "wrong signs", "failed")
    )
    chance, along = (
        a + b for a, b in zip(results["bodies"]["signs"], random["signs"], strict=True)
    )
    text = f"{labels} labels: {wrong} wrong; {signs} known signs of ω∞: {against} wrong. "
    text += f"{failed} predictions failed. Of {chance} residual rotations whose sense is a matter "
    return text + f"of chance {along} are along the dipole."


def _cells(row: Row, name: str) -> list[str]:
    if name not in row:
        return ["0", *[ABSENT] * 3]
    found = row[name]
    sizes = [f"{found[key]:.0e}" for key in ("median", "largest")]
    return [str(found["n"]), *sizes, f"{found['over']:.2f}"]


def table(rows: list[Row], keys: list[str]) -> str:
    """A line for each family and amplitude, or for each kind of dipole."""
    head = [*keys, "motions", "refused", "wrong labels", "L∞/L₀", "median", "largest", "over"]
    lines = [[*head, "E", "median", "largest", "over"]]
    for row in rows:
        first = [f"{row[key]:g}" if key == "amplitude" else row[key] for key in keys]
        counts = [str(row[name]) for name in ("n", "refused", "wrong")]
        lines.append([*first, *counts, *_cells(row, "ratio"), *_cells(row, "energy")])
    return layout(lines)


def _orders(rows: list[Row]) -> str:
    lines = [["family", "L∞/L₀", "E"]]
    for row in rows:
        pair = (row["ratio"], row["energy"])
        lines.append([row["family"], *(ABSENT if v is None else f"{v:.2f}" for v in pair)])
    return layout(lines)


def _beyond(rows: list[Row]) -> str:
    if not rows:
        return "none."
    lines = [["dipole", "moments", "direction", "\\|ω\\|", "estimate", "L∞/L₀ over", "E over"]]
    for row in rows:
        vectors = [", ".join(f"{x:.3f}" for x in row[name]) for name in ("moments", "dipole")]
        overs = [
            ABSENT if row[name] != row[name] else f"{row[name]:.2f}" for name in ("ratio", "energy")
        ]
        lines.append([row["kind"], *vectors, f"{row['speed']:.1e}", f"{row['error']:.1e}", *overs])
    return layout(lines, text=3)


def _needles(rows: list[Row]) -> str:
    head = ["δ", "starts", "known", "residual: predicted", "found", "off"]
    head += ["mean of L∞/L₀ over its mean", "off", "below the quantiles .05, .25, .5, .75, .95"]
    lines = [head]
    for row in rows:
        shares = [f"{row['residual']:.3f}", f"{row['share']:.3f}", f"{row['share off']:+.1f}"]
        means = [f"{row['mean']:.3f}", f"{row['mean off']:+.1f}"]
        below = ", ".join(f"{share:.2f}" for share in row["below"])
        counts = [str(row[name]) for name in ("n", "known")]
        lines.append([f"{row['delta']:g}", *counts, *shares, *means, below])
    return "## Captures of needles, |ω| = 1e-3\n\n" + layout(lines)


def _full(rows: list[Row]) -> str:
    lines = [["\\|ω\\|", "starts", "wrong labels", "ω∞: full / semi-reduced − 1", "L∞/L₀", "over"]]
    for row in rows:
        values = [f"{row['between']:.0e}", f"{row['off']:.0e}", f"{row['over']:.2f}"]
        lines.append([f"{row['amplitude']:g}", str(row["n"]), str(row["wrong"]), *values])
    return "## The full equation\n\n" + layout(lines)


def _balance(rows: list[tuple[str, float]]) -> str:
    lines = [["family", "largest defect"], *([name, f"{value:.0e}"] for name, value in rows)]
    text = "## Energy balance\n\nE₀ − E∞ against ∫P dt, where P is the sum of the powers of "
    return text + "`dt.lines` along `prediction.history`:\n\n" + layout(lines)


def _costs(rows: list[Row]) -> str:
    head = ["\\|ω\\|", "steps of a run", "ms a run", "ms a prediction", "ratio"]
    lines = [head]
    for row in rows:
        run, one = row.get("seconds"), row.get("prediction")
        cells = [ABSENT if run is None else f"{row['steps']:.0f}"]
        cells += [ABSENT if t is None else f"{1e3 * t:.3g}" for t in (run, one)]
        ratio = ABSENT if run is None or one is None else f"{run / one:.2g}"
        lines.append([f"{row['amplitude']:.0e}", *cells, ratio])
    text = (
        "An asymmetric body (J = 0.6, 0.75, 1; dipole on J₃), isotropic starts. Runs are made in "
    )
    text += "one call on all cores, with rtol 1e-8, up to ω∞; predictions one by one.\n\n"
    return text + layout(lines)
