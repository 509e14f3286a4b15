"""The torques on a real body at one rotation, side by side: which one rules."""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import concrete, finite, instance, on_host, shape_of, where_valid
from .._base.compiling import compiled_soon
from .._base.guards import safe_sqrt
from .._base.linalg import cross, dot, length, matvec, scale
from .._base.pictured import Pictured
from .._base.quantities import ANGULAR
from .._base.refusals import refuse
from .._base.roots import root
from .._base.summaries import duration
from .._base.types import Vector
from ..particles import Particle
from ..particles.moments import stable_axis
from ..particles.starts import refuse_relativistic
from ..particles.units import BOLTZMANN, HBAR, speed_in_rad
from .blackbody import Blackbody
from .gas import Gas
from .radiation_reaction import RadiationReaction
from .surrounding import Surrounding, above_zero, zero_or_more

NAMES = "radiation", "gas", "blackbody"
WORDS = {"radiation": "its own radiation", "gas": "the gas", "blackbody": "thermal radiation"}
COLDEST, HOTTEST = 1e-6, 1e9  # temperatures between which that of equal rates is searched, K
HALVINGS = 60
THIN = 10.0
"""The mean free path over the radius below which a gas is not called rarefied."""


class Balance(Pictured, eqx.Module):
    """The torques on a particle at one rotation, or at many.

    Numbers have the shape of the rotations and of the surroundings, broadcast together.

    Attributes:
        particle: the particle.
        omega: Ω in body axes, rad/s.
        surroundings: what acts on it.
        rates: the rate −L·M/L² at which each torque M reduces the angular momentum, 1/s, by the
            names "radiation", "gas", "blackbody" and "field"; NaN for "blackbody" if the loss is
            not known, and for "field" without one.
        torques: the torques in body axes, N m.
        diffusion: the noise that belongs to each, in body axes: D with ⟨MᵢMⱼ⟩ = 2Dᵢⱼδ, (N m)² s.
        equal_pressure: the pressure at which the gas would brake as much as radiation, Pa; NaN
            for a body without a shape.
        equal_temperature: the temperature at which the blackbody would, K; NaN if that is not
            known.
        thermal_spin: √(kT/I), rad/s, about the axis of rotation: below it the motion is random.
        stress: an estimate of the centrifugal stress, Pa: exact to some ten per cent for a sphere
            and for a long rod; NaN for a body without a shape.
        strength: the stress at which the material breaks, Pa; NaN if that is not known.
        knudsen: the mean free path of the gas over the radius of the body; the formulas hold where
            it is large. NaN for a body without a shape.
        libration: √(dE/I), the frequency of small librations of the dipole about a field E across
            the axis of rotation, rad/s; NaN without a field.
    """

    particle: Particle
    omega: Float[Array, "*batch 3"]
    surroundings: tuple[Surrounding, ...]
    rates: dict[str, Float[Array, "*batch"]]
    torques: dict[str, Float[Array, "*batch 3"]]
    diffusion: dict[str, Float[Array, "*batch 3 3"]]
    equal_pressure: Float[Array, "*batch"]
    equal_temperature: Float[Array, "*batch"]
    thermal_spin: Float[Array, "*batch"]
    stress: Float[Array, "*batch"]
    strength: Float[Array, "*batch"]
    knudsen: Float[Array, "*batch"]
    libration: Float[Array, "*batch"]

    @property
    def dominant(self) -> Any:
        """The name of the strongest friction that is known; an array of names for many rotations.

        A field is no friction, and does not count.
        """
        names = np.array(NAMES)
        rates = np.stack([np.nan_to_num(np.asarray(self.rates[name]), nan=-1.0) for name in NAMES])
        found = names[np.argmax(rates, axis=0)]
        return found if found.ndim else str(found)

    @property
    def times(self) -> dict[str, Float[Array, "*batch"]]:
        """The times 1/rate, s; infinite for what does not act."""
        return {name: 1 / rate for name, rate in self.rates.items()}

    @property
    def sentence(self) -> str:
        """One line: which friction rules, and by how much."""
        strongest = [name for name in NAMES if name in np.unique(self.dominant)]
        shown = " or ".join(WORDS[name] for name in strongest) + " brakes most"
        if len(strongest) == 1 and strongest[0] != "radiation":
            with np.errstate(all="ignore"):
                factor = np.asarray(self.rates[strongest[0]]) / np.asarray(self.rates["radiation"])
            if np.all(np.isfinite(factor)):
                shown += f", {_short(factor)} times as fast as radiation"
        return shown + ("" if self._knows("blackbody") else "; thermal radiation is not known")

    def _knows(self, name: str) -> bool:
        return not np.all(np.isnan(np.asarray(self.rates[name])))

    def __repr__(self) -> str:
        """Return a table of rates and times, and the limits of the motion; traced: the shapes."""
        if not concrete(self):
            return eqx.tree_pformat(self)
        speed = np.linalg.norm(np.asarray(self.omega), axis=-1)
        lines = [f"Ω={_short(speed)} rad/s; {self.sentence}"]
        for name in (*NAMES, "field") if self._knows("field") else NAMES:
            rate = np.asarray(self.rates[name])
            if not self._knows(name):
                lines.append(f"{name:<10} not known: `loss` is not given")
            elif np.all(rate == 0):
                lines.append(f"{name:<10} none")
            else:
                with np.errstate(all="ignore"):
                    time = duration(float(1 / rate)) if rate.ndim == 0 else f"{_short(1 / rate)} s"
                lines.append(f"{name:<10} {_short(rate)} 1/s, {time}")
        limits = [
            ("gas = radiation at {} Pa", self.equal_pressure),
            ("blackbody = radiation at {} K", self.equal_temperature),
        ]
        others = [
            ("thermal spin {} rad/s", self.thermal_spin),
            ("stress {} Pa", self.stress),
            ("of a strength of {} Pa", self.strength),
            ("libration in the field {} rad/s", self.libration),
        ]
        for group in (limits, others):
            known = [text.format(_short(x)) for text, x in group if not np.all(np.isnan(x))]
            lines += ["; ".join(known)] if known else []
        lines += self._warnings()
        return "Balance({})".format("\n        ".join(lines))

    def _warnings(self) -> list[str]:
        """Say where a formula, or the body, does not hold."""
        found = []
        if np.any(np.asarray(self.knudsen) < THIN):
            found.append(f"the gas is not rarefied: mean free path/radius = {_short(self.knudsen)}")
        if np.any(np.asarray(self.stress) > np.asarray(self.strength)):
            found.append("the centrifugal stress exceeds the strength")
        speed = np.linalg.norm(np.asarray(self.omega), axis=-1)
        if np.any(speed < np.asarray(self.thermal_spin)):
            found.append("slower than the thermal spin: the rotation is random")
        bath: Any = self.surroundings[0]
        quanta = HBAR * speed / (BOLTZMANN * np.asarray(bath.temperature))
        if np.any(quanta > 1):
            found.append("ħΩ > kT: the noise is that of quanta, which is not counted")
        return found


