"""One simulation: reference digits, exact solutions, options, derivatives, refusals."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from settling import difference

import dipoletop as dt

# Order 1, δ = −1/5, ω⊥ = ω₃ = 1/5 (Fig. 2), from an integration in extended precision.
FIG_2 = {
    "a": (
        jnp.pi / 30,
        {
            10.0: [0.185555686561096036045, 0.05743298900673097677, 0.130962297180287836067],
            100.0: [0.1209087994924958206313, 0.05090107187023380722, 0.02679120426570824635],
            1000.0: [0.09887339256908715014567, 0.00077847913870556059, 0.00019391247310483405],
        },
    ),
    "b": (
        jnp.pi / 3,
        {
            10.0: [0.05404559122058723876573, 0.1260617421411106762582, 0.127760780811526733152],
            100.0: [-0.04514019174161701474, 0.03591698188708402409, 0.04922850368292863180],
            1000.0: [0.02613354341674689589, -0.00382910795663942604, 0.01195041984961604198],
            10000.0: [0.00271573533552523797, 0.00929826240567040816, 0.00236759169485001768],
        },
    ),
}


@pytest.mark.parametrize("case", FIG_2)
def test_figure_2_to_the_last_digits(case):
    phi, expected = FIG_2[case]
    ts = jnp.array([0.0, *FIG_2["b"][1]])
    run = dt.simulate(
        dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi), ts, rtol=1e-14, atol=1e-17
    )
    error = np.abs(run.omega[1 : 1 + len(expected)] - np.array(list(expected.values())))
    assert error.max() < 5e-14


@pytest.mark.parametrize("solver", [diffrax.Dopri8(), diffrax.Dopri5(), diffrax.Tsit5()])
def test_error_follows_the_tolerance(solver):
    """Plane rotator (2.4): Ω = Ω₀/√(1 + 2Ω₀²τ); any solver of diffrax may be passed."""
    for rtol in (1e-6, 1e-9):
        run = dt.simulate(
            dt.TransverseReduced(0.4),
            [0.0, 0.8, 0.0],
            jnp.array([0.0, 50.0]),
            rtol=rtol,
            solver=solver,
        )
        assert abs(float(run.omega[-1, 1]) * np.sqrt(1 + 2 * 0.64 * 50) / 0.8 - 1) < 20 * rtol


@pytest.mark.slow
def test_cylindrical_form_runs_the_same_motion():
    start, ts = dt.cylindrical(0.3, 0.2, 1.0), jnp.array([0.0, 40.0])
    flat = dt.simulate(dt.TransverseReduced(0.3), start, ts, rtol=1e-12)
    round_ = dt.simulate(dt.TransverseCylindrical(0.3), start, ts, rtol=1e-12)
    assert jnp.allclose(flat.omega, round_.omega, rtol=0, atol=1e-11)
    assert jnp.allclose(flat.omega_dot, round_.omega_dot, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_adjoint_controller_and_gradient_pass_through():
    @functools.partial(jax.jit, static_argnums=1)
    def end(delta, adjoint):
        run = dt.simulate(
            dt.TransverseReduced(delta),
            jnp.array([0.2, 0.1, 0.2]),
            jnp.array([0.0, 20.0]),
            rtol=1e-12,
            solver=diffrax.Tsit5(),  # few stages, each compiled four times
            adjoint=adjoint,
            stepsize_controller=diffrax.PIDController(1e-12, 1e-14),
            balance=True,
        )
        return run.omega[-1, 0] + run.energy[-1] + 10 * run.emitted[-1] + run.balance_defect[-1]

    direct = diffrax.RecursiveCheckpointAdjoint()
    reverse = jax.grad(end)(-0.2, direct)
    forward = jax.jvp(lambda d: end(d, diffrax.ForwardMode()), (-0.2,), (1.0,))[1]
    exact = difference(lambda d: end(-0.2 + d, direct), 1e-3)
    assert abs(float(reverse - forward)) < 1e-11
    assert abs(float(reverse - exact)) < 1e-9


@pytest.mark.slow
def test_what_was_not_reached_has_no_derivative():
    times = jnp.array([0.0, 1e-3, 1e3])

    def states(delta, start, adjoint):
        settings = {"max_steps": 5, "throw": False, "adjoint": adjoint}
        return dt.simulate(dt.TransverseReduced(delta), start, times, **settings).omega

    @jax.jit
    def both_ways(*at):
        forwards = jax.jacfwd(lambda *at: states(*at, diffrax.ForwardMode()), (0, 1))(*at)
        return forwards, jax.grad(lambda *at: jnp.sum(states(*at, None)[2]), (0, 1))(*at)

    forwards, backwards = both_ways(jnp.asarray(-0.2), jnp.array([0.2, 0.1, 0.2]))
    for slopes in forwards:
        assert np.all(np.isfinite(slopes[:2]))
        assert np.all(np.isnan(slopes[2]))
    for slope in backwards:
        assert np.all(np.isnan(slope))
