"""The table that a user reads first: one line for each question, made of all the numbers."""

from typing import Any

from benchmarks.reporting.speed import BASE, FIRST_MAP, LATER_MAP
from benchmarks.reporting.tables import layout, number, pair, per_start

PRECISION = 1e-10  # the tolerance of the end states and derivatives in the table
RTOL = f"{PRECISION:.0e}"  # the same, as the derivatives have it

Line = tuple[str, str, str]
"""A question, its answer, and the page that has more."""


def body(results: dict[str, Any]) -> str:
    """The table; a question whose numbers were not measured yet is left out."""
    parts = [("speed", _speed), ("labels", _labels), ("stress", _stress), ("residual", _residual)]
    parts.append(("slow_flow", _slow_flow))
    lines = []
    for name, part in parts:
        if results[name]:
            lines += part(results[name])
    if results["derivatives"] and results["directions"]:
        lines += _derivatives(results["derivatives"], results["directions"])
    linked = [[asked, answer, f"[{page}](results/{page}.md)"] for asked, answer, page in lines]
    return layout([["question", "answer", "page"], *linked], text=3)


def _speed(results: dict[str, Any]) -> list[Line]:
    size, table = list(results["basin"]["tables"].items())[-1]
    ends = [row for row in results["precision"]["rows"] if row["rtol"] == PRECISION]
    outcome_costs = _costs(table["rows"], "heyoka batch", "diffrax vmap repacked, tuple")
    end_costs = _costs(ends, "heyoka batch", "diffrax vmap, tuple")
    maps = {
        row["engine"]: number(row["later"]["seconds"]["median"])
        for row in results["maps"]
        if row["level"] == "semi-reduced"
    }
    factors = [
        pair(
            row["over_plain"]["seconds"]
            for row in results["gradients"]["sweeps"]
            if row["engine"] == "native" and row["level"] == level and row["derivatives"]
        )
        for level in ("order-1", "semi")
    ]
    derivative_costs = f"× {factors[0]} (order 1), × {factors[1]} (semi-reduced)"
    ratio, cores = results["import"]["ratio"]["seconds"], results["machine"]["cores"]
    side = f"{results['maps'][0]['points']}²"
    return [
        (f"Outcomes of {size} starts, µs per start ({cores} cores)", outcome_costs, "speed"),
        (f"End states at τ = 1000, rtol {RTOL}, µs per start (1 core)", end_costs, "precision"),
        (
            f"A map of {side} starts with ω∞, semi-reduced, a later sweep",
            f"{maps['native']} s native, {maps['jax']} s JAX",
            "speed",
        ),
        (
            "Time of a sweep with 1 / 2 / 3 derivatives, over that without",
            derivative_costs,
            "derivative_costs",
        ),
        (f"`{next(iter(results['import']))}`", f"{ratio:.2f} times `{BASE}`", "speed"),
        *_cold_start(results),
    ]


def _cold_start(results: dict[str, Any]) -> list[Line]:
    """The first map of a process, beside the imports; older numbers are without it."""
    if "cold_start" not in results:
        return []
    ratios = results["cold_start"]["ratio"]
    first, later = (f"{ratios[name]['seconds']:.1f}" for name in (FIRST_MAP, LATER_MAP))
    answer = f"{later} times the time of its imports; the first time ever {first} times"
    return [("`dipoletop map` in a fresh process", answer, "speed")]


def _costs(rows: list[dict[str, Any]], *peers: str) -> str:
    """Microseconds per start by both engines, and by those of the peers that were measured."""
    costs = {row["name"]: number(per_start(row, "seconds")) for row in rows}
    ours = [f"{costs[f'dipoletop, {engine} engine']} {engine}" for engine in ("native", "JAX")]
    others = [f"{peer} {costs[peer]}" for peer in peers if peer in costs]
    return "; ".join([f"dipoletop {', '.join(ours)}", *others])


def _labels(results: dict[str, Any]) -> list[Line]:
    checked, wrong = (sum(row[name] for row in results["rows"]) for name in ("plain", "wrong"))
    answer = f"{wrong} of {checked}, orders 1 to 4 and semi-reduced, all kinds of body"
    return [("Wrong labels, against long integration", answer, "labels")]


def _stress(results: dict[str, Any]) -> list[Line]:
    checked, wrong = (sum(row[name] for row in results["blocks"]) for name in ("plain", "wrong"))
    wall = {row["rtol"]: row for row in results["wall"]["rows"] if row["engine"] == "native"}
    near = ", ".join(f"{wall[rtol]['farthest']:.0e} (rtol {rtol:.0e})" for rtol in (1e-4, 1e-8))
    starts = "Wrong labels of starts of every amplitude, order 1"
    return [
        (starts, f"{wrong} of {checked}", "stress"),
        ("Angle from the separatrix of the farthest wrong label", near, "stress"),
    ]


def _residual(results: dict[str, Any]) -> list[Line]:
    rows = [row for row in results["rows"] if "over" in row]
    total, wrong = (sum(row[name] for row in rows) for name in ("n", "wrong signs"))
    over = max(row["over"] for row in rows)
    answer = f"at most {over:.2f} times its estimate; {wrong} of {total} signs wrong"
    return [("Error of ω∞, against Taylor series in long double", answer, "residual")]


def _slow_flow(results: dict[str, Any]) -> list[Line]:
    random, rows = results["random"], results["bodies"]["rows"]
    every = [*rows, random["rows"][-1]]
    labels, wrong = (sum(row[name] for row in every) for name in ("labels", "wrong"))
    within = f"{random['within'] / random['compared']:.1%} of {random['compared']}"
    answer = f"{wrong} of {labels} labels wrong; {within} within the estimate"
    slowest = [row for row in results["costs"] if "steps" in row][-1]
    steps = f"{slowest['steps']:.0f} steps or one prediction ({1e3 * slowest['prediction']:.1f} ms)"
    return [
        ("Predictions by averaging, against integration turn by turn", answer, "slow_flow"),
        (f"Fate of a start with ω₀ = {slowest['amplitude']:.0e}", steps, "slow_flow"),
    ]


def _derivatives(first_and_second: dict[str, Any], along: list[dict[str, Any]]) -> list[Line]:
    rows = [row for order in ("first", "second") for row in first_and_second[order]]
    far, near = (
        max(row["off"][RTOL]["largest"] for row in rows if row["place"] == place)
        for place in ("far", "near")
    )
    of_values = f"{far:.0e} far from the boundary, {near:.0e} near it"
    middle = max(row[order][RTOL]["median"] for row in along for order in ("first", "second"))
    of_motions = f"medians at most {middle:.0e}"
    motions = f"Error of derivatives of motions, decay times, ω∞, rtol {RTOL}"
    return [
        (f"Largest relative error of derivatives of ω∞, rtol {RTOL}", of_values, "derivatives"),
        (motions, of_motions, "directions"),
    ]
