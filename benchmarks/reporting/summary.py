"""The tables that a user reads first: comparisons with peers, and how right the results are."""

import itertools
import math
from typing import Any

from benchmarks.reporting.label_precision import DEFAULT, heyoka_at_equal_labels, total
from benchmarks.reporting.speed import BASE, FIRST_MAP, FRESH, LATER_MAP, OURS
from benchmarks.reporting.tables import CLOCKS, layout, megabytes, number, pair, per_start

PRECISION = 1e-10  # the tolerance of the derivatives in the table
RTOL = f"{PRECISION:.0e}"  # the same, as the derivatives have it
ERROR = 1e-9  # the largest error at which the costs of end states are compared
IN_JAX, HEYOKA, REPACKED = (FRESH[name] for name in ("jax", "heyoka", "diffrax"))
DRIVEN = {
    OURS: "native engine",
    IN_JAX: "JAX engine",
    HEYOKA: "heyoka, SIMD batches",
    REPACKED: "diffrax Dopri8, `vmap`, finished starts dropped",
    "diffrax vmap, tuple": "diffrax Dopri8, `vmap` of 512",
}
PAIRS = ((OURS, HEYOKA), (OURS, REPACKED), (IN_JAX, REPACKED))
"""Who is compared with whom."""

Line = tuple[str, str, str]
"""A question, its answer, and the page that has more."""
Comparison = tuple[str, str, str, str, str]
"""A question; dipoletop and a peer, how driven and their numbers; peer over dipoletop; the page."""


def body(results: dict[str, Any]) -> str:
    """Both tables; a question whose numbers were not measured yet is left out."""
    speed, lines = results["speed"], []
    compared = _outcomes(speed) if speed else []
    if results["label_precision"]:
        compared += _equal_labels(results["label_precision"])
    if speed:
        compared += [*_end_states(speed["precision"]), *_compilation(speed["basin"])]
        compared += [*_fresh(speed), _import(speed["import"])]
    parts = [("speed", _own_costs), ("label_precision", _lost), ("labels", _labels)]
    parts += [("stress", _stress), ("residual", _residual), ("slow_flow", _slow_flow)]
    parts += [("faults", _faults), ("explorer", _explorer)]
    for name, part in parts:
        if results[name]:
            lines += part(results[name])
    if results["derivatives"] and results["directions"]:
        lines += _derivatives(results["derivatives"], results["directions"])
    head = ["question", "dipoletop", "peer", "peer / dipoletop", "page"]
    before = ["", *(asked for asked, *_ in compared)]
    table = [  # a question is asked once
        ["" if asked == last else asked, *cells, f"[{page}](results/{page}.md)"]
        for last, (asked, *cells, page) in zip(before, compared, strict=False)
    ]
    answers = [[asked, answer, f"[{page}](results/{page}.md)"] for asked, answer, page in lines]
    return "\n\n".join(
        [
            "Wall times; the ratio by the wall's / the processor's clock. Above 1 dipoletop is better.",
            layout([head, *table], text=5),
            "Without a peer:",
            layout([["question", "answer", "page"], *answers], text=3),
        ]
    )


def _outcomes(results: dict[str, Any]) -> list[Comparison]:
    size, table = list(results["basin"]["tables"].items())[-1]
    cores, rtol = results["machine"]["cores"], results["basin"]["rtol"]
    outcomes = f"Outcomes of {size} starts, rtol {rtol:.0e} for all, {cores} cores, µs/start"
    rows = {row["name"]: row for row in table["rows"]}
    return [
        (outcomes, *_driven(ours, peer, *(_costs(rows[name]) for name in (ours, peer))), "speed")
        for ours, peer in PAIRS
        if ours in rows and peer in rows
    ]


def _first(costs: list[float]) -> str:
    return number(costs[0])


def _driven(
    ours: str, peer: str, costs: list[float], others: list[float], *, show: Any = _first
) -> tuple[str, str, str]:
    """The cells of a comparison, whose costs are numbers for each clock."""
    ratio = pair(b / a for a, b in zip(costs, others, strict=True))
    return f"{DRIVEN[ours]}: {show(costs)}", f"{DRIVEN[peer]}: {show(others)}", ratio


def _costs(row: dict[str, Any]) -> list[float]:
    return [per_start(row, clock) for clock in CLOCKS]


def _equal_labels(results: dict[str, Any]) -> list[Comparison]:
    ours, peer = heyoka_at_equal_labels(results["costs"]["rows"])
    if peer is None:
        return []
    mine, other, ratio = _driven(OURS, HEYOKA, _costs(ours), _costs(peer))
    cores, starts = results["cores"], ours["starts"]
    wrong = f"{ours['wrong']} and {peer['wrong']} of {starts}"
    asked = f"The same at equal labels ({wrong} wrong), {cores} cores, µs/start"
    other = other.replace(":", f", rtol {peer['rtol']:.0e}:", 1)
    return [(asked, mine.replace(":", f", {DEFAULT}:", 1), other, ratio, "label_precision")]


