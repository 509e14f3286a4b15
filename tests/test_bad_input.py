"""Bad values of arguments are refused in one sentence that names the argument.

Of wrong kinds see `whole/test_refusals`.
"""
# ruff: noqa: F401 (the cases are code that uses what is imported)

import re

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import boundary, exact, planar, torques
from dipoletop._maps.sweep import PointSweeps
from dipoletop._runs.slow_runs import check_slow_flow
from dipoletop.adaptive import refine
from dipoletop.complexity import basin_entropy, boundary_dimension, uncertainty_exponent
from dipoletop.continuation import continuation, follow_spectrum
from dipoletop.emission import lines, stokes
from dipoletop.equations._common import OfOmega
from dipoletop.uncertainty import propagate, sobol

EQUATION, FULL = dt.TransverseReduced(-0.2), dt.TransverseFull(-0.2)
MANY, TWO = dt.TransverseReduced(jnp.array([0.1, 0.2])), dt.axisymmetric([0.1, 0.2])
START, TS, LEVEL = np.array([0.1, 0.2, 0.3]), [0.0, 1.0], [1.0, 0.0, 0.0, 0.0]
EQUATIONS = dt.TransverseReduced(jnp.zeros(4))
BODY = dt.Body(np.diag([0.6, 0.75, 1.0]), [0.0, 0.0, 1.0])
GRAIN = dt.Particle.cuboid([1e-7, 2e-8, 2.2e-8], [8e-27, 0.0, 0.0], density=2000)
BEAD = dt.Particle(1e-18, 1e-35 * np.eye(3), [0.0, 0.0, 1e-27])  # of no known radius
PULLED = torques.field_on_dipole(EQUATION, [0.0, 0.1, 0.0])
DRIVEN = torques.with_torque(EQUATION, PULLED, attitude=LEVEL)
SIDE, SQUARES = np.linspace(0.0, 1.0, 16), np.arange(99)[:, None] < np.full(99, 40)
BOX, STEPS, BOUNDS = dt.Grid(a=[0.0, 1.0], b=0.0), [0.1, 0.2], {"a": (0.1, 1.0), "b": (0.1, 0.2)}
MEAN, POINT = {"a": 0.0, "b": 0.0}, {"delta": -0.2, "w3": 0.1, "phi": 0.2}


class Known(OfOmega):
    """A motion without a body, which keeps rotating."""

    def __call__(self, t, y, args=None):
        return -y

    def verdict(self, y):
        return jnp.asarray(1), y[0], y[0] > 0


def plane(a, b):
    return Known(), jnp.stack([a, b, 0 * b])


def problem(delta, w3, phi):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


def own(t, y, args=None):
    return y


ENDS = {name: np.array([value]) for name, value in POINT.items()}
SWEEPS, SIDES = PointSweeps(problem, {}), np.array([[1, 5]])
FOUND = boundary.Crossings(SWEEPS, ENDS, ENDS, np.array([[0.2, 0.4]]), SIDES)
AXES = {"phi": (-1.0, 1.0), "w3": (0.0, 8.0)}

