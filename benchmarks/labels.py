"""Are the labels right? Every verdict against long integration that knows no verdict.

Each run goes on from the state in which the verdict fell, with the same equation, until its end is
plain to see (`Settling.plain`, `compare`). The families are `closed`, the axisymmetric top with a
transverse dipole in its own closed forms, and general bodies; what the table says is in README.md.

    python benchmarks/labels.py --n 300 --families closed       a look
    python benchmarks/labels.py --jobs 16 --into rows.jsonl     everything; a line for each piece
    python benchmarks/labels.py --merge rows.jsonl --write      kept: README.md, results/labels.json
"""

import argparse
import concurrent.futures
import functools
import itertools
import json
import multiprocessing
import pathlib
import shlex
import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from dipoletop import lanes, native
from dipoletop._types import Outcome, Stop, Verdict
from dipoletop.bodies import Body
from dipoletop.equations.rigid import Reduced, SemiReduced
from dipoletop.equations.transverse import TransverseReduced, TransverseSemi

LEVELS = {"1": 1, "2": 2, "3": 3, "4": 4, "semi": None}
FAMILIES = ("transverse", "near", "asymmetric", "generic", "oblate", "closed")
MANY = {"1": 4000, "semi": 4000, "2": 1000, "3": 500, "4": 250}  # starts of a general family
PIECE = {"1": 2000, "semi": 2000, "2": 1000, "3": 1000, "4": 1000}  # … computed together
COSTLY = ("4", "3", "2", "semi", "1")
RTOL = 1e-8
HERE = pathlib.Path(__file__).parent
BEGIN, END = "<!-- labels -->", "<!-- end of labels -->"
# When is an end plain? See `Settling`.
ON_LINE, TURNS, WOBBLE = 1e-4, 30.0, 1e-12


class Starts(NamedTuple):
    """One body and one angular velocity for each run."""

    inertia: np.ndarray  # (N, 3, 3)
    dipole: np.ndarray  # (N, 3)
    omega: np.ndarray  # (N, 3)


class Shape(NamedTuple):
    """A body seen from its dipole."""

    axes: Any  # (3, 3, N): n along the dipole; then across it 2 and 3, principal there
    unit: Any  # |d|²/J, so that ω = unit Ω is the dimensionless angular velocity; J = n·In
    delta: Any  # 1 − J₃/J if the body is axisymmetric about 3 and n principal, otherwise NaN
    principal: Any  # whether n is a principal axis


def _strength(sample: Starts) -> np.ndarray:
    """|d|²."""
    return np.sum(sample.dipole**2, axis=1)


def shapes(sample: Starts) -> Shape:
    """By numpy, not by what the library does."""
    strength = _strength(sample)
    n = sample.dipole / np.sqrt(strength)[:, None]
    lever = np.einsum("nij,nj->ni", sample.inertia, n)
    moment = np.sum(n * lever, axis=1)
    across = np.eye(3) - n[:, :, None] * n[:, None, :]
    moments, vectors = np.linalg.eigh(across @ sample.inertia @ across)  # the lowest, 0, is n
    same = np.abs(moments / moment[:, None] - 1) < 1e-9
    principal = np.linalg.norm(lever - moment[:, None] * n, axis=1) < 1e-9 * moment
    swap = same[:, 2]  # the second axis is the one with the moment of the dipole's
    second = np.where(swap[:, None], vectors[:, :, 2], vectors[:, :, 1])
    third = np.where(swap[:, None], vectors[:, :, 1], vectors[:, :, 2])
    delta = 1 - np.where(swap, moments[:, 1], moments[:, 2]) / moment
    delta = np.where(principal & same.any(axis=1), delta, np.nan)
    axes = np.stack([n, second, third], axis=1)
    return Shape(axes, strength / moment, delta, principal)


