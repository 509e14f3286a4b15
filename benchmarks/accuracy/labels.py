"""Are the labels right? Every verdict against long integration without verdicts (`long_runs.py`).

python -m benchmarks.accuracy.labels --n 300 --families closed       a look
python -m benchmarks.accuracy.labels --jobs 16 --into rows.jsonl     all; a line for each piece
python -m benchmarks.accuracy.labels --merge rows.jsonl --write      kept: results/labels.md
"""

import argparse
import concurrent.futures
import itertools
import json
import multiprocessing
import pathlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.accuracy.long_runs import RTOL, compare
from benchmarks.problems.random_bodies import FAMILIES, LEVELS, starts
from benchmarks.reporting import labels as page
from benchmarks.reporting import measure, pages
from dipoletop import Outcome, Stop

MANY = {"1": 4000, "semi": 4000, "2": 1000, "3": 500, "4": 250}  # starts of a general family
PIECE = {"1": 2000, "semi": 2000, "2": 1000, "3": 1000, "4": 1000}  # … computed together
COSTLY = ("4", "3", "2", "semi", "1")


class Piece(NamedTuple):
    """A part of a row; its starts depend on (seed, number) only."""

    level: str
    family: str
    n: int
    seed: int
    number: int
    budgets: tuple[int, int]


def pieces(args: argparse.Namespace) -> list[Piece]:
    """Return all the pieces, the longest first."""
    every = []
    for level, family in itertools.product(args.levels, args.families):
        closed = family == "closed"
        total = args.n or (20_000 if closed else MANY[level])
        size = min(total, 5000 if closed else PIECE[level])
        for k, first in enumerate(range(0, total, size)):
            n = min(size, total - first)
            every.append(Piece(level, family, n, args.seed, k, tuple(args.budget)))
    return sorted(every, key=lambda p: (p.family == "closed", COSTLY.index(p.level), p.number))


def counted(piece: Piece) -> dict[str, Any]:
    """Run a piece; `merged` adds integers over the pieces of a row and keeps the largest floats."""
    jax.config.update("jax_enable_x64", True)
    sample = starts(piece.family, piece.level, piece.n, (piece.seed, piece.number))
    closed = piece.family == "closed"
    c = compare(piece.level, sample, budgets=piece.budgets, closed=closed)
    decided, stop = c.outcome > 0, c.outcome == Outcome.STOP
    both = c.plain & ~c.wrong & ~stop
    off = np.where(both, np.abs(c.omega_inf / np.where(both, c.value, 1) - 1), 0)
    over = off / np.maximum(c.error, 10 * RTOL)
    kinds = {"rotating": c.stop == Stop.ROTATING, "wobbling": c.stop == Stop.WOBBLING}
    kinds["other"] = ~kinds["rotating"] & ~kinds["wobbling"]
    counts = {
        "n": np.ones_like(stop),
        "residual": decided & ~stop,
        **{f"stop_{name}": stop & kind for name, kind in kinds.items()},
        "undecided": c.outcome == Outcome.UNDECIDED,
        "failed": c.outcome == Outcome.FAILED,
        "certified": decided & c.certified,
        "plain": c.plain,
        "wrong": c.wrong,
        "steps": c.steps,
    }
    largest = {}
    for name, part in (("certified", c.certified), ("tested", ~c.certified)):
        largest[f"over_{name}"] = np.where(part, over, 0).max()
        largest[f"beyond_{name}"] = np.where(part & (over > 1), off, 0).max()
    return {
        "level": piece.level,
        "family": piece.family,
        **{name: int(values.sum()) for name, values in counts.items()},
        **{name: float(value) for name, value in largest.items()},
        "wrong_starts": [[piece.number, int(k)] for k in np.nonzero(c.wrong)[0]],
        "seconds": [float(s) for s in c.seconds],
    }


def results(todo: list[Piece], jobs: int) -> Iterator[dict[str, Any]]:
    """Yield the results of the pieces as they finish, in `jobs` processes."""
    if jobs == 1:
        yield from map(counted, todo)
        return
    fresh = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(jobs, mp_context=fresh) as pool:
        for done in concurrent.futures.as_completed([pool.submit(counted, p) for p in todo]):
            yield done.result()


def merged(results: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for each level and family."""
    rows: dict[Any, dict[str, Any]] = {}
    for piece in results:
        row = rows.setdefault((piece["level"], piece["family"]), {})
        for name, value in piece.items():
            if isinstance(value, float):
                row[name] = max(row.get(name, 0.0), value)
            elif isinstance(value, str):
                row[name] = value
            else:  # counts and lists; seconds are one pair for each piece
                row[name] = row[name] + value if name in row else value
    place = list(LEVELS).index, FAMILIES.index
    return [rows[key] for key in sorted(rows, key=lambda k: (place[0](k[0]), place[1](k[1])))]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--n", type=int, help="starts of every row; by default the full numbers")
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=list(LEVELS))
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--budget", type=int, nargs=2, default=(20_000, 60_000))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--into", type=pathlib.Path, help="append a line for each finished piece")
    parser.add_argument("--merge", type=pathlib.Path, nargs="+", help="no run: read such files")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    lines: list[dict[str, Any]] = []
    if args.merge:
        text = "".join(path.read_text(encoding="utf-8") for path in args.merge)
        lines = [json.loads(line) for line in text.splitlines()]
    else:
        run = {"command": measure.command(), "seed": args.seed, **measure.machine()}
        for line in itertools.chain([run], results(pieces(args), args.jobs)):
            lines.append(line)
            if args.into:
                with args.into.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line, ensure_ascii=False) + "\n")
    rows = merged(line for line in lines if "level" in line)
    print(page.table(rows))
    if args.write:
        runs = [line for line in lines if "command" in line]
        pages.save("labels", {"runs": runs, "rows": rows})


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