CASES = {
    # Equations
    "dt.TransverseReduced(1.0)": r"`delta` must lie in \[-1, 1\), but is 1.0",
    "dt.TransverseSemi(-1.01)": r"`delta` must lie in \[-1, 1\), but is -1.01",
    "dt.TransverseFull(jnp.nan)": r"`delta` must lie in \[-1, 1\), but is nan",
    "dt.LongitudinalSemi(1.0)": r"`delta` must lie in \[-1, 1\), but is 1",
    "dt.TransverseReduced('oblate')": "`delta` must be a real number",
    "dt.TransverseReduced(1j)": "`delta` must be a real number, but has dtype complex",
    "dt.TransverseReduced(jnp.array([0.1, 2.0]))": "but has 2",
    "dt.TransverseReduced(0.1, order=5)": "`order` must be 1, 2, 3 or 4, but is 5",
    "dt.LongitudinalReduced(0.0, 5)": "`order` must be 1, 2, 3 or 4, but is 5",
    "dt.Reduced(BODY, order=0)": "`order` must be 1, 2, 3 or 4",
    "dt.Reduced(BODY, order=True)": "but is True",
    "dt.equation_at('order-5', -0.2)": "`level` must be one of order-1, .*, but is 'order-5'",
    "dt.cylindrical('a', 0.1, 0.1)": "`w_perp` must be a real number",
    "dt.critical_manifold('a')": "`w` must be a real",
    # Simulations
    "dt.simulate(EQUATION, [0.1, 0.2], TS)": r"`omega0` must have shape \(3,\), but",
    "dt.simulate(FULL, jnp.ones(4), TS)": r"shape \(3,\), or \(5,\) for a whole .* shape \(4,\)",
    "dt.simulate(EQUATION, [0.1, jnp.nan, 0], TS)": "`omega0` must be finite",
    "dt.simulate(dt.RotatorFull(), START, TS)": "`omega0` must lie along axis 3",
    "dt.simulate(EQUATION, START, [0.0])": "`ts` must hold at least two times",
    "dt.simulate(EQUATION, START, [1.0, 0.0])": "`ts` must increase",
    "dt.simulate(EQUATION, START, [0.0, jnp.inf])": "`ts` must be finite",
    "dt.simulate(EQUATION, START, TS, rtol=1e-17)": "`rtol` must lie between",
    "dt.simulate(EQUATION, START, TS, rtol=jnp.nan)": "`rtol` must lie between",
    "dt.simulate(EQUATION, START, TS, atol=-1.0)": "`atol` must be finite and not neg",
    "dt.simulate(EQUATION, START, TS, max_steps=0)": "`max_steps` must be a pos",
    "dt.simulate(EQUATION, START, TS, max_steps=2**31)": "at most 2147483647, b",
    "dt.simulate(EQUATION, START, TS, method=1)": "but one is `method`",
    "dt.simulate(EQUATION, START, TS, stepsize=1)": "among .*dt0, event, saveat, progress_meter",
    "dt.simulate(EQUATION, START, TS, solver='Tsit5')": "`solver` must be a .* but is 'Tsit5'",
    "dt.simulate(EQUATION, START, TS, solver=diffrax.Tsit5)": "`solver` .* is the class Tsit5",
    "dt.simulate(EQUATION, START, TS, adjoint=1)": "`adjoint` must be an adj",
    "dt.simulate(EQUATION, START, TS, throw='no')": "`throw` must be True or",
    "dt.simulate(EQUATION, START, TS, stepsize_controller=1.0)": "`stepsize_controller` must be a",
    "dt.simulate(EQUATION, START, TS, stepsize_controller=diffrax.ConstantStepSize())": "`dt0`",
    "dt.simulate(EQUATION, START, TS, dt0=-1.0)": "`dt0` must be positive",
    "dt.simulate(EQUATION, START, TS, event=3)": "`event` must be an event of diffrax, ",
    "dt.simulate(EQUATION, START, TS, saveat=[0.0])": "`saveat` must be what diffrax saves",
    "dt.simulate(EQUATION, START, TS, saveat=diffrax.SaveAt(dense=True))": "saves something else",
    "dt.simulate(EQUATION, START, TS, saveat=diffrax.SaveAt(t1=True, fn=own))": "saves something",
    "dt.simulate(EQUATION, START, TS, progress_meter=True)": "`progress_meter` must be a",
    "dt.simulate(MANY, START, TS)": "`equation` must be a single one, but is a b",
    "dt.simulate(EQUATION, START, TS).evaluate(0.5)": "`dense` must be True",
    "dt.simulate(EQUATION, START, TS).balance_defect": "`balance` must be True",
    "dt.simulate(FULL, START, TS, solver=diffrax.Tsit5())": "`options` must be `throw`.* `solver`",
    "dt.simulate(FULL, START, TS, dt0=0.1)": "diffrax cannot follow .*one is `dt0`",
    "dt.simulate(FULL, START, TS, event=diffrax.Event(own))": "cannot follow .*one is `event`",
    "dt.simulate(FULL, START, TS, saveat=diffrax.SaveAt(t1=True))": "follow .*one is `saveat`",
    "dt.simulate(FULL, START, TS, progress_meter=diffrax.TextProgressMeter())": "`progress_meter`",
    "dt.simulate(EQUATION, START, TS, attitude=START)": r"`attitude` .* shape \(4,\), .* \(3,\)",
    "dt.simulate(EQUATION, START, TS, attitude=np.eye(4))": r"`attitude` .* has shape \(4, 4\)",
    "dt.simulate(EQUATION, START, TS, attitude=[1, 0, jnp.nan, 0])": "`attitude` must be finite",
    "dt.simulate(EQUATION, START, TS, attitude=np.zeros(4))": "a unit .* has 0, 0, 0 and 1 more",
    "dt.simulate(EQUATION, START, TS, attitude=[1 + 2e-6, 0, 0, 0])": "norm 1 within 1e-06, but",
    "dt.simulate(EQUATION, START, TS, attitude=True)": "`attitude` must be a real array",
    "dt.simulate(EQUATION, START, TS, attitude='level')": "`attitude` must be a real array",
    "dt.slow_manifold(dt.TransverseSemi(-0.2), START)": "`equation` must be a full equation, but",
    "dt.slow_manifold(FULL, START, rtol=2.0)": "`rtol` must lie between .* is 2",
    "dt.slow_manifold(FULL, [0.1, jnp.nan, 0.0])": "`omega` must be finite",
    # Classification
    "dt.classify(dt.TransverseAveraged(0.1), START)": r"`equation` must have a method `verdict\(y",
    "dt.classify(EQUATION, [1.0])": r"must have shape \(3,\), but has",
    "dt.classify(EQUATION, [1.0, jnp.inf, 0])": "must be finite",
    "dt.classify(EQUATION, START, rtol=0.0)": "`rtol` must lie betwe",
    "dt.classify(EQUATION, START, max_steps=2**31)": "be at most 2147483647, but is 2",
    "dt.classify(MANY, START)": "`equation` must be a single one, but is a batch",
    "dt.classify_many(EQUATION, START[None], max_steps=2**31)": "most 2147483647, bu",
    "dt.classify_many(EQUATION, START[None], max_steps=2**63)": "most 2147483647, bu",
    "jax.jit(lambda w: dt.classify_many(EQUATION, w).outcome)(START[None])": "`omegas` .* traced",
    "dt.classify_many(EQUATION, START)": r"`omegas` must have shape \(n, 3\), but has shape \(3,",
    "dt.classify_many(EQUATION, jnp.zeros((0, 3)))": "`omegas` must hold at least one start",
    "dt.classify_many(EQUATIONS, jnp.ones((5, 3)))": r"single equation or have 5 .* shape \(4,\)",
    "dt.classify_many(EQUATION, START[None], engine='fast')": "'jax' or 'native', but is 'fast'",
    "dt.classify_many(FULL, START[None], engine='native')": "'auto' or 'jax' .* equation is full",
    "check_slow_flow('yes', EQUATION)": "True or False, but is 'yes'",
    "jax.jit(lambda w: dt.classify(EQUATION, w, slow_flow=True))(START)": "the start is traced",
    "dt.classify(FULL, jnp.ones(5), slow_flow=True)": "is True, but the start is a whole state",
    "dt.sweep(problem, dt.Points(**ENDS), derivatives='w3', slow_flow=True)": "derivatives are wa",
    "dt.sweep(problem, dt.Points(**ENDS), derivatives=['mass'])": "`derivatives` must name arg",
    "dt.sweep(problem, dt.Points(**ENDS), derivatives=['w3', 'w3'])": "each argument once",
    "dt.sweep(problem, dt.Points(**ENDS), derivatives=['w3'], value=False)": "`value` must be True",
    # Torques
    "dt.simulate(DRIVEN, np.zeros(7), TS, attitude=LEVEL)": "`attitude` must be None for a whole",
    "torques.with_torque(EQUATION, lambda t, w: 0.1)": "`torque` must return an array of shape",
    "torques.with_torque(EQUATION, torques.drag(0.1), jumps=[np.nan])": "`jumps` must be finite",
    "torques.with_torque(EQUATION, torques.drag(0.1), jumps=np.eye(2))": "`jumps` must have",
    "torques.with_torque(EQUATION, lambda w: w)": "`torque` must take the arguments .τ, ω.",
    "torques.with_torque(DRIVEN, PULLED, attitude=LEVEL)": "`attitude` must be None, as `equation`",
    "torques.with_torque(EQUATION, PULLED, attitude=np.ones(4))": "`attitude` must be a unit quat",
    "torques.with_torque(dt.RotatorFull(), torques.drag(0.1))": "must be a level of a rigid body",
    "torques.drag([0.1, 0.2])": r"`gamma` must be a number or have shape \(3, 3\)",
    "torques.field_on_dipole(EQUATION, [1.0, 2.0])": "`field`",
    "torques.field_on_dipole(Known(), START)": "`equation` must have a body",
    "torques.rotating_field(1.0, np.nan)": "`frequency` must be finite",
    "torques.rotating_field(1.0, 1.0, axis=np.zeros(3))": "`axis` must not be zero",
    "dt.emission.damping_time(BEAD, 0.0)": "`temperature` must be positive, but is 0",
    "torques.gas_drag(BEAD, 1.0)": "`particle` must have a `shape`, on which the d",
    "dt.spectrum(torques.with_torque(EQUATION, torques.drag(0.1)), START)": "keep rotation along",
    "dt.spectrum(torques.with_torque(FULL, torques.drag(0.1)), START)": "keep rotation along",
    "dt.classify(torques.with_torque(EQUATION, torques.drag(0.1)), START)": "a method `verdict",
    # Stability, exact solutions, the plane, light
    "dt.spectrum(dt.TransverseAveraged(0.1), START)": "keep rotation along .* TransverseAveraged",
    "dt.spectrum(own, START)": "methods `lift.*, but is of type function, which has no",
    "dt.spectrum(EQUATION, [0.1, 0, 1e-12])": "be 0, or along a dipole .* has 0.1, 0, 1e-12",
    "dt.spectrum(EQUATION, [0.1, 0])": r"have shape \(3,\), but has shape \(2,\)",
    "exact.rotator(0.5, -1.0)": "`tau` must not be before the start, τ = 0, but",
    "exact.longitudinal(0.5, START, -1.0)": "`tau` must not be before the start, τ = 0, but",
    "exact.transverse(0.0, START, -1.0)": "`tau` must not be before the start, τ = 0, but",
    "exact.averaged(0.5, START, -1.0)": "`tau` must not be before the start, τ = 0, but",
    "exact.transverse(0.5, START, 1.0)": "`omega0` must have ω₃ = 0 or ω₁ = ω₂ = 0",
    "exact.longitudinal(1.5, START, 1.0)": r"`delta` must lie in \[-1, 1\], but is 1.5",
    "exact.transverse(1.0, START, 1.0)": r"`delta` must lie in \[-1, 1\), but is 1",
    "exact.averaged(1.0, START, 1.0)": r"`delta` must lie in \[-1, 1\), but is 1",
    "exact.rotator_closed_time(0.0)": "`w` must be positive, but is 0",
    "exact.averaged_time(0.5, [0.5, 0.0, 0.4], 1.0)": "`xi` must lie between ξ₀ and its limit",
    "exact.averaged_time(-0.8, [0.5, 0.0, 0.4], 0.5)": "`xi` must lie between",  # ξ* = 0.81
    "exact.averaged_time(0.5, [0.0, 0.0, 1.0], 1.0)": "`omega0` must have ω⊥ ≠ 0 and ω₃ ≠ 0",
    "planar.boundary(planar.Planar([-0.1, -0.2]), 0.0)": "`system` must have a single delta",
    "planar.boundary(planar.Planar(-0.1), [0.0, np.inf])": "`phi` must be finite",
    "planar.wobble([0.8, 0.9])": "`delta` must be a single number",
    "lines(TWO, START)": "`body` must",
    "lines(BODY, [1.0, 2.0])": "`omega` must",
    "lines(BODY, START, n=0)": "`n` must",
    "stokes(BODY, START, [0, 0, 0])": "`direction` must",
    # Predictions and atlases
    "dt.predict(TWO, START)": "`body` must be a single one",
    "dt.predict(BODY, [0.0, 0.0, 0.0])": "`omega0` must not be zero",
    "dt.predict(BODY, [0.0, 1.0])": "`omega0` must have shape",
    "dt.predict(BODY, [0.0, np.nan, 1.0])": "`omega0` must be finite",
    "dt.predict(GRAIN, [0.0, 1e16, 0.0])": "`omega0` must have a rim slower than 0.1 c",
    "dt.atlas()": "`dipole` must be given or else `body`, but neither is",
    "dt.atlas(dipole=4)": "`dipole` must be 1, 2 or 3, a principal axis, but is 4",
    "dt.atlas(dipole=1, n=1)": "`n` must be an integer of at least 2, but is 1",
    "dt.atlas(body=dt.axisymmetric(0.2))": "`body` must have three different moments, but has mom",
    # Boundaries
    "boundary.bisect(problem, {}, {})": "`a` must map",
    "boundary.bisect(problem, POINT, {'w3': 4.5})": "`b` must name",
    "boundary.bisect(problem, POINT, POINT | {'w3': [4.0, np.nan]})": "`w3` must be finite",
    "boundary.bisect(problem, POINT, POINT | {'delta': 2.0})": "`delta` must lie in",
    "boundary.bisect(problem, POINT, POINT | {'w3': 0.11})": "`b` must end otherwise",
    "boundary.bisect(problem, POINT, POINT, value=False)": "`settings` must be among",
    "boundary.normal(FOUND, [])": "`names` must hold at least one name",
    "boundary.normal(FOUND, ['x'])": "`names` must be among",
    "boundary.normal(FOUND, ['w3'], distance=np.nan)": "`distance` must be finite",
    "boundary.derivative(FOUND, 'w3', 'w3')": "`by` must name coordinates other than",
    "boundary.trace(FOUND, {'phi': (0.0, 1.0)})": "`bounds` must name two",
    "boundary.trace(FOUND, AXES | {'w3': (1.0, 1.0)})": r"`bounds\['w3'\]` must be a pair",
    "boundary.trace(FOUND, AXES, step=0.0)": "`step` must not be 0",
    "boundary.trace(FOUND, AXES, by='w3')": "`by` must name",
    "boundary.residual_share(problem, POINT, POINT, by='x')": "`by` must name",
    "boundary.residual_share(problem, POINT, POINT, parts=0)": "`parts` must be",
    "boundary.minimal_kick(EQUATION, START, components=[4])": "`components` must hold",
    "boundary.minimal_kick(MANY, START)": "`equation` must be a single one",
    "boundary.minimal_kick(EQUATION, START, largest=-1.0)": "`largest` must be",
    "boundary.edge_state(EQUATION, START, START, shape_tol=-1.0)": "`shape_tol` must lie between",
    "boundary.edge_state(EQUATION, START, START)": "`b` must end otherwise",
    # Maps and samples
    "refine(plane, dt.Grid(a=SIDE, b=0.5))": "`over` must have exactly two axes longer than 1",
    "refine(plane, dt.Grid(a=SIDE, b=SIDE[::-1]))": "its axis b is another one",
    "refine(plane, dt.Grid(a=SIDE, b=np.eye(3)))": "its axis b is another one",
    "refine(plane, dt.Grid(a=SIDE, z=SIDE))": "name the arguments of `problem`",
    "refine(plane, dt.Grid(a=SIDE, b=SIDE), coarse=0)": "`coarse` must be a positive whole number",
    "refine(plane, dt.Grid(a=SIDE, b=SIDE), omega_tol=0.0)": "`omega_tol` must be positive",
    "refine(plane, dt.Grid(a=SIDE, b=SIDE), value=False)": "`settings` must be .* hold 'value'",
    "refine(plane, dt.Grid(a=SIDE, b=SIDE), rtol=-1.0)": "`rtol` must",
    "basin_entropy(np.zeros(5, int))": "`labels` must be whole numbers over two axes",
    "basin_entropy(np.zeros((5, 5)))": "dtype float64",
    "basin_entropy(np.zeros((5, 5), int), box=1)": "whole number from 2 on, but is 1",
    "basin_entropy(np.zeros((5, 9), int), box=6)": "`box` must fit into labels",
    "boundary_dimension(np.zeros((99, 99), int))": "`labels` must have a boundary",
    "boundary_dimension([[1, 2], [3]])": "`labels` must be whole numbers over two",
    "boundary_dimension(np.eye(9, dtype=int))": "`scales` must hold three different",
    "boundary_dimension(SQUARES, scales=[1, 2, 0.5])": "`scales` must be a positive whole",
    "boundary_dimension(SQUARES, scales=3)": "`scales` must hold three different",
    "boundary_dimension(SQUARES, scales=[1, 2, 99])": "all below 99",
    "uncertainty_exponent(plane, BOX, epsilons=[0.1, 0.1])": "two different positive",
    "uncertainty_exponent(plane, BOX, epsilons=[0.1, -1.0])": "`epsilons` must hold",
    "uncertainty_exponent(plane, BOX, epsilons=STEPS, n=0)": "`n` must be",
    "uncertainty_exponent(plane, BOX, epsilons=STEPS, seed=-1)": "`seed` must",
    "uncertainty_exponent(plane, BOX, epsilons=STEPS, along='b')": "`along` must be one of a, but",
    "uncertainty_exponent(plane, BOX, epsilons=STEPS, value=False)": "`settings` .* hold 'value'",
    "uncertainty_exponent(plane, dt.Grid(a=0.5), epsilons=STEPS)": "an axis that is not fixed",
    "uncertainty_exponent(plane, dt.Grid(a=np.eye(2)), epsilons=STEPS)": "a is made of vectors",
    "continuation(-0.2)": "`delta` must be a list",
    "continuation([-0.2, 0.1], [0.1, 0.2])": "`delta` must be a list",
    "continuation([0.1, -0.2])": "`delta` must hold two or more values that rise",
    "continuation([-2, 0.1])": r"`delta` must lie in \[-1, 1\)",
    "continuation(0.1, [0.0, 0.1])": "`amplitude` must be positive",
    "continuation([0.1, 0.2], n=0)": "`n` must be a positive whole number",
    "continuation([0.1, 0.2], levels='order-5')": "`levels` must name some of order-1",
    "follow_spectrum([0.1, 0.2], levels=('semi', 'semi'))": "`levels` must name",
    "follow_spectrum([0.1, 0.2], levels=())": "`levels` must name",
    "follow_spectrum([0.1, 0.2], 0.0)": "`w` must not be 0",
    "follow_spectrum(0.1)": "`delta` must hold two or more values that rise",
    "propagate(plane, {}, np.eye(2))": "`mean` must be a dict of named numbers",
    "propagate(plane, {'a': 0.0, 'b': np.nan}, np.eye(2))": r"`mean\['b'\]` must be finite",
    "propagate(plane, {'a': 0.0, 'c': 1.0}, np.eye(2))": "name the arguments of `problem`",
    "propagate(plane, MEAN, np.eye(3))": r"`covariance` must have shape \(2, 2\)",
    "propagate(plane, MEAN, [[1.0, 0.1], [0.2, 1.0]])": "is not symmetric",
    "propagate(plane, MEAN, [[1.0, 2.0], [2.0, 1.0]])": "without a negative eigenvalue, but has",
    "propagate(plane, MEAN, np.eye(2), n=0)": "`n` must be a positive whole number",
    "sobol(plane, BOUNDS, n=100)": "`n` must be a power of two, but is 100",
    "sobol(plane, BOUNDS, n=16, seed=-1)": "`seed` must be a whole number, not negative",
    "sobol(plane, BOUNDS, n=16, most_unknown=np.nan)": "`most_unknown` must be finite",
    "sobol(plane, BOUNDS, n=16, target='time')": "`target` must be 'omega_inf' or 'residual'",
    "sobol(plane, {}, n=16)": "`bounds` must be a dict of pairs",
    "sobol(plane, BOUNDS | {'b': (1.0, 1.0)}, n=16)": r"`bounds\['b'\]` must be a pair low <",
    "sobol(plane, BOUNDS | {'b': 1.0}, n=16)": r"`bounds\['b'\]` must have shape \(2,\)",
    "sobol(plane, BOUNDS, n=16, target='residual')": "make the target vary, but it is 1 everywhere",
}


@pytest.mark.parametrize("code", CASES)
def test_bad_input_is_refused_in_one_sentence(code):
    with pytest.raises(ValueError, match=CASES[code]) as caught:
        eval(code)
    assert re.fullmatch(r"Argument `.*\.", str(caught.value))