def _end_states(scene: dict[str, Any]) -> list[Comparison]:
    """Costs at equal largest error, between two tolerances by a power law."""

    def cost(name: str) -> list[float] | None:
        rows = sorted(
            (row for row in scene["rows"] if row["name"] == name),
            key=lambda row: row["largest_error"],
        )
        for low, high in itertools.pairwise(rows):
            if low["largest_error"] <= ERROR <= high["largest_error"]:
                ends = [math.log(row["largest_error"]) for row in (low, high)]
                part = (math.log(ERROR) - ends[0]) / ((ends[1] - ends[0]) or 1.0)
                both = zip(_costs(low), _costs(high), strict=True)
                return [a ** (1 - part) * b**part for a, b in both]
        return None

    asked = f"End states at τ = 1000 at equal error {ERROR:.0e}, 1 core, µs/start"
    lines = []
    for ours, peer in PAIRS:
        peer = peer.replace(REPACKED, "diffrax vmap, tuple")
        mine, other = cost(ours), cost(peer)
        if mine and other:
            lines.append((asked, *_driven(ours, peer, mine, other), "precision"))
    return lines


def _fresh(results: dict[str, Any]) -> list[Comparison]:
    """Fresh processes, from their start to outcomes, and their memory; older numbers have none."""
    scene = results.get("fresh_outcomes", {"rows": [], "starts": 0})
    rows = {FRESH[row["name"]]: row for row in scene["rows"]}
    asked = f"A fresh process to {scene['starts']} outcomes, the first time ever / later, s"
    times, sizes = [], []
    for ours, peer in PAIRS:
        if ours not in rows or peer not in rows:
            continue
        both = [rows[name] for name in (ours, peer)]
        clocks = [[row["first_seconds"], row["seconds"]["median"]] for row in both]
        times.append((asked, *_driven(ours, peer, *clocks, show=pair), "speed"))
        peaks = [[row["peak_bytes"]] for row in both]
        if all(peak for (peak,) in peaks):
            cells = _driven(ours, peer, *peaks, show=lambda peak: megabytes(*peak))
            sizes.append(("Memory of its processes, at most, MB", *cells, "speed"))
    return [*times, *sizes]


def _compilation(basin: dict[str, Any]) -> list[Comparison]:
    """What comes before the first labels in a process that has all imports."""
    size, table = next(iter(basin["tables"].items()))
    rows = {row["name"]: [row["first_seconds"]] for row in table["rows"]}
    asked = f"Compilation and start, before {size} outcomes, s"
    return [
        (asked, *_driven(ours, peer, rows[ours], rows[peer]), "speed")
        for ours, peer in PAIRS
        if ours in rows and peer in rows
    ]


def _import(times: dict[str, Any]) -> Comparison:
    name = next(iter(times))
    mine, other = (number(times[key]["seconds"]["median"]) for key in (name, BASE))
    ratio = pair(1 / times["ratio"][clock] for clock in CLOCKS)
    return "Importing, s", f"`{name}`: {mine}", f"`{BASE}`: {other}", ratio, "speed"


def _own_costs(results: dict[str, Any]) -> list[Line]:
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
    side = f"{results['maps'][0]['points']}²"
    return [
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


def _lost(results: dict[str, Any]) -> list[Line]:
    rows, lines = results["rows"], []
    for part, where in (("random", "at random"), ("near", "that close in on the boundary")):
        lost, starts = (total(rows, part, name) for name in ("lost", "decided"))
        asked = f"Labels wrong by two passes and right by one, starts {where}"
        lines.append((asked, f"{lost} of {starts}", "label_precision"))
    return lines


def _labels(results: dict[str, Any]) -> list[Line]:
    checked, wrong = (sum(row[name] for row in results["rows"]) for name in ("plain", "wrong"))
    answer = f"{wrong} of {checked}, orders 1 to 4 and semi-reduced, all kinds of body"
    return [("Wrong labels, against long integration", answer, "labels")]


def _faults(results: dict[str, Any]) -> list[Line]:
    """Kills, and what became of the stores."""
    rows = [*results["killed"], *results["cluster"]]
    kills, wrong, stores = (sum(x[k] for x in rows) for k in ("kills", "other_bytes", "stores"))
    asked = f"Stores that differ from undisturbed ones, after {kills} kills of their sweeps"
    return [(asked, f"{wrong} of {stores}", "faults")]


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


def _explorer(results: dict[str, Any]) -> list[Line]:
    answers = [
        f"{row['full']['median']:.0f} ms, 95 % within {row['full']['95%']:.0f} ms ({row['size']}²)"
        for row in results["rows"]
        if row["name"] == "part of it"
    ]
    question = "Explorer: from a slider to a picture without use of symmetries, in a browser"
    return [(question, "; ".join(answers), "explorer")]


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
