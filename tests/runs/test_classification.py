"""From end states to outcomes: whose proof counts, and how results print."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from settling import Settling

import dipoletop as dt
from dipoletop import Outcome, Stop
from dipoletop._base.stopping import FINISHED
from dipoletop._base.tolerances import Tolerances
from dipoletop._engines.interface import EndStates
from dipoletop._runs.classification import Classification, classification_of
from dipoletop._runs.conditioning import is_integrated
from dipoletop.equations.tangent import Tangent

RESIDUAL, STOP = Outcome.RESIDUAL, Outcome.STOP
MOST_PROGRAMS = 260  # results are made by hand in arrays of JAX


ORDER_ONE = dt.TransverseReduced(0.1)


ORDER_ONE_2A = dt.TransverseReduced(-0.2)


@pytest.mark.parametrize("level", [dt.TransverseReduced, dt.TransverseSemi])
def test_squares_that_underflow_certify_nothing(level):
    """The same direction, a stop at order 1 and at any size, until numbers fail."""
    way = jnp.array([0.02, 0.01, 0.9])
    for size in (1e-30, 1e-100, 1e-150, 1e-165, 1e-200):
        verdict = level(-0.2).verdict(size * way)
        assert int(verdict.outcome) in (Outcome.STOP, Outcome.UNDECIDED)
    with jax.enable_x64(False):
        small = level(-0.2).verdict(jnp.asarray(1e-21 * np.array([0.02, 0.01, 0.9]), "float32"))
        assert int(small.outcome) in (Outcome.STOP, Outcome.UNDECIDED)


class Faster(dt.TransverseReduced):
    """Its parent's regions, but another field."""

    def __call__(self, t, y, args=None):
        return 2 * dt.TransverseReduced.__call__(self, t, y, args)


class Braked(eqx.Module):
    """An equation of the library with a torque of friction added, and its verdict as it is."""

    inner: dt.TransverseReduced

    def __call__(self, t, y, args=None):
        return self.inner(t, y, args) - 1e-2 * y

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        return self.inner.verdict(y)


class Proven(Braked):
    """One whose author says that its regions are proven."""

    def verdict(self, y):
        return self.inner.verdict(y)._replace(equation=Proven)


def test_no_equation_borrows_the_proof_of_another():
    omegas = np.array([[0.2, 0.02, 0.01], [0.0, 0.0, 0.2]])
    time, steps = jnp.zeros(2), jnp.ones(2, int)
    ends = EndStates(jnp.asarray(omegas.T), time, steps, jnp.full(2, FINISHED))
    tolerances = Tolerances(jnp.asarray(1e-8), jnp.full(2, 1e-9))
    cases = [(ORDER_ONE_2A, True), (Faster(-0.2), False)]
    cases += [(Braked(ORDER_ONE_2A), False), (Proven(ORDER_ONE_2A), True)]
    for equation, certified in cases:
        found = classification_of(equation, ends, tolerances)
        assert found.outcome.tolist() == [RESIDUAL, STOP]
        assert found.certified.tolist() == [certified] * 2
    for equation, certified in cases[:1] + cases[2:3]:  # in machine code, too
        assert dt.classify_many(equation, omegas).certified.tolist() == [certified] * 2
    body = Settling(dt.axisymmetric(-0.2))  # whose verdict is a plain tuple
    small = eqx.tree_at(lambda ends: ends.y, ends, 1e-3 * ends.y)
    assert not classification_of(body, small, tolerances).certified.any()


def test_variations_keep_the_certificate_of_their_equation():
    state = jnp.array([0.2, 0.02, 0.01, 0.0, 0.0, 0.0])
    for equation, certified in ((ORDER_ONE, True), (Faster(0.1), False)):
        parameters = jax.tree.map(jnp.ones_like, equation)
        parameters = jax.tree.map(lambda leaf: leaf[None], parameters)
        for basis in (False, True):
            variations = equation, parameters, jnp.zeros((1, 3)), jnp.asarray(0.2)
            varied = Tangent(*variations, basis=basis)
            assert bool(varied.verdict(state).certified_for(varied)) == certified


RESULT = Classification(
    *(jnp.asarray(number) for number in (1, 0.0988747045, 3.2e-9, 899.867, 23, True, 0))
)


def changed(**fields):
    return dataclasses.replace(RESULT, **{name: jnp.asarray(x) for name, x in fields.items()})


def test_only_an_integrated_value_has_an_error_of_the_integration():
    assert is_integrated(changed(regime=0))
    for other in ({"regime": 1}, {"steps": 0}, {"omega_inf_error": 0.0}, {"outcome": STOP}):
        assert not is_integrated(changed(**({"regime": 0} | other)))


@pytest.mark.parametrize(
    ("run", "shown"),
    [
        (RESULT, "RESIDUAL, omega_inf=0.0988747045 ± 3e-09, time=899.867, steps=23, certified"),
        (
            changed(omega_inf_error=jnp.inf, certified=False),
            "RESIDUAL, omega_inf=0.0988747 (error not estimated), time=899.867, steps=23, "
            "not certified",
        ),
        (
            changed(omega_inf=jnp.nan),
            "RESIDUAL, omega_inf unknown, time=899.867, steps=23, certified",
        ),
        (
            changed(outcome=STOP, omega_inf=0.0, omega_inf_error=0.0, stop=Stop.WOBBLING),
            "STOP WOBBLING, time=899.867, steps=23, certified",
        ),
        (changed(outcome=0, certified=False), "UNDECIDED, time=899.867, steps=23"),
        (
            changed(regime=1, probability=1.0, time=jnp.nan, steps=0, certified=False),
            "RESIDUAL, omega_inf=0.0988747045 ± 3e-09, time=nan, steps=0, not certified, "
            "predicted: SLOW_FLOW",
        ),
        (
            changed(outcome=0, regime=3, probability=0.8, time=jnp.nan, steps=0, certified=False),
            "UNDECIDED, time=nan, steps=0, predicted: UNFOLDED, residual with probability 0.8",
        ),
        (changed(outcome=-1, certified=False), "FAILED, time=899.867, steps=23"),
        (
            changed(slopes=[0.5, 2.0]),
            "RESIDUAL, omega_inf=0.0988747045 ± 3e-09, time=899.867, steps=23, certified, "
            "slopes=[0.5, 2.0]",
        ),
    ],
)
def test_one_run_prints_its_numbers(run, shown):
    assert repr(run) == str(run) == f"Classification({shown})"


def test_many_runs_print_their_counts():
    runs = jax.tree.map(lambda leaf: np.repeat(leaf, 8), RESULT)
    runs = dataclasses.replace(runs, outcome=np.array([1, 1, 1, 2, 2, 2, 2, 0]))
    shown = "8 runs, 3 RESIDUAL (37.50%), 4 STOP (50.00%), 1 UNDECIDED (12.50%), 8 certified, "
    assert repr(runs) == f"Classification({shown}184 steps)"
    predicted = dataclasses.replace(runs, regime=np.array([0, 1, 2, 3, 4, 0, 0, 0]))
    assert repr(predicted) == f"Classification({shown}4 predicted, 184 steps)"


def test_what_is_no_number_prints_its_shape():
    shown = []
    runs = jax.tree.map(lambda leaf: leaf[None], RESULT)
    jax.jit(jax.vmap(lambda run: shown.append(repr(run))))(runs)
    assert "f64[]" in shown[0]
    assert "omega_inf=None" in repr(jax.tree.map(lambda _: None, RESULT))
