"""A trajectory: balance laws, energies and powers, batches, interpolation, how it prints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt

# Order 1, δ = −1/5, ω⊥ = ω₃ = 1/5, φ = π/30 (Fig. 2a), from an integration in extended precision.
FIG_2A_AT_10 = np.array([0.185555686561096036045, 0.05743298900673097677, 0.130962297180287836067])
WITH_ALL = {"dense": True, "balance": True}  # the same in several tests: one program


@eqx.filter_jit
def balance_defect(run):
    return run.balance_defect


@pytest.mark.parametrize("phi", [jnp.pi / 30, jnp.pi / 3])
def test_full_equation_keeps_the_energy_balance(phi):
    """d/dt(E − d₁·d₂) = −|d₂|² exactly, by the vector field, off the slow manifold too."""
    equation = dt.TransverseFull(-0.2)
    near = eqx.filter_jit(equation.lift)(dt.cylindrical(0.2, 0.2, phi))
    state = near.at[-1].add(1e-4)  # the rate of ω₃
    run = dt.simulate(equation, state, jnp.array([0.0, 6.0]), rtol=1e-13, balance=True)
    assert float(jnp.max(jnp.abs(balance_defect(run)))) < 1e-12


@pytest.mark.slow
def test_defect_of_a_reduced_level_falls_with_the_amplitude():
    """Order 1 leaves a defect of order ω², order 2 a smaller one that falls faster."""

    def defect(order, size):
        run = dt.simulate(
            dt.TransverseReduced(-0.4, order=order),
            dt.cylindrical(size, 0.5 * size, 0.6),
            jnp.array([0.0, 1 / size**2]),
            rtol=1e-12,
            **WITH_ALL,
        )
        return abs(float(balance_defect(run)[-1]))

    assert defect(1, 0.05) < defect(1, 0.1) / 1.5
    assert defect(2, 0.05) < defect(2, 0.1) / 5


def test_dense_output_and_statistics():
    run = dt.simulate(
        dt.TransverseReduced(-0.2),
        dt.cylindrical(0.2, 0.2, jnp.pi / 30),
        jnp.array([0.0, 100.0]),
        rtol=1e-12,
        **WITH_ALL,
    )
    assert jnp.allclose(run.evaluate(10.0), FIG_2A_AT_10, rtol=0, atol=1e-9)
    assert int(run.stats["num_steps"]) > 5
    assert run.level == "reduced, order 1 (the paper's)"
    steps = int(run.stats["num_steps"])
    shown = f"Trajectory(reduced, order 1 (the paper's): 2 times, 0 ≤ τ ≤ 100, {steps} steps)"
    assert repr(run) == shown


def test_tables_of_all_quantities_have_units():
    given = {"attitude": [1.0, 0.0, 0.0, 0.0], "balance": True}
    run = dt.simulate(dt.TransverseSemi(-0.2), [0.1, 0.2, 0.1], jnp.linspace(0.0, 9.0, 4), **given)
    data, table = run.to_xarray(), run.to_dataframe()
    assert data.attrs == {"level": "semi-reduced"}
    np.testing.assert_array_equal(data.omega, run.omega)
    assert list(table)[:6] == ["tau", "omega_1", "omega_2", "omega_3", "energy", "power"]
    units = table.attrs["units"]
    assert (units["tau"], units["omega_2"], units["power"]) == ("tau_0", "1/tau_0", "I_1/tau_0^3")
    expected = {"tau": run.ts, "emitted": run.emitted, "dipole_3": run.dipole[:, 2]}
    for name, column in expected.items():
        np.testing.assert_array_equal(table[name], column)
    assert "work" not in table
    two = jax.vmap(lambda s: dt.simulate(dt.TransverseSemi(-0.2), s, run.ts))(run.omega[:2])
    assert two.to_xarray().omega.dims == ("batch_1", "time", "component")
    assert len(two.to_dataframe()) == 8


@pytest.mark.slow
def test_a_batch_of_trajectories_has_all_properties_with_its_axes_in_front():
    """From states by NumPy: I = (1, 1, 1−δ), d = (1, 0, 0), d₁ = Ω×d, d₂ = Ω×d₁ + Ω̇×d."""
    starts = jnp.asarray(np.random.default_rng(4).normal(size=(2, 3)))
    deltas, ts = jnp.array([-0.2, 0.3, 0.1]), jnp.linspace(0.0, 0.5, 11)

    def run(delta, start):
        found = dt.simulate(dt.TransverseReduced(delta), start, ts, rtol=1e-12, **WITH_ALL)
        assert "ys=f64[11,3]" in repr(found)  # of what is traced, its shape
        return found

    runs = jax.jit(jax.vmap(jax.vmap(run, (None, 0)), (0, None)))(deltas, starts)
    omega = np.asarray(runs.ys)
    assert omega.shape == (3, 2, 11, 3)
    assert "3x2 runs, 11 times, 0 ≤ τ ≤ 0.5, " in repr(runs)
    delta = np.broadcast_to(np.asarray(deltas)[:, None, None], omega.shape[:-1])
    each = zip(deltas, jnp.moveaxis(runs.ys, -1, 1), strict=True)
    rate = np.stack([np.moveaxis(dt.TransverseReduced(d)(0.0, w), 0, -1) for d, w in each])
    moments = np.stack([np.ones_like(delta), np.ones_like(delta), 1 - delta], axis=-1)
    energy = np.sum(moments * omega**2, axis=-1) / 2
    dipole = np.array([1.0, 0.0, 0.0])
    first = np.cross(omega, dipole)
    second = np.cross(omega, first) + np.cross(rate, dipole)
    lent = energy - np.sum(first * second, axis=-1) + runs.emitted
    expected = {
        "omega": omega,
        "omega_dot": rate,
        "energy": energy,
        "power": np.sum(second**2, axis=-1),
        "balance_defect": (lent - lent[..., :1]) / energy[..., :1],
    }
    for name, value in expected.items():
        found = getattr(runs, name)
        assert found.shape == value.shape
        np.testing.assert_allclose(found, value, rtol=0, atol=1e-13)
    # The interpolation, at times of any shape, next to points that are known.
    between = runs.evaluate(ts[2:8].reshape(2, 3))
    np.testing.assert_allclose(between, omega[:, :, 2:8].reshape(3, 2, 2, 3, 3), atol=1e-7)
    one = jax.tree.map(lambda leaf: leaf[1, 0], runs)
    np.testing.assert_array_equal(one.evaluate(ts[4]), between[1, 0, 0, 2])
    with pytest.raises(ValueError, match=r"`t` must lie within the run, but is 0\.6"):
        runs.evaluate(0.6)
    wrong = eqx.tree_at(lambda run: run.ys, runs, jnp.moveaxis(runs.ys, 0, -1))
    with pytest.raises(ValueError, match="`trajectory` must have its batch axes in front"):
        _ = wrong.energy
