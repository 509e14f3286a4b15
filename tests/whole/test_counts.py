"""What the work costs, in numbers that are the same on every machine: steps, lanes, programs, code.

When a bound is passed, something has become dearer (or, below a lower bound, less is done than is
asked for). Improve it again; or, if the cost buys something, move the bound knowingly, to some
5–10 % from the new number, and say in the commit what it buys. Numbers that depend a little on the
version of JAX have 25 %.
"""

import functools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base.monitoring import COMPILING
from dipoletop._engines import jaxpr_to_llvm as _llvm
from dipoletop._engines import native_engine, step
from dipoletop._engines.interface import Limits
from dipoletop._engines.jax_engine import NARROW, JaxEngine
from dipoletop._engines.machine_code import MachineCode
from dipoletop._engines.native_engine import WIDTH, NativeEngine

# Steps of a run of the mixed basin at rtol 1e-8, by level and `value`: (least mean, mean, longest).
STEPS = {
    (1, True): (20.2, 23.4, 330),  # 21.7, 306
    (1, False): (1.4, 1.6, 60),  # 1.51, 56: of the last pass over each; none if δ > 0
    ("semi", True): (22.6, 26.0, 330),  # 24.3, 304
    ("semi", False): (5.9, 6.8, 206),  # 6.3, 192
}
# Steps of lanes that were running, over all that were made: at least.
EFFICIENCY = {"jax": 0.65, "native": 0.88}  # 0.71, 0.94
# Of the rate, in a step of Dopri8: its last stage is the first of the next step.
EVALUATIONS = 13
# Programs that a first call compiles, in this order, so that a later one shares what is there;
# nearly all are of one operation. A second call with other values compiles none.
PROGRAMS = {
    "sweep": 9,  # 7
    "classify": 8,  # 6
    "simulate": 10,  # 8
}
# Operations of the right-hand sides, and of a step of 8 lanes until the value is known.
OPERATIONS = {
    "transverse 1": 39,  # 31
    "transverse 2": 124,  # 99
    "transverse 3": 350,  # 280
    "transverse 4": 976,  # 781
    "transverse semi": 48,  # 38
    "transverse full": 54,  # 43
    "general 1": 380,  # 304
    "general 2": 916,  # 733
    "general 3": 2146,  # 1717
    "general semi": 458,  # 366
    "general full": 260,  # 208
    "step, transverse 1": 1376,  # 1101
    "step, transverse semi": 1740,  # 1392
}
# Vector instructions of the native engine, as they are written.
INSTRUCTIONS = {
    "transverse 1": {"begin": 558, "advance": 1670},  # 446, 1334
    "general 1": {"begin": 3560, "advance": 5650},  # 3337, 5296
    "general semi": {"begin": 3900, "advance": 6500},  # 3651, 6072
}

MANY = 512
FAMILIES = {
    "transverse": (dt.TransverseReduced, dt.TransverseSemi, dt.TransverseFull, 5),
    "general": (dt.Reduced, dt.SemiReduced, dt.Full, 6),
}
LEVELS = {1: dt.TransverseReduced, "semi": dt.TransverseSemi}


def mixed_basin():
    """δ uniform in ±0.45, |ω| log-uniform in 0.05 … 1, isotropic."""
    rng = np.random.default_rng(0)
    deltas, sizes = rng.uniform(-0.45, 0.45, MANY), 0.05 * 20 ** rng.random(MANY)
    ways = rng.normal(size=(MANY, 3))
    ways *= (sizes / np.linalg.norm(ways, axis=1))[:, None]
    return jnp.asarray(deltas), jnp.asarray(ways)


def programs(task):
    """How many are compiled meanwhile, in any thread."""
    seen = []
    listen = lambda event, seconds, **_: seen.append(event)  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        task()
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    return seen.count("/jax/core/compile/backend_compile_duration") + seen.count(COMPILING)


@pytest.mark.parametrize(("level", "value"), STEPS)
def test_steps_of_a_run(level, value):
    deltas, starts = mixed_basin()

    def run(scale, rtol):
        tops = LEVELS[level](scale * deltas)
        return dt.classify_many(tops, scale * starts, rtol=rtol, value=value, engine="native")

    found = run(1.0, 1e-8)
    assert programs(lambda: run(0.9, 1e-7)) == 0
    assert np.all(found.outcome > 0)
    least, mean, longest = STEPS[level, value]
    assert least < found.steps.mean() < mean
    assert found.steps.max() < longest


def limits(size):
    tolerance, budget = jnp.asarray(1e-8), jnp.asarray(4096)
    return Limits(tolerance, jnp.full(size, 1e-9), jnp.full(size, jnp.inf), budget)


@pytest.mark.parametrize(
    "engine",
    [pytest.param(JaxEngine(), marks=pytest.mark.slow), NativeEngine()],
    ids=lambda engine: engine.name,
)
def test_lanes_do_not_wait(engine):
    deltas, starts = mixed_basin()

    def run(scale):
        return engine.end_states(dt.TransverseReduced(scale * deltas), starts.T, limits(MANY))

    ends = run(1.0)
    assert programs(lambda: run(0.9)) == 0
    wide, narrow = map(int, ends.block_steps)
    made = WIDTH * wide if engine.name == "native" else 128 * (wide + narrow / NARROW)
    assert EFFICIENCY[engine.name] < int(ends.steps.sum()) / made <= 1


