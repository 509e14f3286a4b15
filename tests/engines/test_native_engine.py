"""Machine code: it does what JAX does, or says that it cannot."""

import ctypes

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dipoletop as dt
from dipoletop._engines import jaxpr_to_llvm, native_engine, select
from dipoletop._engines.interface import Limits, Unsupported
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._runs.classification import classification_of

RNG = np.random.default_rng(11)
WIDTH = 4


def machine(function, table):
    """A function of one row, (n,), by machine code on a table (n, B); what it gives comes first."""
    rows = jnp.zeros((table.shape[0], 1))
    address, _alive = jaxpr_to_llvm.compiled(
        lambda row, shared: function(row), rows, jnp.zeros(()), WIDTH
    )
    out = np.array(table, order="C")
    size = out.shape[1]
    assert size % WIDTH == 0
    shared = np.zeros(1)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)
    for first in range(0, size, WIDTH):
        kind(address)(out[:, first:].ctypes.data, size, shared.ctypes.data)
    return out


FUNCTIONS = {
    "arithmetic": lambda x: jnp.stack([x[0] + x[1], x[1] - x[2], x[0] * x[2], -x[1] / x[2]]),
    "powers": lambda x: jnp.stack([x[0] ** 7, x[1] ** -2, jnp.abs(x[2]) ** 1.5, x[3] ** 0]),
    "roots": lambda x: jnp.stack(
        [jnp.sqrt(jnp.abs(x[0])), jax.lax.rsqrt(x[1] ** 2), jnp.square(x[2]), jnp.cbrt(8.0) * x[3]]
    ),
    "functions": lambda x: jnp.stack(
        [jnp.exp(x[0]), jnp.log(jnp.abs(x[1])), jnp.sin(x[2]) * jnp.cos(x[0]), jnp.tan(x[3])]
    ),
    "angles": lambda x: jnp.stack(
        [jnp.arctan2(x[0], x[1]), jnp.tanh(x[1]), jnp.floor(x[2]), jnp.round(3 * x[3])]
    ),
    "choices": lambda x: jnp.stack(
        [
            jnp.where((x[0] > 0) & ~(x[1] <= x[2]) | (x[3] != x[0]), x[0], x[1]),
            jnp.clip(x[1], -0.5, 0.5),
            jnp.sign(x[2]) * jnp.minimum(x[0], x[3]),
            jnp.where(jnp.isfinite(1 / (x[3] - x[3])), 1.0, jnp.maximum(x[1], x[2])),
        ]
    ),
    "whole numbers": lambda x: jnp.stack(
        [
            jnp.argmax(x, axis=0).astype(float),
            jnp.argmin(x, axis=0).astype(float),
            jnp.sum((x > 0).astype("int32"), axis=0).astype(float) + jnp.mod(x[2], 0.3),
            (x[0] * 10).astype(int).astype(float) + jnp.abs((x[1] * 10).astype(int)).astype(float),
        ]
    ),
    "sums": lambda x: jnp.stack(
        [jnp.sum(x, axis=0), jnp.prod(x, axis=0), jnp.max(x, axis=0), jnp.min(x, axis=0)]
    ),
    "matrices": lambda x: (
        jnp.einsum("ij,jb->ib", jnp.arange(16.0).reshape(4, 4), x) + jnp.einsum("ab,cb->cb", x, x)
    ),
    "moves": lambda x: jnp.concatenate([x[::-1][:2], jnp.roll(x, 1, axis=0)[2:]]).at[1].set(x[3]),
    "single precision": lambda x: jnp.stack(
        [
            x[0].astype("float32").astype(float),
            jnp.log(jnp.abs(x[1]).astype("float32")).astype(float),
            *x[2:],
        ]
    ),
    "a loop": lambda x: jax.lax.fori_loop(
        0, 5, lambda i, y: y.at[i % 4].set(y[i % 3] + x[0] * i), x
    ),
    "a scan": lambda x: jax.lax.scan(lambda s, row: (s + row, s * row), x[0], x)[1],
    "a derivative": lambda x: jax.jvp(lambda y: y**3 / (1 + y[:1]) ** 2, (x,), (x[::-1],))[1],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_machine_code_does_what_jax_does(name):
    table = RNG.normal(size=(4, WIDTH))
    function = FUNCTIONS[name]
    expected = np.stack([function(jnp.asarray(table[:, i : i + 1])) for i in range(WIDTH)], axis=1)
    found = machine(function, table)
    # Rounding, and sums in another order; libraries differ in the last bit of a function.
    scale = 1e-6 if name == "single precision" else 1e-14
    np.testing.assert_allclose(found, expected[..., 0], rtol=scale, atol=scale)


def test_what_is_not_a_number_stays_so():
    table = np.array([[np.nan, 1.0, -np.inf, 0.0], [1.0, np.nan, np.inf, -0.0]])
    found = machine(lambda x: jnp.stack([jnp.maximum(x[0], x[1]), jnp.minimum(x[0], x[1])]), table)
    expected = np.stack([np.maximum(*table), np.minimum(*table)])
    np.testing.assert_array_equal(found, expected)


def test_logarithms_in_single_precision():
    """Our own code for them, for every kind of number."""
    numbers = [0.0, -0.0, -1.0, np.inf, -np.inf, np.nan, 1e-45, 1e-40, 1.2e-38, 3e38, 1.0]
    numbers += [0.70710677, 0.7071069, *np.nextafter(np.float32(1), np.float32([0, 2]))]
    table = np.append(numbers, 10 ** RNG.uniform(-38, 38, 33)).reshape(1, -1)
    found = machine(lambda x: jnp.log(x.astype("float32")).astype(float), table)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.log(table.astype("float32").astype(float))
    np.testing.assert_allclose(found, expected, rtol=3e-7)


def problem(make, size=0.3, n=128):
    """Equations of many shapes, their starts and limits."""
    deltas = jnp.asarray(RNG.uniform(-0.9, 0.7, n))
    starts = jnp.asarray(RNG.normal(size=(3, n)) * size)
    scale = jnp.sqrt(jnp.sum(starts**2, axis=0))
    rtol = jnp.array(1e-9)
    limits = Limits(rtol, rtol * scale, jnp.full(n, jnp.inf), jnp.asarray(3000))
    made = jax.vmap(make, out_axes=-1)(deltas), starts, limits
    return jax.device_put(made, jax.devices()[0])  # or what follows from these compiles again


def by_both(equation, y0, limits, solver, **until):
    engines = NativeEngine(solver), JaxEngine(solver)
    return [engine.end_states(equation, y0, limits, **until) for engine in engines]


def at_a_given_time(equation, y0, limits, **options):
    """The states of the runs that get there agree, whatever the steps; and how many these are."""
    limits = eqx.tree_at(lambda x: x.t1, limits, jnp.minimum(limits.t1, 5.0))
    fast, slow = by_both(equation, y0, limits, **options)
    there = np.asarray(slow.t == 5.0)
    assert np.array_equal(fast.t == 5.0, there)
    tolerance = 1e-9 * float(jnp.max(jnp.abs(y0)))
    np.testing.assert_allclose(fast.y[:, there], slow.y[:, there], rtol=0, atol=tolerance)
    return np.mean(there)


def test_both_engines_agree():
    """The same labels, steps but for one in a hundred runs, and states at a given time."""
    equation, starts, limits = problem(dt.TransverseReduced)
    solver = diffrax.Dopri8()
    y0 = equation.lift(starts)
    fast, slow = by_both(equation, y0, limits, solver=solver)
    assert np.array_equal(fast.status, slow.status)
    counts = np.stack([fast.steps, slow.steps])
    assert np.mean(counts[0] != counts[1]) <= 0.01
    assert np.all(np.ptp(counts, axis=0) <= 2 + 0.02 * counts[1])
    verdicts = [eqx.filter_jit(lambda e, y: e.verdict(y))(equation, e.y) for e in (fast, slow)]
    assert np.array_equal(verdicts[0][0], verdicts[1][0])
    assert at_a_given_time(equation, y0, limits, solver=solver) > 0.5


def test_both_engines_agree_on_any_body():
    """Without the verdict, which takes the engines a minute to compile; it is tested below."""
    made = problem(lambda d: dt.Reduced(dt.axisymmetric(d)))
    assert at_a_given_time(*made, solver=diffrax.Tsit5(), until="time") == 1


def any_bodies(rng, n):
    """Bodies in skew axes and Ω: the dipole on one of the principal axes, on none; Ω near, far."""
    turns = Rotation.random(n, rng).as_matrix()
    moments = 1 - rng.dirichlet(np.ones(3), n)
    inertia = np.einsum("nij,nj,nkj->nik", turns, moments, turns)
    along = np.resize(np.vstack([np.eye(3), [[0.6, 0.0, 0.8]]]), (n, 3))
    dipole = np.einsum("nij,nj->ni", turns, along)
    omega = dipole + rng.normal(size=(n, 3)) * 10 ** rng.uniform(-3, 1, (n, 1))
    omega *= 10 ** rng.uniform(-2, -0.5, (n, 1)) / np.linalg.norm(omega, axis=1, keepdims=True)
    return dt.Body((inertia + inertia.transpose(0, 2, 1)) / 2, dipole), omega


@pytest.mark.parametrize("level", [dt.Reduced, dt.SemiReduced])
def test_rates_and_verdicts_of_any_body(level):
    """The long code of the general equations."""
    n = 64 * WIDTH
    bodies, omega = any_bodies(np.random.default_rng(12), n)
    given = level(bodies), jnp.asarray(omega)
    leaves, kind = jax.tree.flatten(jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), given))
    table = np.concatenate([leaf.reshape(-1, n) for leaf in leaves])
    ends = np.cumsum([leaf.size // n for leaf in leaves])

    def found(table):
        parts = [table[end - y.size // n : end] for y, end in zip(leaves, ends, strict=True)]
        parts = [x.reshape(*y.shape[:-1], -1) for x, y in zip(parts, leaves, strict=True)]
        equation, y = jax.tree.unflatten(kind, parts)
        verdict = jnp.stack([number.astype(float) for number in equation.verdict(y)[:-1]])
        return jnp.concatenate([equation(0.0, y), verdict])

    expected = np.asarray(jax.jit(found)(table))
    np.testing.assert_allclose(
        machine(found, table)[: len(expected)], expected, rtol=1e-9, atol=1e-13
    )
    assert set(expected[3]) == {dt.Outcome.UNDECIDED, dt.Outcome.RESIDUAL, dt.Outcome.STOP}


class Growing(eqx.Module):
    """y′ = −erf(y): a function that has no vector instruction."""

    rate: jax.Array

    def __call__(self, t, y, args=None):
        return -self.rate[None] * jax.lax.erf(y)

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        done = y[0] < 0.5
        return jnp.where(done, 2, 0), jnp.where(done, 0.0, jnp.nan), done


def test_an_equation_without_straight_line_code_runs_in_jax_with_a_warning():
    equation, starts = Growing(jnp.ones(3)), jnp.ones((3, 3))
    with pytest.warns(UserWarning, match=r"The JAX engine runs, .*Growing .*operation erf"):
        found = dt.classify_many(equation, starts)
    assert np.array_equal(found.outcome, [2, 2, 2])
    with pytest.raises(ValueError, match=r"`engine` must be 'auto' or 'jax' here, .*erf"):
        dt.classify_many(equation, starts, engine="native")


def test_a_code_that_grows_too_long_is_refused(monkeypatch):
    monkeypatch.setattr("dipoletop._engines.vector_code.LONGEST", 100)
    with pytest.raises(Unsupported, match="more than 100 instructions"):
        machine(lambda x: jax.lax.fori_loop(0, 99, lambda i, y: y * x, x), np.ones((4, WIDTH)))


class Fading(Growing):
    """y′ = −r y, which the native engine can take."""

    def __call__(self, t, y, args=None):
        return -self.rate[None] * y


def test_without_numba_jax_runs(monkeypatch):
    equation, start = Fading(jnp.ones(1)), jnp.ones((1, 3))
    grid = dt.Grid(w3=[0.6, 0.9])

    def swept():
        return dt.sweep(lambda w3: (Fading(1 + w3), w3 * jnp.ones(3)), grid)

    assert swept().attrs["engine"] == "native"
    monkeypatch.setattr(select, "_native_engine", lambda: (None, "numba cannot be imported (gone)"))
    assert swept().attrs["engine"] == "jax"
    assert dt.classify_many(equation, start).outcome == [dt.Outcome.STOP]
    with pytest.raises(ValueError, match=r"'native', but numba cannot be imported \(gone\)"):
        dt.classify_many(equation, start, engine="native")


def test_an_unknown_engine_is_refused():
    message = r"Argument `engine` must be 'auto', 'jax' or 'native', but is 'fast'\."
    with pytest.raises(ValueError, match=message):
        dt.classify_many(dt.TransverseReduced(-0.2), jnp.ones((1, 3)), engine="fast")


def test_a_second_call_with_other_values_compiles_nothing():
    for shift in (0.0, 0.1):
        starts = jnp.ones((3, 5)) * (0.1 + shift)
        limits = Limits(jnp.asarray(1e-8 + shift * 1e-8), starts[0], starts[0], jnp.asarray(99))
        NativeEngine().end_states(dt.TransverseSemi(starts[0]), starts, limits)
        if shift == 0:
            count = len(native_engine._programs)
    assert len(native_engine._programs) == count


def test_threads_share_the_queue():
    equation, starts, limits = problem(dt.TransverseReduced, n=1003)

    def found(threads):
        options = {"until": "value", "device": jax.devices()[0], "threads": threads}
        return NativeEngine().classify(classification_of, equation, starts, limits, **options)

    jax.tree.map(np.testing.assert_array_equal, found(1), found(3))


def test_after_an_interruption_no_thread_takes_another_start():
    queue = np.zeros(1, np.intp)

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        native_engine._in_threads(interrupted, 2, queue, 100)
    assert queue[0] == 100