def _short(values: Any) -> str:
    array = np.asarray(values)
    ends = dict.fromkeys(f"{end:.3g}" for end in (np.nanmin(array), np.nanmax(array)))
    return " to ".join(ends)


def balance(
    particle: Particle,
    spin: Any,
    *,
    pressure: Any = 0.0,
    temperature: Any = 300.0,
    loss: Any = None,
    field: Any = None,
    strength: Any = None,
) -> Balance:
    """Compare the torques on a body at one rotation: radiation, gas, thermal radiation, a field.

    The rate of a torque M is −L·M/L². About a principal axis across the dipole it is κΩ²/I for
    radiation, with κ = k d², and Γ/I for a gas and for thermal radiation. Of a field it is dE/L,
    which a field at the best angle reaches.

    Args:
        particle: a single particle.
        spin: Ω in body axes, rad/s, shape (3,) or (..., 3); or its size, a number or a text such
            as "1 GHz". A size alone means rotation about the axis of the largest moment of those
            across the dipole.
        pressure: p of air, Pa; or a `Gas`.
        temperature: T of the thermal radiation, of the body and of air, K; a `Gas` has its own.
        loss: χ = Im[(ε − 1)/(ε + 2)] of the material in the infrared, or a function for
            `Blackbody`; None if it is not known.
        field: the amplitude E of an applied field, V/m; None for no field.
        strength: the stress at which the material breaks, Pa; None if it is not known.
            Numbers may also be arrays, which broadcast with the leading axes of `spin`.

    Returns:
        A `Balance`.

    Raises:
        ValueError: a `spin` of zero, or a rim faster than 0.1 c; a number that is negative or
            not finite; a body without a shape in a gas, or with a loss.

    Example:
        >>> import dipoletop as dt
        >>> silica = dt.particles.paper_particles()[0].particle
        >>> dt.balance(silica, "1 GHz", pressure=1e-7, loss=0.1).dominant
        'gas'
    """
    instance("particle", particle, Particle)
    if particle.mass.ndim:
        refuse("particle", "be a single one (`jax.vmap` takes a batch)", "is a batch of them")
    omega = _rotation(particle, spin)
    refuse_relativistic("spin", particle, omega)
    gas = pressure if isinstance(pressure, Gas) else None
    numbers = {
        "pressure": gas.pressure if gas else zero_or_more("pressure", pressure, "Pa"),
        "temperature": above_zero("temperature", temperature, "K"),
        "loss": jnp.nan if loss is None or callable(loss) else zero_or_more("loss", loss),
        "field": jnp.nan if field is None else zero_or_more("field", field, "V/m"),
        "strength": jnp.nan if strength is None else above_zero("strength", strength, "Pa"),
    }
    given = [*numbers.values(), *jax.tree.leaves(gas)]
    shapes = [omega.shape[:-1], *map(jnp.shape, given)]
    try:
        batch = jnp.broadcast_shapes(*shapes)
    except ValueError:
        refuse("spin", "broadcast with the surroundings", f"is one of the shapes {shapes}")
    wide = {name: jnp.broadcast_to(x, batch) for name, x in numbers.items()}
    gas = gas or Gas(wide["pressure"], wide["temperature"])
    gas = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, batch), gas)
    acting: list[Surrounding] = [RadiationReaction(wide["temperature"])]
    if particle.shape is not None or np.any(on_host(wide["pressure"]) > 0):
        acting.append(gas)
    if loss is not None:
        acting.append(Blackbody(wide["temperature"], loss if callable(loss) else wide["loss"]))
    omega = jnp.moveaxis(jnp.broadcast_to(omega, (*batch, 3)), -1, 0)
    return _balance(particle, omega, tuple(acting), wide["field"], wide["strength"])


