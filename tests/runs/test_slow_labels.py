"""Labels of motions that stay near the boundary between outcomes until they are slow."""

import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Outcome

STARTS = {
    # δ, ω₀, outcome. With an absolute tolerance of 1e-8·|ω₀| each has another one.
    "nearly spherical": (
        -0.004318976430217461,
        [0.0010392967864796992, 0.006953482374555247, -0.020717767713915272],
        Outcome.STOP,
    ),
    "needle": (
        0.7682573579815996,
        [9.314808574152744e-05, 0.00018717564789261712, -0.001182485594495953],
        Outcome.RESIDUAL,
    ),
    "needle near the birth of wobbling": (
        0.7546875428789213,
        [0.00018405434564703536, -0.00015184771678499658, -0.004810912812845824],
        Outcome.STOP,
    ),
}


@pytest.mark.parametrize("which", STARTS)
def test_a_slow_motion_keeps_its_label(which):
    delta, omega, outcome = STARTS[which]
    start, settings = np.array([omega]), {"engine": "native", "slow_flow": False}
    top = dt.TransverseSemi(delta)
    assert dt.classify_many(top, start, value=False, **settings).outcome == outcome
    assert dt.classify_many(top, start, value="unchecked", rtol=1e-11, **settings).outcome == (
        outcome
    )


def test_a_single_run_keeps_it_too():
    delta, omega, outcome = STARTS["nearly spherical"]
    run = dt.classify(dt.TransverseSemi(delta), jnp.array(omega), value=False, slow_flow=False)
    assert run.outcome == outcome


def test_no_label_is_given_where_the_tolerance_decides_nothing():
    """A needle 5e-4 above the birth of wobbling turns for ever before it is captured."""
    top, start = dt.TransverseSemi(0.7537584191132934), [[0.11330705, 0.25275985, 0.01310022]]
    run = dt.classify_many(top, np.array(start), value=False, slow_flow=False, max_steps=2000)
    assert run.outcome == Outcome.UNDECIDED


@pytest.mark.parametrize(
    ("top", "is_loose"),
    [
        (dt.TransverseSemi, [False, True, False]),
        (dt.TransverseReduced, [False, True, True]),
        (lambda delta: dt.TransverseReduced(delta, order=3), [False, True, False]),
        (dt.LongitudinalSemi, [True, True, True]),
    ],
)
def test_where_slow_motions_have_one_outcome_they_need_not_be_exact(top, is_loose, monkeypatch):
    """Seen by the absolute tolerance that the runs are given."""
    from dipoletop._runs import classify_many

    class Seen(Exception):
        pass

    def see(_equation, _omegas, limits, *_rest):
        raise Seen(limits.atol)

    monkeypatch.setattr(classify_many, "classify_block", see)
    tops, starts, given = top(jnp.array([-0.2, 0.2, 0.8])), np.array([[0.1, 0.2, 0.2]] * 3), []
    for value in (False, True):
        with pytest.raises(Seen) as seen:
            dt.classify_many(tops, starts, value=value, rtol=1e-6, engine="jax")
        given.append(np.asarray(seen.value.args[0])[:3])
    labels, values = given
    np.testing.assert_allclose(labels, np.where(is_loose, 0.3e-6, 0.0))
    np.testing.assert_array_equal(values, 0.0)
