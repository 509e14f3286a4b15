"""What `simulate` passes on to diffrax: steps, events, what is saved, progress, plain functions."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import dipoletop as dt

ROTATOR = dt.TransverseReduced(0.3)
SPIN = [0.0, 1.0, 0.0]


def law(t):
    """ω₂ of the rotator, equation (2.4)."""
    return 1 / np.sqrt(1 + 2 * np.asarray(t))


def test_constant_steps():
    options = {"solver": diffrax.Dopri5(), "stepsize_controller": diffrax.ConstantStepSize()}
    errors = []
    for step in (0.2, 0.1):
        run = dt.simulate(ROTATOR, SPIN, [0.0, 4.0], dt0=step, **options)
        assert run.stats["num_steps"] == round(4 / step)
        errors.append(abs(float(run.omega[-1, 1]) - law(4.0)))
    assert errors[0] / errors[1] > 25  # of order 5


def test_the_first_step():
    first = dt.simulate(ROTATOR, SPIN, [0.0, 4.0], dt0=1e-3, saveat=diffrax.SaveAt(steps=True))
    assert first.ts[0] == pytest.approx(1e-3)


def slow(t, y, args):
    return y[1] - 0.5


EVENT = diffrax.Event(slow, optimistix.Newton(1e-12, 1e-12))
REACHED = 1.5  # 1/√(1 + 2τ) = ½


@pytest.mark.parametrize(
    "extra",
    [
        {},
        pytest.param({"balance": True, "attitude": [1.0, 0, 0, 0]}, marks=pytest.mark.slow),
    ],
)
def test_an_event_ends_the_run_where_it_happens(extra):
    """Its conditions see the state of the equation, whatever is integrated besides."""
    ts = jnp.linspace(0.0, 4.0, 9)
    run = dt.simulate(ROTATOR, SPIN, ts, event=EVENT, **extra)
    np.testing.assert_allclose(run.ts, np.minimum(ts, REACHED), atol=1e-9)
    np.testing.assert_allclose(run.omega[:, 1], law(np.minimum(ts, REACHED)), rtol=1e-9)
    if extra:
        np.testing.assert_allclose(run.attitude[-1], run.attitude[-3])
        # The defect is that of order 1; the whole integral ends with the run.
        np.testing.assert_array_equal(run.emitted[-3:], run.emitted[-1])


@pytest.mark.slow
def test_an_event_that_does_not_happen_changes_nothing():
    ts = jnp.linspace(0.0, 1.0, 5)
    plain, other = dt.simulate(ROTATOR, SPIN, ts), dt.simulate(ROTATOR, SPIN, ts, event=EVENT)
    np.testing.assert_allclose(plain.ys, other.ys, rtol=1e-14)
    np.testing.assert_array_equal(plain.ts, other.ts)


@pytest.mark.slow
def test_a_run_that_fails_before_its_event_is_told_and_not_filled_up():
    ts = jnp.linspace(0.0, 4.0, 9)
    with pytest.raises(RuntimeError, match="`max_steps` = 2 steps did not suffice"):
        dt.simulate(ROTATOR, SPIN, ts, event=EVENT, max_steps=2)
    run = dt.simulate(ROTATOR, SPIN, ts, event=EVENT, max_steps=2, throw=False)
    assert np.isnan(run.omega[-1]).all()


@pytest.mark.slow
def test_events_in_a_trace_and_their_derivative():
    """1/ω² grows by 2τ, (2.4), so the event is at τ = (4 − 1/ω₀²)/2."""

    def end(w):
        run = dt.simulate(ROTATOR, jnp.stack([0.0 * w, w, 0.0 * w]), [0.0, 9.0], event=EVENT)
        return run.ts[-1]

    speeds = np.array([0.8, 1.0, 2.0])
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(end)))(jnp.asarray(speeds))
    np.testing.assert_allclose(found, (4 - 1 / speeds**2) / 2, rtol=1e-9)
    np.testing.assert_allclose(slopes, speeds**-3.0, rtol=1e-6)


@pytest.mark.slow
def test_every_step_is_saved_and_no_place_is_left_empty():
    saveat = diffrax.SaveAt(t0=True, steps=True)
    run = dt.simulate(ROTATOR, SPIN, [0.0, 4.0], saveat=saveat, balance=True)
    assert len(run.ts) == int(run.stats["num_accepted_steps"]) + 1
    np.testing.assert_allclose(run.omega[:, 1], law(run.ts), rtol=1e-9)
    assert run.emitted.shape == run.ts.shape
    options = {"saveat": saveat, "balance": True, "max_steps": 64}
    traced = jax.jit(lambda start: dt.simulate(ROTATOR, start, [0.0, 4.0], **options))(
        jnp.array(SPIN)
    )
    used = np.isfinite(traced.ts)
    assert used.sum() == len(run.ts)
    assert np.isnan(traced.ys[~used]).all()


def test_progress_is_shown(capsys):
    dt.simulate(ROTATOR, SPIN, [0.0, 4.0], progress_meter=diffrax.TextProgressMeter())
    assert "100.00%" in capsys.readouterr().out


def test_a_plain_function_is_an_equation():
    def damped(t, omega, args):
        return -0.5 * omega

    run = dt.simulate(damped, [1.0, 2.0, 3.0], [0.0, 2.0])
    np.testing.assert_allclose(run.omega[-1], np.exp(-1.0) * np.array([1.0, 2.0, 3.0]), rtol=1e-9)
    assert run.level == "damped"
    assert "Trajectory(damped: 2 times" in repr(run)
    with pytest.raises(ValueError, match="`equation` must have a body"):
        dt.simulate(damped, [1.0, 2.0, 3.0], [0.0, 2.0], balance=True)


@pytest.mark.slow
def test_a_plain_function_is_differentiated():
    def end(rate):
        return dt.simulate(lambda t, w, args: -rate * w, [1.0, 0.0, 0.0], [0.0, 2.0]).omega[-1, 0]

    np.testing.assert_allclose(jax.jit(jax.grad(end))(0.5), -2 * np.exp(-1.0), rtol=1e-8)
