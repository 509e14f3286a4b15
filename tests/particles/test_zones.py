"""Bodies in whose neighbourhood a law degenerates: each has a prediction, like its neighbours."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Outcome
from dipoletop._averaging import capture

ACROSS, ALONG = np.eye(3)[0], np.eye(3)[2]
RNG = np.random.default_rng(4)


def top(delta, split=0.0):
    return np.array([1.0, 1.0 + split, 1.0 - delta])


SQUARE = [0.5, 0.5 + 1.3e-8, 1.0 + 1.3e-8]
SADDLE = np.array([0.45, 0.55**2 / (0.45**2 + 0.55**2), 1.0])  # J₂J₁² = (J₃−J₂)(J₃−J₁)²
ZONES = {
    "cylinder, length = radius": (top(-0.5), ACROSS, Outcome.STOP),
    "next to it": (top(-0.5 + 3e-6), ACROSS, Outcome.STOP),
    "disc": (top(-1.0), ACROSS, Outcome.STOP),
    "thin disc": (top(-1 + 1e-9), ACROSS, Outcome.STOP),
    "elliptic disc": (top(-1 + 1e-8, -1e-9), ACROSS, Outcome.STOP),
    "rod": (top(1 - 1e-5), ACROSS, Outcome.UNDECIDED),
    "needle along its axis": (top(1 - 1e-9), ALONG, Outcome.RESIDUAL),
    "nearly a sphere": (top(1e-7), ACROSS, Outcome.RESIDUAL),
    "square plate": (SQUARE, ACROSS, Outcome.STOP),
    "square plate, along its diagonal": (SQUARE, [1.0, 1.0, 0.0], Outcome.STOP),
    "middle axis, h* next to the axis": (SADDLE * [1, 1 + 2e-6, 1], [0.0, 1.0, 0.0], Outcome.STOP),
    "middle axis, h* next to no axis": (SADDLE * [1, 1 - 2e-6, 1], [0.0, 1.0, 0.0], Outcome.STOP),
}


# Their capture compiles for long.
SLOW = "rod", "nearly a sphere", "cylinder, length = radius", "next to it"
NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in ZONES]


@pytest.mark.parametrize("name", NAMES)
def test_no_zone_is_empty(name):
    moments, dipole, outcome = ZONES[name]
    body = dt.Body(np.diag(moments), dipole / np.linalg.norm(dipole))
    for omega in 1e-20 * RNG.normal(size=(2, 3)):
        predicted = dt.predict(body, omega)
        assert predicted.outcome == outcome
        assert predicted.error < 3e-3
        assert np.isfinite(predicted.half_time)


@pytest.mark.parametrize("delta", [-0.5, -1.0])
def test_half_times_of_degenerate_oblate_tops(delta):
    """Those of neighbours tend to them, and the closed form of the averaged top has them, too."""
    omega = 1e-9 * np.array([0.6, 0.0, 0.8])
    half, near = (
        float(dt.predict(dt.axisymmetric(d), omega).half_time) for d in (delta, delta + 1e-9)
    )
    assert half == pytest.approx(near, rel=1e-6)
    assert 0.7 < half * 1e-18 < 1.3
    then = np.asarray(dt.exact.averaged(delta, omega, half))
    moments = np.array([1.0, 1.0, 1 - delta])
    assert then**2 @ moments == pytest.approx(omega**2 @ moments / 2, rel=1e-8, abs=0)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [-0.5, -1.0])
def test_degenerate_tops_move_as_integrations(delta):
    """The energy of the first-order equation differs by O(ω) from its average."""
    omega = 1e-3 * np.array([0.6, 0.0, 0.8])
    body = dt.axisymmetric(delta)
    predicted = dt.predict(body, omega)
    times = np.array([0.0, 0.3, 1.0, 3.0]) * float(predicted.half_time)
    run = dt.simulate(dt.TransverseSemi(delta), omega, times, max_steps=500_000)
    energy = predicted.history(times[1:]).energy
    np.testing.assert_allclose(energy, run.energy[1:], rtol=5e-3)


@pytest.mark.slow
def test_distributions_of_capture_go_over_into_their_limits(monkeypatch):
    """Computed beyond the range of δ in which they usually are, and by their limits there."""
    limits = [jax.jit(capture.capture)(jnp.asarray(delta)) for delta in (0.0035, 0.9975)]
    monkeypatch.setattr(capture, "SMALLEST", 0.003)
    monkeypatch.setattr(capture, "LARGEST", 0.998)
    anew = jax.jit(lambda delta: capture.capture(delta))
    computed = [anew(jnp.asarray(delta)) for delta in (0.0035, 0.9975)]
    for limit, true in zip(limits, computed, strict=True):
        assert abs(float(limit.residual - true.residual)) < 1e-5
        off = np.abs(limit.log_quantiles() - true.log_quantiles())
        assert np.max(off) < float(limit.error)
        assert abs(float(limit.log_mean - true.log_mean)) < float(limit.error)


@pytest.mark.parametrize(("past", "outcome"), [(-1e-8, Outcome.STOP), (1e-8, Outcome.RESIDUAL)])
def test_the_end_changes_where_two_shapes_of_tumbling_meet(past, outcome):
    """At J₂ = 0.605504562095 the textbook form of f₁, by mpmath, has a double zero."""
    body = dt.Body(np.diag([0.5, 0.605504562095 + past, 1.0]), ACROSS)
    assert dt.predict(body, [2e-21, 3e-21, 9e-21]).outcome == outcome