def rate_of(particle: Particle, omega: Vector, torque: Vector) -> Float[Array, "..."]:
    """Compute −L·M/L², the rate at which a torque M reduces the angular momentum."""
    momentum = matvec(particle.inertia, omega)
    return -dot(momentum, torque) / dot(momentum, momentum)


def _rotation(particle: Particle, spin: Any) -> Float[Array, "*batch 3"]:
    """Return Ω in body axes."""
    if isinstance(spin, str) or shape_of(spin) == ():
        speed = speed_in_rad("spin", spin)
        speed = where_valid("spin", speed, on_host(speed) > 0, "be positive")
        return speed * stable_axis(particle.dipole, particle.inertia)
    shape = shape_of(spin)
    if shape[-1] != 3:
        refuse("spin", "be a number or have shape (3,) or (..., 3)", f"has shape {shape}")
    omega = finite("spin", spin, shape, batch=False, unit=ANGULAR)
    return where_valid("spin", omega, (on_host(omega) != 0).any(axis=-1), "not be zero")


@compiled_soon
def _balance(
    particle: Particle,
    omega: Float[Array, "3 *batch"],
    acting: tuple[Surrounding, ...],
    field: Float[Array, "*batch"],
    strength: Float[Array, "*batch"],
) -> Balance:
    """Return the balance; the field and the strength are NaN if they are not given."""
    rates, torques, diffusion = {}, {}, {}
    for each in acting:
        torque = each.torque(particle, omega)
        rates[each.name] = rate_of(particle, omega, torque)
        torques[each.name] = jnp.moveaxis(torque, 0, -1)
        diffusion[each.name] = jnp.moveaxis(each.diffusion(particle, omega), (0, 1), (-2, -1))
    unknown, lanes = jnp.full_like(omega[0], jnp.nan), [1] * (omega.ndim - 1)
    momentum, speed = matvec(particle.inertia, omega), length(omega)
    n = scale(1 / speed, omega)
    moment = dot(n, momentum) / speed
    drive = length(cross(n, particle.dipole.reshape(3, *lanes))) * field
    equal_pressure = stress = knudsen = equal_temperature = unknown
    by_name: dict[str, Any] = {each.name: each for each in acting}
    shape = particle.shape
    if shape is not None:
        gas = by_name["gas"]
        unit = dataclasses.replace(gas, pressure=jnp.ones_like(unknown))
        per_pascal = rate_of(particle, omega, unit.torque(particle, omega))
        equal_pressure = rates["radiation"] / per_pascal
        knudsen = gas.mean_free_path / shape.reach
        reach = shape.half_lengths.reshape(3, *lanes) * safe_sqrt(1 - n**2)
        density = particle.mass / shape.volume
        stress = shape.stress_factor * density * (speed * jnp.max(reach, axis=0)) ** 2
    if "blackbody" in by_name:
        thermal = by_name["blackbody"]

        def excess(log_temperature: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
            heated = dataclasses.replace(thermal, temperature=jnp.exp(log_temperature))
            found = rate_of(particle, omega, heated.torque(particle, omega))
            return found - rates["radiation"]

        coldest, hottest = (jnp.full_like(unknown, math.log(t)) for t in (COLDEST, HOTTEST))
        found = jnp.exp(root(excess, coldest, hottest, HALVINGS))
        inside = (excess(coldest) < 0) & (excess(hottest) > 0)
        equal_temperature = jnp.where(inside, found, jnp.nan)
    libration, bath = jnp.sqrt(drive / moment), by_name["radiation"]
    if "gas" not in rates:  # nothing to hit
        rates["gas"] = jnp.zeros_like(unknown)
    known = {name: rates.get(name, unknown) for name in NAMES}
    return Balance(
        particle=particle,
        omega=jnp.moveaxis(omega, 0, -1),
        surroundings=acting,
        rates=known | {"field": drive / length(momentum)},
        torques=torques,
        diffusion=diffusion,
        equal_pressure=equal_pressure,
        equal_temperature=equal_temperature,
        thermal_spin=jnp.sqrt(BOLTZMANN * bath.temperature / moment),
        stress=stress,
        strength=strength,
        knudsen=knudsen,
        libration=libration,
    )
