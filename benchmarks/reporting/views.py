"""What pages show beside the numbers themselves and sums over them: one function for a file."""

import itertools
import math
from collections.abc import Callable, Iterable
from operator import itemgetter
from typing import Any

from benchmarks.reporting.render import Rows, fill

Row = dict[str, Any]
OURS, IN_JAX = "dipoletop, native engine", "dipoletop, JAX engine"
HEYOKA, REPACKED = "heyoka batch", "diffrax vmap repacked, tuple"
DEFAULT = "default, two passes"
DRIVEN = {
    OURS: "native engine",
    IN_JAX: "JAX engine",
    HEYOKA: "heyoka, SIMD batches",
    REPACKED: "diffrax Dopri8, `vmap`",
}
KNOWN = {"native": OURS, DEFAULT: OURS, "jax": IN_JAX, "heyoka": HEYOKA}
KNOWN |= {"diffrax": REPACKED, "diffrax vmap, tuple": REPACKED}
PAIRS = ((OURS, HEYOKA), (OURS, REPACKED), (IN_JAX, REPACKED))
"""Who is compared with whom in the summary; in some files they have other names."""
ERROR = 1e-9  # the largest error at which the costs of end states are compared
TILE, LARGEST, MANY = 16_384, 1 << 20, 65_536  # see `Tiling.of_sweep`


def _over(costs: list[float], base: list[float]) -> list[float]:
    return [a / b for a, b in zip(costs, base, strict=True)]


def _speed(of: Row) -> Row:
    basin, imports = of["basin"], of["import"]
    basin["rows"] = []
    for size, table in basin["tables"].items():
        for row in table["rows"]:
            over = _over(row["us"], table["rows"][0]["us"])
            basin["rows"].append(row | {"size": size, "over": over})
    of["imports"] = [{"name": key} | row for key, row in imports.items() if key != "ratio"]
    of["imports"][0]["ratio"] = imports["ratio"]
    of["factors"] = {level: [] for level in ("order-1", "semi")}
    for row in of["gradients"]["sweeps"]:
        if row["engine"] == "native" and row["level"] in of["factors"] and row["derivatives"]:
            of["factors"][row["level"]].append(row["over_plain"]["seconds"])
    return of


def _default_path(of: Row) -> Row:
    return {"run": of} | of


def _labels(of: Row) -> Row:
    for row in of["rows"]:
        decided = row["residual"] + sum(row[f"stop_{k}"] for k in ("rotating", "wobbling", "other"))
        row |= {"share": row["certified"] / max(decided, 1), "mean": row["steps"] / row["n"]}
    return of


def _label_precision(of: Row) -> Row:
    parts = {
        part: Rows(row[part] for row in of["rows"] if row[part]) for part in ("random", "near")
    }
    for row in itertools.chain(*parts.values()):
        row["share"] = row["again"] / row["starts"]
        row["shown"] = row["margin"] if row["wrong_first"] else None
    rows = of["costs"]["rows"]
    default = next(row for row in rows if row["name"] == DEFAULT)
    good = sorted(
        (row for row in rows if row["wrong"] <= default["wrong"]), key=lambda row: row["rtol"]
    )
    loosest = {row["name"]: row | {"over": _over(row["us"], default["us"])} for row in good}
    return of | parts | {"as_good": list(loosest.values())}


def _residual(of: Row) -> Row:
    return of | {"known": Rows(row for row in of["rows"] if "over" in row)}


def _derivatives(of: Row) -> Row:
    rows = [{"order": order} | row for order in ("first", "second") for row in of[order]]
    worst = {
        place: max(
            (row["off"]["1e-10"]["largest"] for row in rows if row["place"] == place), default=None
        )
        for place in ("far", "near")
    }
    return worst | {"rows": rows, "runs": list(dict.fromkeys(row["run"] for row in rows))}


def _stress(of: Row) -> Row:
    rows = [row for row in of["wall"]["rows"] if row["engine"] == "native"]
    return of | {"native": {f"{row['rtol']:.0e}": row for row in rows}}


def _slow_flow(of: Row) -> Row:
    random, bodies = of["random"], of["bodies"]
    return of | {
        "every": Rows([random["rows"]["last"], *bodies["rows"]]),
        "chance": [a + b for a, b in zip(bodies["signs"], random["signs"], strict=True)],
        "share": random["within"] / max(random["compared"], 1),
        "slowest": [row for row in of["costs"] if "steps" in row][-1],
    }


def _faults(of: Row) -> Row:
    disks = [of["full_disk"] | {"tiles": of["tiles"]}] if of["full_disk"]["mounted"] else []
    return of | {"disks": disks, "every": Rows([*of["killed"], *of["cluster"]])}