def operations(jaxpr, name=None):
    """How many operations, or of that name; what is inside of a loop counts every time."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [x for x in jax.tree.leaves(list(equation.params.values())) if hasattr(x, "eqns")]
        times = equation.params["length"] if equation.primitive.name == "scan" else 1
        total += times * sum(operations(part, name) for part in inner)
        total += not inner and name in (None, equation.primitive.name)
    return total


def one_step(equation, n, solver):
    """The operations of a step of 8 lanes."""
    at = eqx.filter_eval_shape(step.begin, equation, jnp.ones((n, 8)), limits(8), 8, "value")
    advance = lambda at: step.advance(at, *numbers, solver, "value")  # noqa: E731
    numbers = limits(8).rtol, limits(8).max_steps
    return eqx.filter_make_jaxpr(advance)(at)[0].jaxpr


class Turning(eqx.Module):
    """ω′ = sin ω, so that evaluations can be told, and as long as is wished."""

    padding: int

    def __call__(self, t, y, args=None):
        for _ in range(self.padding):
            y = y + 1.0
        return jnp.sin(y)

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        return jnp.zeros(y.shape[1:], int), y[0], y[0] > 0


@pytest.mark.parametrize("padding", [0, step.LARGE], ids=["written out", "in a loop"])
def test_evaluations_of_the_rate_in_a_step(padding):
    assert operations(one_step(Turning(padding), 3, diffrax.Dopri8()), "sin") == EVALUATIONS


class Braked(eqx.Module):
    """ω′ = −r ω²ω, which ends on a small sphere: short, since it is compiled many times."""

    rate: jax.Array
    body: dt.Body

    def __call__(self, t, y, args=None):
        return -(self.rate * jnp.sum(y**2, axis=0))[None] * y

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        done = jnp.sum(y**2, axis=0) < 1e-3
        return jnp.where(done, int(dt.Outcome.STOP), 0), 0 * y[0], done


def braked(rate):
    return Braked(jnp.asarray(rate), dt.axisymmetric(0.0))


def call(name, scale, rtol):
    """Some of the public functions that run, with values that depend on `scale`."""
    if name == "sweep":
        return dt.sweep(
            lambda rate, w3: (braked(rate), jnp.stack([0.1 * w3, 0.2 * rate, w3])),
            dt.Grid(rate=scale * np.linspace(1, 2, 10), w3=scale * np.linspace(0.1, 1, 16)),
            rtol=rtol,
            progress=False,
        )
    start = scale * jnp.array([0.6, -0.3, 0.8])
    if name == "classify":
        return dt.classify(braked(scale), start, rtol=rtol)
    return dt.simulate(braked(scale), start, scale * jnp.linspace(0, 9, 5), rtol=rtol)


@pytest.fixture(scope="module")
def compiled():
    """What a first call of each function compiles, and a second."""
    jax.clear_caches()
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native_engine, "_programs", {})
        for name in PROGRAMS:
            first, second = (functools.partial(call, name, *x) for x in ((1.0, 1e-8), (0.9, 1e-7)))
            found[name] = programs(first), programs(second)
    return found


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_that_are_compiled(compiled, name):
    first, second = compiled[name]
    assert 0 < first < PROGRAMS[name]
    assert second == 0


def right_hand_side(name):
    """The equation of that name, and how many numbers a state of it has."""
    family, level = name.split()
    general = dt.Body(np.diag([1.0, 1.2, 1.5]), [0.6, 0.3, 0.8])
    top = general if family == "general" else jnp.asarray(-0.2)
    reduced, semi, full, n = FAMILIES[family]
    if level == "semi":
        return semi(top), 3
    return (full(top), n) if level == "full" else (reduced(top, int(level)), 3)


def in_room(found, bound):
    assert bound / 2 < found < bound


@pytest.mark.parametrize("name", [name for name in OPERATIONS if "step" not in name])
def test_length_of_the_right_hand_sides(name):
    equation, n = right_hand_side(name)
    jaxpr = eqx.filter_make_jaxpr(lambda e, y: e(0.0, y))(equation, jnp.ones(n))[0].jaxpr
    in_room(operations(jaxpr), OPERATIONS[name])
    if f"step, {name}" in OPERATIONS:
        block = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, 8)), equation)
        in_room(operations(one_step(block, n, diffrax.Dopri8())), OPERATIONS[f"step, {name}"])


LONG = [name for name in INSTRUCTIONS if name.startswith("general")]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in INSTRUCTIONS]
)
def test_length_of_the_native_code(name, monkeypatch):
    written = []

    def builder(*arguments):
        written.append(VectorBuilder(*arguments))
        return written[-1]

    VectorBuilder = _llvm.VectorBuilder
    monkeypatch.setattr(_llvm, "VectorBuilder", builder)
    monkeypatch.setattr(_llvm, "machine_code", lambda text: MachineCode(len(text), None))
    equation, n = right_hand_side(name)
    equation = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, 8)), equation)
    native_engine._Program.compile(equation, n, diffrax.Dopri8(), "value", None)
    begin, _, advance, _ = written  # the others only copy
    parts = {"begin": begin, "advance": advance}
    for part, bound in INSTRUCTIONS[name].items():
        in_room(parts[part].instructions, bound)
