"""Which torque rules: the paper's particles, magnets, arrays, limits, and what is said."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop.particles import magnetic_dipole, paper_particles
from dipoletop.surroundings import Gas

SPIN = 2e9 * np.pi
SILICA = paper_particles()[0].particle
BODY = dt.axisymmetric(-0.2)
BARE = dt.Particle(1e-18, 1e-33 * np.eye(3), [8e-27, 0, 0])
# Times in s at 1 GHz: gas at 1e-3 mbar, thermal radiation at 300 K and 77 K, the body's own
# radiation; the pressure in Pa at which gas and radiation are equal.
TIMES = {
    "silica sphere": (0.14, 5.5e7, 3.3e9, 1.8e15, 7.9e-18),
    "DAST about the long axis": (0.043, 3.9e7, 2.3e9, 8.7e6, 4.9e-10),
    "cellulose fibre": (0.036, 3.5e8, 2.1e10, 2.1e15, 1.7e-18),
    "CdSe sphere": (0.021, 4.2e5, None, 9.7e11, 2.2e-15),
    "CdS sphere": (0.018, 3.5e5, None, 8.1e11, 2.2e-15),
    "NdFeB sphere": (0.55, 2.2e8, 1.3e10, 1.5e11, 3.8e-13),
}


def rotators():
    yield from paper_particles()
    magnet = dt.Particle.sphere(50e-9, magnetic_dipole([5.24e-16, 0, 0]), density=7500)
    yield "NdFeB sphere", magnet, (0.0, 0.0, 1.0)


def near(value, digits):
    """Equal to the two digits of the table."""
    np.testing.assert_allclose(value, digits, rtol=0.03)


def test_particles_of_the_paper():
    for name, particle, axis in rotators():
        if name not in TIMES:
            continue
        (gas, hot, cold, own, equal), spin = TIMES[name], SPIN * np.array(axis)
        found = dt.balance(particle, spin, pressure=0.1, loss=0.1)
        near(found.times["gas"], gas)
        near(found.times["blackbody"], hot)
        near(found.times["radiation"], own)
        near(found.equal_pressure, equal)
        assert found.dominant == "gas"
        if cold:
            chilled = dt.balance(particle, spin, temperature=77.0, loss=0.1)
            near(chilled.times["blackbody"], cold)
        # At these values the rates are equal.
        same = dt.balance(particle, spin, loss=0.1, pressure=found.equal_pressure)
        np.testing.assert_allclose(same.rates["gas"], same.rates["radiation"], rtol=1e-12)
        warm = dt.balance(particle, spin, loss=0.1, temperature=found.equal_temperature)
        np.testing.assert_allclose(warm.rates["blackbody"], warm.rates["radiation"], rtol=1e-9)


def test_only_dast_is_braked_by_its_own_radiation():
    for name, particle, axis in paper_particles():
        spin = SPIN * np.array(axis)
        rules = dt.balance(particle, spin, pressure=1e-11, loss=0.1).dominant
        assert rules == ("radiation" if "DAST" in name else "blackbody")


def test_limits_of_the_motion():
    _, dast, _, fibre, cdse, _ = (each.particle for each in paper_particles())
    found = dt.balance(SILICA, SPIN, strength=1e8)
    np.testing.assert_allclose(found.stress, 8e7, rtol=0.1)
    np.testing.assert_allclose(found.thermal_spin, 2e6, rtol=0.05)
    np.testing.assert_allclose(dt.balance(fibre, SPIN).stress, 7e8, rtol=0.05)
    np.testing.assert_allclose(dt.balance(dast, SPIN).stress, 6e7, rtol=0.1)
    assert "exceeds the strength" in repr(dt.balance(SILICA, 2 * SPIN, strength=1e8))
    assert "the rotation is random" in repr(dt.balance(cdse, SPIN / 10))
    assert "not rarefied" in repr(dt.balance(SILICA, SPIN, pressure=1e5))
    assert "quanta" in repr(dt.balance(SILICA, SPIN, temperature=0.01))


def test_a_size_alone_means_the_stable_axis_across_the_dipole():
    dast = paper_particles()[2].particle
    found = dt.balance(dast, "1 GHz", field=1e4)
    np.testing.assert_allclose(np.abs(found.omega), [0, 0, SPIN], atol=1e-3)
    moment = dast.moment([0, 0, 1.0])
    size = jnp.linalg.norm(dast.dipole)
    np.testing.assert_allclose(found.libration, np.sqrt(size * 1e4 / moment), rtol=1e-12)
    np.testing.assert_allclose(found.rates["field"], size * 1e4 / moment / SPIN, rtol=1e-12)
    assert found.dominant == "radiation"


def test_arrays_of_speeds_and_pressures():
    particle = paper_particles()[1].particle
    spins = np.array([[0, SPIN, 0], [0, 10 * SPIN, 0]])[:, None]
    pressures = np.array([1e-12, 1e-10, 1e-6])
    found = dt.balance(particle, spins, pressure=pressures, loss=0.1)
    assert found.rates["radiation"].shape == (2, 3)
    assert found.dominant.tolist() == [["radiation", "radiation", "gas"]] * 2
    single = dt.balance(particle, spins[1, 0], pressure=pressures[2], loss=0.1)
    for name in ("radiation", "gas", "blackbody"):
        np.testing.assert_allclose(found.rates[name][1, 2], single.rates[name], rtol=1e-13)
        np.testing.assert_allclose(found.torques[name][1, 2], single.torques[name], rtol=1e-13)
        np.testing.assert_allclose(found.diffusion[name][1, 2], single.diffusion[name], rtol=1e-13)
    assert "the gas or" not in repr(found)
    assert "its own radiation or the gas brakes most" in repr(found)


def test_what_is_not_known_is_nan():
    found = dt.balance(BARE, SPIN)
    assert found.dominant == "radiation"
    assert found.rates["gas"] == 0
    assert np.isnan(found.rates["blackbody"])
    assert np.isnan(found.equal_pressure)
    assert "not known: `loss` is not given" in repr(found)


def test_another_gas_and_derivatives():
    helium = Gas(1e-7, 300.0, molecular_mass=6.64e-27, accommodation=0.4)
    found = dt.balance(SILICA, SPIN, pressure=helium)
    air = dt.balance(SILICA, SPIN, pressure=1e-7)
    ratio = 0.4 * np.sqrt(6.64e-27 / (28.97 * 1.66053906892e-27))
    np.testing.assert_allclose(found.rates["gas"] / air.rates["gas"], ratio, rtol=1e-12)

    def rate(pressure):
        return dt.balance(SILICA, SPIN, pressure=pressure).rates["gas"]

    slope = jax.grad(rate)(1e-7)
    np.testing.assert_allclose(slope, air.rates["gas"] / 1e-7, rtol=1e-12)


@pytest.mark.slow
def test_a_prediction_says_what_it_leaves_out():
    particle = paper_particles()[3].particle
    start = dt.particles.start(particle, "1 GHz", momentum=[1, 2, 3])
    assert repr(dt.predict(particle, start)).endswith("in vacuum at temperature 0)")
    found = dt.predict(particle, start, pressure=1e-7, loss=0.1)
    assert found.balance.dominant == "gas"
    assert "the gas brakes most" in repr(found).splitlines()[-1]


REFUSED = {
    "dt.balance(SILICA, 0.0)": "`spin` must be positive",
    "dt.balance(SILICA, [0.0, 0, 0])": "`spin` must not be zero",
    "dt.balance(SILICA, 1e16)": "`spin` must have a rim slower than 0.1 c, since",
    "dt.balance(SILICA, [1.0, 2.0])": r"`spin` must be a number or have shape \(3,\)",
    "dt.balance(SILICA, 1.0, pressure=-1.0)": "`pressure` must not be negative, but is -1",
    "dt.balance(SILICA, 1.0, temperature=0.0)": "`temperature` must be positive, but is 0",
    "dt.balance(SILICA, 1.0, temperature=np.nan)": "`temperature` must be finite",
    "dt.balance(SILICA, 1.0, loss=-0.1)": "`loss` must not be negative",
    "dt.balance(SILICA, 1.0, strength='much')": "`strength` must be a real",
    "dt.balance(BARE, 1.0, pressure=1.0)": "`particle` must have a `shape`, on which the drag",
    "dt.balance(BARE, 1.0, loss=0.1)": "`particle` must have a `shape`, on which the absorption",
    "dt.balance(SILICA, np.ones((2, 3)), pressure=[1.0, 2.0, 3.0])": "`spin` must broadcast with",
    "Gas(1.0, accommodation=1.5)": "`accommodation` must be at most 1, but is 1.5",
    "dt.predict(BODY, [1e-9, 0, 0], pressure=1.0)": "`pressure` must be None for a Body",
}


@pytest.mark.parametrize("call", REFUSED)
def test_refusals(call):
    with pytest.raises(ValueError, match=f"Argument {REFUSED[call]}"):
        eval(call)
