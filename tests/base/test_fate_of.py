"""The fate of a run follows from outcome, kind of stop and ω∞."""

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop import Fate, Outcome, Stop
from dipoletop._base.types import fate_of


def test_numbers_are_the_same_in_jax():
    kinds = np.array([(a, b, c) for a in Outcome for b in Stop for c in (-0.1, 0, 0.1, np.nan)]).T
    found = fate_of(kinds[0], kinds[1].astype(int), kinds[2])
    traced = jax.jit(fate_of)(kinds[0], kinds[1].astype(int), kinds[2])
    np.testing.assert_array_equal(found, traced)
    residual = np.isin(found, [Fate.RESIDUAL, Fate.POSITIVE, Fate.NEGATIVE])
    np.testing.assert_array_equal(residual, kinds[0] == Outcome.RESIDUAL)
    np.testing.assert_array_equal(found >= Fate.AXIS_1, kinds[0] == Outcome.STOP)


def test_a_run_has_a_sense_if_its_value_is_known():
    equation = dt.TransverseReduced(jnp.array([0.0, 0.0, -0.2]))
    omegas = np.array([[0.1, 0.2, 0.0], [-0.1, 0.2, 0.0], [0.2, 0.02, 0.2]])
    for value, sense in ((True, [Fate.POSITIVE, Fate.NEGATIVE]), (False, [Fate.RESIDUAL] * 2)):
        runs = dt.classify_many(equation, omegas, value=value)
        exact = np.isfinite(runs.omega_inf[:2])
        expected = np.where(exact, [Fate.POSITIVE, Fate.NEGATIVE], sense)
        np.testing.assert_array_equal(runs.fate[:2], expected)