class Settling(eqx.Module):
    """The same equation, which may also take for its verdict an end that is plain to see.

    RESIDUAL is plain on the line Ω ∥ d: |ω₂| and |ω₃| below ON_LINE·min(1, |ω₁|)·|ω₁|, so small
    that the motion is linear there, whose coefficients `compare` looks at. (For the transverse top
    the line attracts only where ω₃/ω₁² is of order one, so ω₃ ≪ ω₁ would not do.)

    STOP is never plain from |Ω| alone: any part of it can be lost before a capture. What else is
    asked depends on the body, and for the transverse top follows from its planar system.
    δ < 0: TURNS·(u + Mω₃²) ≤ 2|δω₃|, precession faster than radiation. Then the averages
    (4.13)–(4.15) hold but for 1/TURNS² and say d ln z = −{(3δ/2)u + δ³ω₃²}/(1−δ) dτ > 0 for
    z = ω₃/u: precession wins for ever, and a capture needs z of order one.
    δ > 0: z falls by the same law, as |Ω|^(3δ/(1−δ)), until radiation wins, and then the motion is
    that of (φ, z), where the line attracts all but a cycle round the section ω₁ = 0. What leaves
    that cycle's basin does so at a rate 2/(2+δ) in σ = ∫u dτ. While |Ω| falls to a part WOBBLE,
    ∫u dτ ≥ −ln WOBBLE, so what has not been captured by then is held but for a part of about
    1e-8 of starts near the edge. δ > ½ makes sure that little of the fall belongs to precession;
    below it no run that still moves counts as plain.
    Other bodies: see `compare`.
    """

    equation: Any
    shape: Shape
    rest: Any  # |Ω| that counts as fallen far enough, (N,)
    long: Any  # whether to judge by what is plain, (N,); otherwise by the verdict of the equation

    def __call__(self, t, y, args=None):
        return self.equation(t, y, args)

    def lift(self, omega0):
        return omega0

    def omega(self, y):
        return y

    def verdict(self, y):
        own = self.equation.verdict(y)
        return jax.tree.map(lambda a, b: jnp.where(self.long, a, b), self.plain(y), own)

    def plain(self, y):
        w1, w2, w3 = (jnp.sum(axis * y, axis=0) for axis in self.shape.axes)
        unit, d = self.shape.unit, self.shape.delta
        close = ON_LINE * jnp.minimum(1.0, unit * jnp.abs(w1)) * jnp.abs(w1)
        line = (jnp.maximum(jnp.abs(w2), jnp.abs(w3)) <= close) & (w1 != 0)
        drag = unit * (w1**2 + w2**2 + (1 + d + d**2) * w3**2)
        turns = 2 * jnp.abs(d * w3) >= TURNS * drag
        far = jnp.sqrt(w1**2 + w2**2 + w3**2) <= self.rest
        stop = far & (jnp.isnan(d) | (d > 0.5) | (turns & (d < 0)))
        outcome = jnp.where(line, Outcome.RESIDUAL, jnp.where(stop, Outcome.STOP, 0))
        return Verdict(outcome, w1, stop, jnp.zeros_like(outcome), jnp.zeros_like(w1))


@functools.cache
def _builder(order: int | None):
    def one(inertia, dipole):
        body = Body(inertia, dipole)
        return SemiReduced(body) if order is None else Reduced(body, order)

    return jax.jit(jax.vmap(one, out_axes=-1))


def equations(level: str, inertia, dipole, *, closed: bool = False):
    """A batch of equations, trailing lanes; `closed`: diag(1, 1, 1 − δ), dipole (1, 0, 0)."""
    if not closed:
        return _builder(LEVELS[level])(jnp.asarray(inertia), jnp.asarray(dipole))
    delta, order = jnp.asarray(1 - inertia[:, 2, 2]), LEVELS[level]
    return TransverseSemi(delta) if order is None else TransverseReduced(delta, order)


def moments(rng, n: int) -> np.ndarray:
    """Principal moments of real bodies, uniform in the triangle J₁+J₂+J₃ = 2; shape (n, 3)."""
    return 1 - rng.dirichlet(np.ones(3), n)  # from the moments of second order ⟨x_i²⟩ > 0


