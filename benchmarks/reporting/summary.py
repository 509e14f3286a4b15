"""The table that a user reads first: one line for each question, made of all the numbers."""

from typing import Any

from benchmarks.reporting.speed import BASE
from benchmarks.reporting.tables import layout, number, per_start

PRECISION = 1e-10  # the tolerance of the end states and derivatives in the table
RTOL = f"{PRECISION:.0e}"  # the same, as the derivatives have it


def body(results: dict[str, Any]) -> str:
    """The table; a question whose numbers were not measured yet is left out."""
    parts = [("speed", _speed), ("labels", _labels), ("stress", _stress), ("residual", _residual)]
    lines = [["question", "answer", "page"]]
    for name, part in parts:
        if results[name]:
            lines += part(results[name])
    if results["derivatives"] and results["directions"]:
        lines += _derivatives(results["derivatives"], results["directions"])
    return layout(lines, text=3)


def _page(name: str) -> str:
    return f"[{name}](results/{name}.md)"


def _speed(results: dict[str, Any]) -> list[list[str]]:
    size, table = list(results["basin"]["tables"].items())[-1]
    costs = {row["name"]: number(per_start(row, "seconds")) for row in table["rows"]}
    ends = {
        row["name"]: number(per_start(row, "seconds"))
        for row in results["precision"]["rows"]
        if row["rtol"] == PRECISION
    }
    maps = {
        row["engine"]: number(row["later"]["seconds"]["median"])
        for row in results["maps"]
        if row["level"] == "semi-reduced"
    }
    sweeps = [row for row in results["gradients"]["sweeps"] if row["engine"] == "native"]
    factors = [
        " / ".join(
            number(row["over_plain"]["seconds"])
            for row in sweeps
            if row["level"] == level and row["derivatives"]
        )
        for level in ("order-1", "semi")
    ]
    ratio = results["import"]["ratio"]["seconds"]
    cores = results["machine"]["cores"]
    return [
        [
            f"Outcomes of {size} starts, µs per start ({cores} cores)",
            _row(costs, "heyoka batch", "diffrax vmap repacked, tuple"),
            _page("speed"),
        ],
        [
            f"End states at τ = 1000, rtol {PRECISION:.0e}, µs per start (1 core)",
            _row(ends, "heyoka batch", "diffrax vmap, tuple"),
            _page("precision"),
        ],
        [
            f"A map of {results['maps'][0]['points']}² starts with ω∞, semi-reduced, a later sweep",
            f"{maps['native']} s native, {maps['jax']} s JAX",
            _page("speed"),
        ],
        [
            "Time of a sweep with 1 / 2 / 3 derivatives, over that without",
            f"× {factors[0]} (order 1), × {factors[1]} (semi-reduced)",
            _page("derivative_costs"),
        ],
        [
            "`import dipoletop`",
            f"{ratio:.2f} times `{BASE}`",
            _page("speed"),
        ],
    ]


def _row(costs: dict[str, str], *peers: str) -> str:
    ours = [f"{costs[f'dipoletop, {engine} engine']} {engine}" for engine in ("native", "JAX")]
    others = [f"{peer} {costs[peer]}" for peer in peers if peer in costs]
    return "; ".join([f"dipoletop {', '.join(ours)}", *others])


def _labels(results: dict[str, Any]) -> list[list[str]]:
    checked, wrong = (sum(row[name] for row in results["rows"]) for name in ("plain", "wrong"))
    answer = f"{wrong} of {checked}, orders 1 to 4 and semi-reduced, all kinds of body"
    return [["Wrong labels, against long integration", answer, _page("labels")]]


def _stress(results: dict[str, Any]) -> list[list[str]]:
    checked, wrong = (sum(row[name] for row in results["blocks"]) for name in ("plain", "wrong"))
    wall = {row["rtol"]: row for row in results["wall"]["rows"] if row["engine"] == "native"}
    near = ", ".join(f"{wall[rtol]['farthest']:.0e} (rtol {rtol:.0e})" for rtol in (1e-4, 1e-8))
    return [
        [
            "Wrong labels of starts of every amplitude, order 1",
            f"{wrong} of {checked}",
            _page("stress"),
        ],
        ["Angle from the separatrix of the farthest wrong label", near, _page("stress")],
    ]


def _residual(results: dict[str, Any]) -> list[list[str]]:
    rows = [row for row in results["rows"] if "over" in row]
    total, wrong = (sum(row[name] for row in rows) for name in ("n", "wrong signs"))
    over = max(row["over"] for row in rows)
    answer = f"at most {over:.2f} times its estimate; {wrong} of {total} signs wrong"
    return [["Error of ω∞, against Taylor series in long double", answer, _page("residual")]]


def _derivatives(first_and_second: dict[str, Any], along: list[dict[str, Any]]) -> list[list[str]]:
    rows = [row for order in ("first", "second") for row in first_and_second[order]]
    worst = {
        place: max(row["off"][RTOL]["largest"] for row in rows if row["place"] == place)
        for place in ("far", "near")
    }
    answer = f"{worst['far']:.0e} far from the boundary, {worst['near']:.0e} near it"
    middle = max(row[order][RTOL]["median"] for row in along for order in ("first", "second"))
    return [
        [
            f"Largest relative error of derivatives of ω∞, rtol {RTOL}",
            answer,
            _page("derivatives"),
        ],
        [
            f"Error of derivatives of motions, decay times, ω∞, rtol {RTOL}",
            f"medians at most {middle:.0e}",
            _page("directions"),
        ],
    ]
