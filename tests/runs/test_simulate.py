"""One simulation: reference digits, exact solutions, options, derivatives, refusals."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

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
    h = 1e-3
    stencil = [(-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)]
    difference = sum(c * end(-0.2 + k * h, direct) for k, c in stencil) / h
    assert abs(float(reverse - forward)) < 1e-11
    assert abs(float(reverse - difference)) < 1e-9


def test_vmap_over_starts():
    starts = jnp.asarray(np.random.default_rng(3).normal(size=(4, 3)))
    ts = jnp.array([0.0, 3.0])

    @jax.jit
    def omega(start):
        return dt.simulate(dt.TransverseReduced(0.2), start, ts).omega

    for one, start in zip(jax.jit(jax.vmap(omega))(starts), starts, strict=True):
        assert jnp.allclose(one, omega(start), atol=1e-9)


EQUATION = dt.TransverseReduced(-0.2)


MANY = dt.TransverseReduced(jnp.array([0.1, 0.2]))


TS = jnp.array([0.0, 1.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dt.simulate(EQUATION, [0.1, 0.2], TS), r"`omega0` must have shape \(3,\), but"),
        (
            lambda: dt.simulate(dt.TransverseFull(0.1), jnp.ones(4), TS),
            r"shape \(3,\), or \(5,\) for a whole state, but has shape \(4,\)",
        ),
        (lambda: dt.simulate(EQUATION, [0.1, jnp.nan, 0], TS), "`omega0` must be finite"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), [0.0]), "`ts` must hold at least two times"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), [1.0, 0.0]), "`ts` must increase"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), [0.0, jnp.inf]), "`ts` must be finite"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, rtol=1e-17), "`rtol` must lie between"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, rtol=jnp.nan), "`rtol` must lie between"),
        (
            lambda: dt.simulate(EQUATION, jnp.ones(3), TS, atol=-1.0),
            "`atol` must be finite and not neg",
        ),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, max_steps=0), "`max_steps` must be a pos"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, max_steps=2**31), "at most 2147483647, b"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, method=1), "but one is `method`"),
        (
            lambda: dt.simulate(EQUATION, jnp.ones(3), TS, solver="Tsit5"),
            r"`solver` must be a solver of diffrax, such as .*, but is 'Tsit5'\.$",
        ),
        (
            lambda: dt.simulate(EQUATION, jnp.ones(3), TS, solver=diffrax.Tsit5),
            "`solver` must be a solver of diffrax, .*, but is the class Tsit5",
        ),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, adjoint=1), "`adjoint` must be an adj"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS, throw="no"), "`throw` must be True or"),
        (
            lambda: dt.simulate(EQUATION, jnp.ones(3), TS, stepsize_controller=1e-9),
            "`stepsize_controller` must be a step size controller of diffrax",
        ),
        (lambda: dt.simulate(EQUATION, TS, jnp.ones(3)), "`ts` must increase"),
        (lambda: dt.simulate(dt.TransverseSemi, jnp.ones(3), TS), "but is the class TransverseS"),
        (lambda: dt.simulate(MANY, jnp.ones(3), TS), "`equation` must be a single one, but is a b"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS).evaluate(0.5), "`dense` must be True"),
        (lambda: dt.simulate(EQUATION, jnp.ones(3), TS).balance_defect, "`balance` must be True"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.slow
def test_failure_raises_unless_told_otherwise():
    start, times = jnp.array([0.2, 0.1, 0.2]), jnp.array([0.0, 1e3])
    sentence = r"^The run ended before the last of `ts`: `max_steps` = 5 steps did not suffice\.$"
    with pytest.raises(RuntimeError, match=sentence):
        dt.simulate(EQUATION, start, times, max_steps=5)
    lost = r"^The physical branch of the full equation could not be followed .* did not suffice\.$"
    with pytest.raises(RuntimeError, match=lost):
        dt.simulate(dt.TransverseFull(-0.2), start, times, max_steps=1)
    run = dt.simulate(EQUATION, start, times, max_steps=5, throw=False)
    assert jnp.all(jnp.isnan(run.omega[-1]))
    assert jnp.all(run.omega[0] == start)


@pytest.mark.slow
def test_what_was_not_reached_has_no_derivative():
    times = jnp.array([0.0, 1e-3, 1e3])

    def states(delta, start, adjoint):
        settings = {"max_steps": 5, "throw": False, "adjoint": adjoint}
        return dt.simulate(dt.TransverseReduced(delta), start, times, **settings).omega

    at = jnp.asarray(-0.2), jnp.array([0.2, 0.1, 0.2])
    for slopes in jax.jacfwd(states, (0, 1))(*at, diffrax.ForwardMode()):
        assert jnp.all(jnp.isfinite(slopes[:2]))
        assert jnp.all(jnp.isnan(slopes[2]))
    for slope in jax.grad(lambda *at: jnp.sum(states(*at, None)[2]), (0, 1))(*at):
        assert jnp.all(jnp.isnan(slope))