def random_rotations(rng, n: int) -> np.ndarray:
    """Rotation matrices (n, 3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def starts(family: str, level: str, n: int, seed: int | tuple[int, int] = 0) -> Starts:
    """Random bodies of one family with isotropic starts.

    Amplitudes |d|²|Ω|√tr(I⁻²) are log-uniform in 0.01 … 1, but end at 0.2 for the orders from 2 on,
    which diverge beyond.
    """
    rng = np.random.default_rng([*np.atleast_1d(seed), FAMILIES.index(family)])
    axis = np.eye(3)[rng.integers(0, 3, n)]
    j = moments(rng, n)
    turn = random_rotations(rng, n)
    if family in ("closed", "transverse"):
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), np.ones(n), 1 - rng.uniform(-0.98, 0.98, n)], axis=1)
    elif family == "near":
        delta, split = rng.uniform(-0.98, 0.98, n), 10 ** rng.uniform(-6, -1, n)
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), 1 + rng.choice([-1, 1], n) * split, 1 - delta], axis=1)
        j[:, 2] = np.clip(j[:, 2], np.abs(j[:, 1] - 1) * 1.01, (1 + j[:, 1]) * 0.999)
    elif family == "oblate":  # dipole on the smallest moment, both outcomes
        axis = np.eye(3)[np.zeros(n, int)]
        low = rng.uniform(0.41, 0.59, n)
        least = np.maximum(low, 1 - low) + 0.001
        j = np.stack([low, least + rng.uniform(0, 1, n) * (0.605 - least), np.ones(n)], axis=1)
    elif family == "generic":
        axis = rng.normal(size=(n, 3))
    if family == "closed":
        turn = np.broadcast_to(np.eye(3), turn.shape)
    else:
        axis = axis * (10 ** rng.uniform(-0.3, 0.3, n) / np.linalg.norm(axis, axis=1))[:, None]
    reach = np.sum(axis**2, axis=1) * np.sqrt(np.sum(1 / j**2, axis=1))
    top = 1.0 if level in ("1", "semi") else 0.2
    speed = 10 ** rng.uniform(-2, np.log10(top), n) / reach
    omega = rng.normal(size=(n, 3))
    omega *= (speed / np.linalg.norm(omega, axis=1))[:, None]
    inertia = np.einsum("nij,nj,nkj->nik", turn, j, turn)
    inertia = (inertia + inertia.transpose(0, 2, 1)) / 2
    dipole, omega = np.einsum("nij,knj->kni", turn, np.stack([axis, omega]))
    return Starts(inertia, dipole, omega)


@jax.jit
def _judge(equation, y):
    return equation.verdict(y)


@jax.jit
def _attracts(equation, line):
    """Whether the line attracts at w n, shape (3, N): by the Jacobian, one of whose rates is 0.

    Trace and sum of minors, the sum and the product of the other two rates, do not suffer from
    an element that is smaller than another by ω², as eigenvalues would.
    """
    jacobian = jax.vmap(jax.jacfwd(lambda v, e: e(0.0, v)), in_axes=(-1, -1))(line, equation)
    j = jnp.moveaxis(jacobian, 0, -1)
    pairs = ((0, 1), (0, 2), (1, 2))
    minors = sum(j[a, a] * j[b, b] - j[a, b] * j[b, a] for a, b in pairs)
    return (j[0, 0] + j[1, 1] + j[2, 2] < 0) & (minors > 0)


def _roundness(inertia: np.ndarray, y: Any) -> np.ndarray:
    """h = 2E/L² of Ω = y, shape (3, N)."""
    momentum = np.einsum("nij,jn->in", inertia, y)
    return np.sum(momentum * y, axis=0) / np.sum(momentum**2, axis=0)


class Comparison(NamedTuple):
    """What came out; arrays of shape (N,) but for the times."""

    outcome: np.ndarray
    stop: np.ndarray  # in which way, a `Stop`
    certified: np.ndarray
    omega_inf: np.ndarray
    error: np.ndarray
    final: np.ndarray  # label of the long run; 0: not plain within the budget
    value: np.ndarray  # n·Ω at the end of the long run
    steps: np.ndarray
    seconds: tuple[float, float]


def compare(
    level: str,
    sample: Starts,
    fall: float = 30.0,
    *,
    budgets: tuple[int, int] = (20_000, 60_000),
    closed: bool = False,
) -> Comparison:
    """Label the starts, go on to an end that is plain, and look again.

    Where the dipole is off every principal axis there is no line to be captured by. For other
    bodies than the transverse top, |Ω| fallen by `fall` is a plain STOP if the line attracts
    nothing at the largest n·Ω that the energy still allows, hence at no smaller one; or if the
    slow flow, which moves h = 2E/L² one way along a line, rises more slowly in the second half
    (of the fall's logarithm) than in the first: a repeller, behind which the capture would be,
    is left faster and faster. Free rotation waves h by a part |d|²|Ω|/J, which is let pass.
    """
    equation = equations(level, sample.inertia, sample.dipole, closed=closed)
    shape = jax.tree.map(lambda leaf: jnp.asarray(np.moveaxis(leaf, 0, -1)), shapes(sample))
    y = jnp.asarray(sample.omega.T)
    size, none = jnp.linalg.norm(y, axis=0), jnp.zeros(y.shape[1])

    begin = time.perf_counter()
    ends = _run(Settling(equation, shape, none, none > 0), y, limits(RTOL * size, budgets[0]))
    found = jax.device_get(_judge(equation, ends.y))
    middle = time.perf_counter()
    # From here on every component to its own size: ω₃ falls as ω², so nothing else would do.
    size = jnp.linalg.norm(ends.y, axis=0)
    settling, at, h = None, ends, [_roundness(sample.inertia, ends.y)]
    finished = np.ones(size.shape, bool)
    for part, steps in ((0.5, budgets[1] // 5), (1.0, budgets[1])):
        rest = size * jnp.where(shape.delta > 0, WOBBLE, 1 / fall) ** part
        settling = Settling(equation, shape, rest, none == 0)
        at = _run(settling, at.y, limits(1e-30 * size, steps))
        h.append(_roundness(sample.inertia, at.y))
        finished &= np.asarray(at.status) == 1
    judged = settling.plain(at.y)
    speed = jnp.linalg.norm(at.y, axis=0)
    most = np.sqrt(np.linalg.eigvalsh(sample.inertia)[:, 2] * shape.unit / _strength(sample))
    repels = ~_attracts(equation, (most * speed)[None] * shape.axes[0])
    slack = 2 * np.asarray(shape.unit * speed) * np.sqrt(fall)
    slows = h[2] - h[1] <= np.maximum((h[1] - h[0]) / 2, 0) + slack * h[1]
    stops = ~shape.principal | ~jnp.isnan(shape.delta) | repels | slows
    holds = _attracts(equation, judged.omega_inf[None] * shape.axes[0])
    sound = jnp.where(judged.outcome == Outcome.STOP, stops, holds) & finished
    outcome = np.where(np.asarray(ends.status) == 1, found.outcome, np.asarray(ends.status))
    return Comparison(
        outcome,
        *(found.stop, found.certified, found.omega_inf, found.error),
        np.asarray(jnp.where(sound, judged.outcome, 0)),
        np.asarray(judged.omega_inf),
        np.asarray(ends.steps),
        (middle - begin, time.perf_counter() - middle),
    )


def _run(equation, y, bounds: lanes.Limits) -> lanes.Ends:
    """By machine code, if the equation is not too long for it."""
    try:
        return native.integrate(equation, y, bounds, until="outcome")
    except native.Unsupported:
        return lanes.integrate(equation, y, bounds, until="outcome")


def limits(atol, max_steps: int) -> lanes.Limits:
    endless = jnp.full(atol.shape, jnp.inf)
    return lanes.Limits(jnp.asarray(RTOL), atol, endless, jnp.asarray(max_steps))


# --- rows, in pieces that add up ------------------------------------------------------------


class Piece(NamedTuple):
    """Part of a row: its starts depend on (seed, number) only."""

    level: str
    family: str
    n: int
    seed: int
    number: int
    budgets: tuple[int, int]


def pieces(args: argparse.Namespace) -> list[Piece]:
    """All the pieces, the costly ones first."""
    found = []
    for level in args.levels:
        for family in args.families:
            closed = family == "closed"
            total = args.n or (20_000 if closed else MANY[level])
            size = min(total, 5000 if closed else PIECE[level])
            parts = range(-(-total // size))
            budgets = tuple(args.budget)
            for k in parts:
                n = min(size, total - k * size)
                found.append(Piece(level, family, n, args.seed, k, budgets))
    costly = list(COSTLY)
    return sorted(found, key=lambda p: (p.family == "closed", costly.index(p.level), p.number))


def counted(piece: Piece) -> dict[str, Any]:
    """Run a piece; integers add up over the pieces of a row, floats have a maximum."""
    jax.config.update("jax_enable_x64", True)
    sample = starts(piece.family, piece.level, piece.n, (piece.seed, piece.number))
    closed = piece.family == "closed"
    c = compare(piece.level, sample, budgets=piece.budgets, closed=closed)
    decided = c.outcome > 0
    plain = decided & (c.final > 0)
    wrong = plain & (c.final != c.outcome)
    stop = decided & (c.outcome == Outcome.STOP)
    both = plain & ~wrong & ~stop
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
        "plain": plain,
        "wrong": wrong,
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
        "wrong_starts": [[piece.number, int(k)] for k in np.nonzero(wrong)[0]],
        "seconds": [float(s) for s in c.seconds],
    }


def results(todo: list[Piece], jobs: int) -> Iterator[dict[str, Any]]:
    """The pieces as they finish, in so many processes."""
    if jobs == 1:
        yield from map(counted, todo)
        return
    fresh = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(jobs, mp_context=fresh) as pool:
        for done in concurrent.futures.as_completed([pool.submit(counted, p) for p in todo]):
            yield done.result()


def merged(found: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each level and family."""
    rows: dict[Any, dict[str, Any]] = {}
    for piece in found:
        row = rows.setdefault((piece["level"], piece["family"]), {})
        for name, value in piece.items():
            if isinstance(value, float):
                row[name] = max(row.get(name, 0.0), value)
            elif isinstance(value, str):
                row[name] = value
            else:  # counts and lists; seconds become one pair for each piece
                row[name] = row[name] + value if name in row else value
    place = list(LEVELS).index, FAMILIES.index
    return [rows[key] for key in sorted(rows, key=lambda k: (place[0](k[0]), place[1](k[1])))]


def markdown(rows: list[dict[str, Any]]) -> str:
    import report

    table = [["level", "family", "N", "residual", "stop: rotating", "wobbling", "other"]]
    table[0] += ["undecided", "failed", "certified", "plain", "WRONG"]
    table[0] += ["Δω∞ over its estimate, certified / tested", "largest Δω∞/ω∞ beyond", "steps"]
    for row in rows:
        stops = [row[f"stop_{kind}"] for kind in ("rotating", "wobbling", "other")]
        cells = [row["level"], row["family"], row["n"], row["residual"], *stops]
        decided = max(row["residual"] + sum(stops), 1)
        cells += [row["undecided"], row["failed"], f"{row['certified'] / decided:.1%}"]
        cells += [row["plain"], row["wrong"]]
        cells.append(f"{row['over_certified']:.2f} / {row['over_tested']:.2f}")
        cells.append(f"{row['beyond_certified']:.1e} / {row['beyond_tested']:.1e}")
        table.append([*map(str, cells), f"{row['steps'] / row['n']:.0f}"])
    return report._layout(table, text=2)


def keep(runs: list[dict[str, Any]], rows: list[dict[str, Any]]) -> None:
    """Into the README between its marks, and a JSON file."""
    readme = HERE / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    said = [f"`{run['command']}`, {run['date']}, {run['cores']} cores" for run in runs]
    total = (
        f"{sum(r['plain'] for r in rows)} labels checked, {sum(r['wrong'] for r in rows)} wrong."
    )
    text = "\n\n".join(["; ".join(said) + ".", total, markdown(rows)])
    readme.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")
    kept = json.dumps({"runs": runs, "rows": rows}, indent=1, ensure_ascii=False)
    (HERE / "results" / "labels.json").write_text(kept + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
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
        import measure

        command = shlex.join(["python", "benchmarks/labels.py", *sys.argv[1:]])
        run = {"command": command, "seed": args.seed, **measure.machine()}
        for line in itertools.chain([run], results(pieces(args), args.jobs)):
            lines.append(line)
            if args.into:
                with args.into.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line, ensure_ascii=False) + "\n")
    rows = merged(line for line in lines if "level" in line)
    print(markdown(rows))
    if args.write:
        keep([line for line in lines if "command" in line], rows)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
