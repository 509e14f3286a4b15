"""Arguments of a wrong kind, as users meet them: without the type checks of the tests.

Each is refused in one sentence that names the argument, whoever asks.
"""

import json
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system

SETTING = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
import dipoletop as dt
from dipoletop import adaptive, boundary, continuation, fitting, particles, planar, plots
from dipoletop import noise, radiation, uncertainty
from dipoletop._maps.sweep import PointSweeps

equation, start, times = dt.TransverseReduced(-0.2), jnp.array([0.2, 0.1, 0.2]), jnp.arange(3.0)
grid = dt.Grid(w3=[0.1, 0.2], phi=[0.0, 1.0])
basin = dt.Basin(grid.dims, grid.shape, grid.coords, {"outcome": np.zeros(4)}, {})
many = dt.TransverseReduced(jnp.array([0.1, 0.2]))
noisy = noise.with_noise(equation, noise.Bath(1e-4))
two = dt.Body(jnp.stack([jnp.eye(3)] * 2), start)
ends = {"z": np.zeros(1)}
sweeps = PointSweeps(min, {"rtol": 1e-8})
found = boundary.Crossings(sweeps, ends, ends, np.zeros((1, 2)), np.ones((1, 2), int))
field = lambda t, y, args=None: -y
for code in json.load(sys.stdin):
    try:
        print(json.dumps(["returned", repr(eval(code))]))
    except Exception as error:
        print(json.dumps([type(error).__name__, str(error)]))
