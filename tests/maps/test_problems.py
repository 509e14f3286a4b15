"""Problems: what they may return and ask for, and digests of the programs that they trace."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._maps.problems import BlockBuilder

GRID = dt.Grid(w3=np.linspace(0.0, 0.45, 12), phi=np.linspace(0.0, 3.0, 18))


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


def programs(problem):
    return BlockBuilder(problem, GRID).program_digests()


def named(factor):
    """An equation whose class is always called the same, whatever its rates."""

    class Top(dt.TransverseReduced):
        def __call__(self, t, y, args=None):
            return factor * y

    return lambda w3, phi: (Top(-0.2), dt.cylindrical(0.2, w3, phi))


def helped(name):
    """A problem with a compiled helper of that name."""

    def half(x):
        return 0.5 * x

    half.__name__ = name
    compiled = jax.jit(half)
    return lambda w3, phi: reduced(compiled(w3), phi)


def test_a_program_is_known_by_what_it_computes_not_by_what_it_is_called():
    def another_name(w3, phi):
        azimuth = phi  # and another line
        return [dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, azimuth)]

    def banded(size):
        table = np.array([0.0, 0.0, size])

        def problem(w3, phi):
            more = jnp.where((w3 > 0.201) & (w3 < 0.202), jnp.asarray(table)[2], 0.0)
            return dt.TransverseReduced(-0.2), dt.cylindrical(0.2 + more, w3, phi)

        return problem

    usual = programs(reduced)
    assert programs(another_name) == usual
    assert programs(banded(0.1)) == programs(banded(0.1))
    assert programs(banded(0.1))["problem"] != programs(banded(0.2))["problem"]
    assert programs(helped("one")) == programs(helped("other")) != usual
    plain, again, slower = (programs(named(factor)) for factor in (1.0, 1.0, 0.5))
    assert plain == again
    assert [name for name in plain if plain[name] != slower[name]] == ["field"]


ALONE = """
import multiprocessing, os, sys, warnings
import jax
jax.config.update("jax_enable_x64", True)
import dipoletop as dt
from dipoletop._maps.problems import BlockBuilder
warnings.simplefilter("ignore")  # JAX's and Python's own, at the fork

equation, omega0 = dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, 0.1)
grid = dt.Grid(w3=[0.1, 0.2], phi=0.2)

def reduced(w3, phi):
    return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)

def asks_classify_many(w3, phi):
    dt.classify_many(equation, omega0[None])
    return reduced(w3, phi)

def asks_sweep(w3, phi):
    dt.sweep(reduced, grid)
    return reduced(w3, phi)

def said(call):
    try:
        call()
    except (ValueError, RuntimeError) as error:
        return str(error)
    return "nothing"

for problem in (asks_classify_many, asks_sweep):
    print(said(lambda: dt.sweep(problem, grid)))
calls = [
    lambda: dt.classify(equation, omega0),
    lambda: dt.classify_many(equation, omega0[None]),
    lambda: dt.simulate(equation, omega0, [0.0, 1.0]),
    lambda: dt.sweep(reduced, grid),
    lambda: dt.residual_rotation(equation, omega0),
    lambda: dt.spectrum(equation, [0.1, 0.0, 0.0]),
    lambda: dt.TransverseReduced(0.1),
]
omega0 = jax.device_get(omega0)
sys.stdout.flush()
if not os.fork():
    for call in calls:
        print(said(call))
    sys.stdout.flush()
    os._exit(0)
os.wait()
print(BlockBuilder(reduced, dt.Grid(w3=[0.1], phi=0.2)).program_digests()["verdict"].hex())
"""


@pytest.mark.system
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_what_would_wait_for_ever_is_refused():
    run = subprocess.run(
        [sys.executable, "-c", ALONE], capture_output=True, text=True, timeout=300, check=False
    )
    assert run.returncode == 0, run.stderr
    *lines, verdict = run.stdout.splitlines()
    nested, forked = lines[:2], lines[2:]
    assert len(forked) == 7
    for line in nested:
        assert line.startswith("Argument `problem` must not itself call `sweep` or `classify_many`")
    for line in forked:
        assert 'start it by multiprocessing.get_context("spawn") instead.' in line
    # A program has the same digest in another process, whatever that did before.
    assert verdict == programs(reduced)["verdict"].hex()


def test_variations_are_those_of_jax_and_name_what_varies():
    at = dt.Grid(delta=[-0.2, 0.3], w3=[0.0, 0.1, 0.2], phi=1.2)
    builder = BlockBuilder(reduced, at, ("w3", "delta"))
    points = at.points(np.arange(6))
    made, by_jax = builder(points), builder._vectorised(points)
    assert jax.tree.structure(made) == jax.tree.structure(by_jax)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(made))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, 1e-15, 1e-16), made, by_jax)
    assert made[0].varying == ((False,), (True,))  # δ, the only array of the equation


def test_a_problem_returns_what_classify_takes():
    at = dt.Grid(w3=[0.1, 0.3], phi=[0.2, 1.2])
    found = dt.sweep(lambda w3, phi: [dt.TransverseReduced(-0.2), [0.2, 0, w3]], at)
    assert found == dt.sweep(lambda w3, phi: reduced(w3, 0.0), at)
    fixed = dt.sweep(lambda w3, phi: (dt.TransverseReduced(-0.2), np.array([0.2, 0, 0.1])), at)
    assert np.array_equal(fixed.omega_inf, np.full((2, 2), found.omega_inf[0, 0]))


def test_a_wrong_number_in_the_problem_itself_is_refused():
    """It is known, although the problem is traced."""
    with pytest.raises(ValueError, match="`delta`"):
        dt.sweep(lambda w3: reduced(w3, 0.0, 2.0), dt.Grid(w3=[0.1]))


def test_a_problem_may_compute_with_numbers_of_its_own():
    size = jnp.asarray(0.2)
    basin = dt.sweep(
        lambda w3: (dt.TransverseReduced(-0.2), dt.cylindrical(float(jnp.sin(size)), w3, 0.1)),
        dt.Grid(w3=[0.1]),
    )
    assert basin.outcome[0] in (dt.Outcome.RESIDUAL, dt.Outcome.STOP)