def _surveys(of: Row) -> Row:
    """Rates; costs of a tile; and what follows from them for surveys of several sizes."""
    overhead, speeds, ways, surveys = of["overhead"], [], [], []
    for way in ("sweep", "tally"):
        rates = [row[way]["starts"] / row[way]["seconds"]["min"] for row in of["rates"]]
        for row, rate in zip(of["rates"], rates, strict=True):
            share = rate / rates[0] / row["cores"]
            speeds.append({"way": way, "cores": row["cores"], "rate": rate, "efficiency": share})
        spent = {
            k: overhead[f"{way}, {k}"]["seconds"] / overhead["tiles"]
            for k in ("in memory", "in a store", "tasks")
        }
        store, task = (max(spent[k] - spent["in memory"], 0.0) for k in ("in a store", "tasks"))
        files, tile, cores = overhead[f"{way}, files"], TILE / rates[-1], of["rates"][-1]["cores"]
        ways.append(
            {"way": way, "memory": spent["in memory"], "store": store, "task": task, "files": files}
            | {"bytes": files["bytes"] / TILE, "share": spent["in memory"] / tile}
            | {"limit": cores * tile / store if store else math.inf}
        )
        for starts in (1e9, 1e12):
            size = max(TILE, min(2 ** math.ceil(math.log2(starts / MANY)), LARGEST))
            tiles, hours = starts / size, starts / rates[-1] / 3600
            kept = starts / TILE if way == "sweep" else tiles
            surveys.append(
                {"way": way, "starts": starts, "tiles": tiles, "hours": hours}
                | {"node": hours * cores / 64, "nodes": hours * cores / 6400}
                | {"writing": tiles * store / 3600, "gigabytes": kept * files["bytes"] / 1e9}
            )
    return of | {"speeds": speeds, "ways": ways, "surveys": surveys}


def of(name: str, numbers: Any) -> Row:
    """The numbers of a file, and what its pages show beside them."""
    function: Callable[[Any], Row] | None = globals().get(f"_{name}")
    return function(numbers) if function else numbers


def _at_error(name: str, rows: Iterable[Row]) -> list[Row]:
    """The cost at the largest error `ERROR`, between two tolerances by a power law."""
    for low, high in itertools.pairwise(sorted(rows, key=lambda row: row["largest_error"])):
        ends = [math.log(row["largest_error"]) for row in (low, high)]
        if ends[0] <= math.log(ERROR) <= ends[1]:
            part = (math.log(ERROR) - ends[0]) / ((ends[1] - ends[0]) or 1.0)
            costs = zip(low["us"], high["us"], strict=True)
            return [{"name": name, "us": [a ** (1 - part) * b**part for a, b in costs]}]
    return []


def _against(
    asked: str, page: str, rows: list[Row], cost: Callable[[Row], list[float]]
) -> list[Row]:
    """Comparisons of all pairs that were measured; a question is asked once."""
    costs = {KNOWN.get(row["name"], row["name"]): cost(row) for row in rows}
    pairs = [pair for pair in PAIRS if set(pair) <= costs.keys()]
    return [
        {"asked": "" if k else asked, "page": page, "ratio": _over(costs[peer], costs[ours])}
        | {"ours": fill(f"{DRIVEN[ours]}: {{0:/n}}", costs[ours])}
        | {"peer": fill(f"{DRIVEN[peer]}: {{0:/n}}", costs[peer])}
        for k, (ours, peer) in enumerate(pairs)
    ]


def _first_and_later(row: Row) -> list[float]:
    return [row["first_seconds"], row["seconds"]["median"]]


def summary(of: Row) -> Row:
    """The numbers of all files, and the comparisons with peers."""
    speed, fresh = of["speed"], of["speed"]["fresh_outcomes"]
    *_, last = (table["rows"] for table in speed["basin"]["tables"].values())
    labels, ends = of["label_precision"]["as_good"], []
    for name, rows in itertools.groupby(speed["precision"]["rows"], key=lambda row: row["name"]):
        ends += _at_error(name, rows)
    many = f"{last[0]['starts']} starts, {speed['cores']} cores, µs/start"
    begun, rtol = f"A fresh process to {fresh['starts']} outcomes", speed["basin"]["rtol"]
    at_error = f"End states at τ = 1000 at equal error {ERROR:.0e}, 1 core, µs/start"
    compared = [
        *_against(f"Outcomes at rtol {rtol:.0e} of {many}", "speed", last, itemgetter("us")),
        *_against(
            f"Outcomes at equal labels of {many}", "label_precision", labels, itemgetter("us")
        ),
        *_against(at_error, "precision", ends, itemgetter("us")),
        *_against(f"{begun}, first / later, s", "speed", fresh["rows"], _first_and_later),
    ]
    return of | {"compared": compared}