"""
EQUATION = "must be an equation of motion, callable and with methods .*, but is"
SINGLE = "must be a single one, but is a batch"
CASES = {
    "dt.simulate(start, equation, times)": f"`equation` {EQUATION} of type ArrayImpl",
    "dt.simulate(equation, times, start)": "`ts` must increase",
    "dt.simulate(dt.TransverseSemi, start, times)": f"`equation` {EQUATION} the class Transverse",
    "dt.simulate(planar.Planar(0.1), start, times)": f"`equation` {EQUATION} of type Planar",
    "dt.simulate(None, start, times)": f"`equation` {EQUATION} None",
    "dt.simulate(equation, 0.1, times)": r"`omega0` must have shape \(n,\), but has shape \(\)",
    "dt.simulate(equation, None, times)": r"`omega0` must be a real array of shape \(n,\), but is",
    "dt.classify(field, start)": f"`equation` {EQUATION} of type function",
    "dt.classify(equation, start, max_steps=2.5)": "`max_steps` must be a positive whole number, b",
    "dt.classify_many(field, start[None])": f"`equations` {EQUATION} of type function",
    "dt.classify(equation, start, value='no')": "`value` must be True, False or 'unchecked', but",
    "dt.residual_rotation(field, start)": f"`equation` {EQUATION} of type function",
    "dt.decay_time(field, start)": f"`equation` {EQUATION} of type function",
    "dt.equilibria(field)": f"`equation` {EQUATION} of type function",
    "dt.spectrum(field, start)": f"`equation` {EQUATION} of type function",
    "dt.slow_manifold(field, start)": "`equation` must be a full equation, but is function",
    "dt.threshold(3, 0.1, -0.9, 0.5)": "`family` must be a function .*, but is 3",
    "jax.jvp(lambda d: dt.simulate(dt.TransverseSemi(d), start, times).ys, (0.1,), (1.0,))": (
        "`adjoint` must be `diffrax.ForwardMode\\(\\)` for derivatives by `jax.jvp` or"
    ),
    "jax.jit(lambda: dt.sweep(lambda w3, phi: (equation, start), grid).steps)()": (
        "`problem` must be swept where nothing is traced .*, but is swept within a trace"
    ),
    "jax.grad(lambda d: dt.sweep(lambda w3, phi: (equation, d * start), grid).steps)(0.1)": (
        "`problem` must be swept where nothing is traced .*, but depends on a value that is"
    ),
    "dt.sweep(lambda w3, phi: (field, start), grid)": f"`equation` {EQUATION} of type function",
    "dt.sweep(lambda w3, phi: (equation, start), grid, derivatives=3)": "`derivatives` must be a n",
    "dt.sweep(lambda w3, phi: (equation, start), grid, store=5)": "`store` must be a path, but is",
    "dt.Sample(5, seed=0.5)": "`seed` must be a whole number, but is 0.5",
    "dt.atlas('1')": "`dipole` must be 1, 2 or 3, a principal axis, but is '1'",
    "dt.atlas(body=equation)": "`body` must be a Body or a Particle, but is of type Transverse",
    "dt.atlas(1, n=2.5)": "`n` must be an integer of at least 2, but is 2.5",
    "plots.atlas([basin])": "`atlases` must be an Atlas or a sequence of them, but is of type B",
    "plots.history(basin)": "`prediction` must be a Prediction, but is of type Basin",
    "boundary.minimal_kick(field, start)": f"`equation` {EQUATION} of type function",
    "boundary.edge_state(field, start, start)": f"`equation` {EQUATION} of type function",
    "boundary.fate(3)": "`basin` must be a Basin, but is 3",
    "boundary.normal(3, 'z')": "`crossings` must be a Crossings, but is 3",
    "boundary.normal(found, None)": "`names` must be a name or a sequence of names, but is None",
    "boundary.normal(found, 'z', distance='x')": "`distance` must be a real number, but is 'x'",
    "boundary.derivative(found, 3, 'z')": "`of` must be a name, but is 3",
    "boundary.trace(3, {})": "`crossing` must be a Crossings, but is 3",
    "boundary.trace(found, None)": "`bounds` must be a dict of pairs .*, but is None",
    "adaptive.refine(min, 3)": "`over` must be a Grid, but is 3",
    "adaptive.refine(min, grid, coarse=2.5)": "`coarse` must be a positive whole number, but",
    "fitting.design(min, {'x': (0.0, 1.0)}, seed='a')": "`seed` must be a whole number, not negat",
    "uncertainty.propagate(min, {'x': 0.0}, [[1.0]], store=1)": "`settings` must be among rtol, .*",
    "dt.Sample(5, draw=3)": "`draw` must be a function of a random key, or None, but is 3",
    "dt.Body(3, start)": r"`inertia` must have shape \(3, 3\), .*, but has shape \(\)",
    "dt.SemiReduced(equation)": "`body` must be a Body, but is of type TransverseReduced",
    "dt.TransverseReduced(np.eye(2), order=np.eye(2))": r"`delta` must have shape \(\)",
    "dt.Sample(np.eye(2))": r"`n` must be a positive whole number, but is array\(\[\[1., 0.\], \[0",
    "radiation.kinetic_energy(two, start)": "`body` must have its components on the leading axes",
    "radiation.kinetic_energy(equation, start)": "`body` must be a Body, but is of type Transvers",
    "radiation.radiated_power(equation.body, start[None], start)": r"`omega` must have shape \(3,",
    "radiation.radiation_torque(equation.body, start, start, 3)": "`omega_ddot` must have shape",
    "planar.saddle(0.1)": "`system` must be a Planar, but is 0.1",
    "planar.boundary(None, 0.1)": "`system` must be a Planar, but is None",
    "dt.exact.averaged(0.3, start, [])": "`tau` must hold at least one time, but holds none",
    "particles.particle_table(3)": "`rotators` must hold rotators, .*, but is 3",
    "continuation.thresholds(basin)": "`continuation` must be a Continuation, but is of type Basin",
    "plots.continuation('x')": "`continuation` must be a Continuation, but is 'x'",
    "plots.diagram('x')": "`continuation` must be a Continuation, but is 'x'",
    "basin.column('no')": "`name` must be a column of this basin .*, but is 'no'",
    "basin.derivative(3)": "`axis` must be among the `derivatives`",
    "plots.basin(3)": "`basin` must be a Basin, but is 3",
    "plots.basin(basin, ax=3)": "`ax` must be axes of matplotlib, or None, but is 3",
    "plots.basin(basin, unfold='no')": "`unfold` must be True or False, but is 'no'",
    "plots.compare(basin, None)": "`second` must be a Basin, but is None",
    "plots.compare(basin, basin, axes=[1])": "`axes` must be a pair of axes, or None, but has 1",
    "plots.trajectory('x')": "`trajectory` must be a Trajectory, or a dict of them, but is 'x'",
    "plots.basin(basin, at=1.0)": "`at` must be a dict from axes to their values, or None, but is",
    "plots.line(basin, at=1.0)": "`at` must be a dict from axes to their values, or None, but is",
    "plots.histogram(3)": "`found` must be a Basin or a Tally, but is 3",
    "plots.animate(3)": "`trajectory` must be a Trajectory, but is 3",
    "dt.torques.with_torque(3, dt.torques.drag(0.1))": f"`equation` {EQUATION} 3",
    "dt.torques.with_torque(many, dt.torques.drag(0.1))": f"`equation` {SINGLE}",
    "dt.torques.with_torque(equation, 0.1)": "`torque` must be a function of τ and ω, but is 0.1",
    "dt.torques.with_torque(equation, field, verdict=3)": "`verdict` must be a function of the st",
    "dt.torques.gas_drag(3, 1.0)": "`particle` must be a Particle, but is 3",
    "dt.balance(3, 1.0)": "`particle` must be a Particle, but is 3",
    "plots.balance(3)": "`balance` must be a Balance, but is 3",
    "dt.simulate(noisy, start, times)": "`equation` must be without noise .`noise.ensemble`",
    "dt.classify(noisy, start)": "`equation` must be without noise .`noise.ensemble`",
    "dt.classify_many(noisy, start[None])": "`equations` must be without noise",
    "dt.sweep(lambda w3, phi: (noisy, start), grid)": "`equation` must be without noise",
    "dt.tally(lambda omega0: (noisy, omega0), dt.Sample(4))": "`equation` must be without noise",
    "noise.with_noise(noisy, noise.Bath())": "`equation` must be without noise",
    "noise.with_noise(equation, 0.1)": "`bath` must be a Bath, but is 0.1",
    "noise.ensemble(equation, start, times)": "`noisy` must be an equation with noise",
    "noise.ensemble(noisy, start, times, n=0)": "`n` must be a positive whole number",
    "noise.averaged_ensemble(3, noise.Bath(), start, times)": "`body` must be a Body, but is 3",
    "noise.Bath.around(3)": "`particle` must be a Particle",
    "plots.unfold(dt)": "`basin` must be a Basin, but is of type module",
    "dt.residual_rotation(many, start)": f"`equation` {SINGLE}",
    "dt.residual_rotation(equation, start, max_steps=2**32)": "`max_steps` must be at most 214748",
    "dt.decay_time(many, start)": f"`equation` {SINGLE}",
    "dt.spectrum(many, start)": f"`equation` {SINGLE}",
    "dt.equilibria(many)": f"`equation` {SINGLE}",
    "dt.equilibria(dt.TransverseSemi)": f"`equation` {EQUATION} the class TransverseSemi",
    "dt.slow_manifold(dt.TransverseFull(many.delta), start)": f"`equation` {SINGLE}",
    "dt.SemiReduced(many)": "`body` must be a Body, but is of type TransverseReduced",
    "dt.Reduced(0.1)": "`body` must be a Body, but is 0.1",
    "dt.Full(None)": "`body` must be a Body, but is None",
    "dt.cylindrical(-0.1, 0.2, 0.3)": "`w_perp` must not be negative, but is -0.1",
    "dt.cylindrical(jnp.nan, 0.2, 0.3)": "`w_perp` must be finite, but is nan",
    "dt.cylindrical(0.1, jnp.inf, 0.3)": "`w3` must be finite, but is inf",
    "dt.cylindrical([0.1, -0.2], 0.2, 0.3)": "`w_perp` must not be negative, but has",
    "dt.cylindrical([0.1, 0.2], 0.2, [0.3] * 3)": "`w_perp` must have, with `w3` and",
    "dt.symmetry_cell(0, 0)": "`n_phi` must be a positive whole number, but is 0",
    "dt.symmetry_cell(4, 4, -1.0)": "`w3_max` must be positive, but is -1.0",
    "dt.Sample(2**63)": "`n` must be at most 9223372036854775807, but is 9223372036854775808",
    "dt.Sample(3, seed=2**70)": "`seed` must be at most",
}


@pytest.fixture(scope="module")
def answers():
    done = subprocess.run(
        [sys.executable, "-c", SETTING],
        input=json.dumps(list(CASES)),
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(CASES, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("code", CASES)
def test_a_wrong_kind_is_refused_in_one_sentence(answers, code):
    kind, sentence = answers[code]
    assert kind == "ValueError", sentence
    assert re.match(f"Argument {CASES[code]}", sentence), sentence
    assert "\n" not in sentence
    assert sentence.endswith(".")
