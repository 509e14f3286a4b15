"""The future of real particles, which turn far too often to follow every turn.

A particle of a laboratory has τ₀Ω ~ 1e-25 … 1e-17 and makes 1e17 … 1e25 turns while it brakes. Its
energy and its angular momentum hardly change during one turn, so they follow the averages over
free rotation (`_averaging`). `predict` follows this slow flow from a start to its end, at a cost
that does not depend on the amplitude.

Errors: averaging neglects relative changes of E and L within one period, of the order of τ₀Ω over
the relative difference of the moments. `Prediction.error` estimates it.

If two moments are so nearly equal that this error is large, the dipole lies on the axis of one of
the two, and the body rotates across its third axis, the limit of small amplitudes of a nearly
axisymmetric body applies (`_averaging.unfolding`): a needle is captured there, at a random or a
known phase. It replaces the slow flow where its error is smaller, and only for a concrete body and
start: it costs up to some seconds. With the dipole on the third axis the slow flow gives the end,
however near the two moments are. An oblique dipole of such a body is covered by the slow flow only,
as far as its error allows.

Where the error of these laws exceeds 1 %, the semi-reduced equation is integrated turn by turn, if
that takes at most 50 000 steps; again only for a concrete body and start.

Only radiation acts, in vacuum at temperature 0. `surroundings.balance` compares it with the torques
of a gas and of thermal radiation, which rule the rotation of most particles on Earth.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._averaging.ends import QUANTILES as QUANTILES
from ._averaging.laws import averaged_law_and_end, first_law, law_of
from ._averaging.predicted_ends import CERTAIN, LARGEST_ERROR, End, Start
from ._base.checks import (
    ArrayLike,
    concrete,
    finite,
    instance,
    namespace,
    on_device,
    on_host,
    where_valid,
)
from ._base.compiling import untraced
from ._base.pictured import Pictured
from ._base.quantities import ANGULAR
from ._base.refusals import refuse
from ._base.summaries import duration, with_error
from ._base.types import PREDICTED_FATES, Outcome, Regime, Stop, fate_of
from ._runs.resolved_law import HANDOVER, Resolved, resolved_law
from .bodies import Body
from .particles import RADIATION, Particle
from .particles.starts import refuse_relativistic
from .surroundings import Balance, balance

WEIGHTS = 0.15, 0.225, 0.25, 0.225, 0.15
"""The share of chance that each of the `QUANTILES` .05, .25, .5, .75, .95 stands for: it reaches
halfway to the next ones."""


class History(NamedTuple):
    """The motion at given times, averaged over one free rotation."""

    times: Float[Array, "T"]
    energy: Float[Array, "T"]
    """E."""
    momentum: Float[Array, "T"]
    """|L|."""
    shape: Float[Array, "T"]
    """h = 2E/L², between the reciprocals of the largest and of the smallest moment."""
    speed: Float[Array, "T"]
    """√⟨Ω²⟩."""


class Prediction(Pictured, End):
    """How a rotation ends, and how long that takes.

    Quantities are dimensionless for a `Body`, and in SI units for a `Particle`.

    Attributes:
        outcome: a member of `Outcome`: RESIDUAL or STOP if the ends of that kind together have a
            probability above 1 − 1e-6, else UNDECIDED, also if `error` exceeds 0.5; FAILED if the
            argument is not a number.
        probability: the probability of each `Fate` from POSITIVE to WOBBLING, shape (8,).
        omega_inf: ω∞ along the dipole, signed; 0 for a stop, NaN if chance decides its sign or the
            outcome is undecided.
        ratio: L∞/L₀, the mean over chance.
        ratio_quantiles: the `QUANTILES` of L∞/L₀, shape (5,).
        half_time: the time after which E − E∞ has fallen to one half; where chance decides, the
            mean of E − E∞. NaN for a needle of known phase if it is traced.
        radiated_energy: E₀ − E∞.
        lifetime: the time scale of the late law L² = L²ₚ/(1 + t/lifetime); infinite for residual
            rotation, NaN if chance decides, if a stop is UNFOLDED, or if no such law holds because
            L falls before the shape of the motion has come to its last value.
        regime: a member of `Regime`, the law that decided.
        error: estimated relative error of `ratio` and of the times; 0.5 if starts within the error
            have other ends, which then share the probability.
        balance: the `Balance` of all torques at the start, if surroundings were given. The other
            fields describe the body in vacuum at temperature 0, where only radiation acts.
    """

    variables: Float[Array, "*batch 15"] = eqx.field(repr=False)
    """Inertia, dipole and ω₀, in one vector."""
    strength: float = eqx.field(static=True)
    """The k of κ = k d²: 1 for a `Body`."""
    balance: Balance | None = eqx.field(default=None, repr=False)
    """The other torques at the start; None if no surroundings were given."""

    @property
    def fate(self) -> Int[Array | np.ndarray, "*batch"]:
        """The `Fate` with a probability above 1 − 1e-6; without one, what the outcome tells."""
        xp: Any = np if concrete(self.outcome) else jnp
        known = fate_of(self.outcome, Stop.NONE, xp.nan)
        certain = (xp.max(self.probability, axis=-1) > CERTAIN) & (self.outcome > Outcome.UNDECIDED)
        return xp.where(certain, xp.argmax(self.probability, axis=-1), known)

    def history(self, times: ArrayLike) -> History:
        """Return energy, angular momentum and speed at given times.

        Args:
            times: positive, shape (T,), in units of the body's time, or seconds for a `Particle`.

        Returns:
            A `History`, each field of shape (T,). NaN for a needle after its capture begins, if
            chance decides it. For an UNFOLDED rotation with a known phase the values are not
            averaged until it turns fast about its symmetry axis, and NaN long after a stop by
            tumbling has become certain. E and |L| of a RESOLVED rotation are not averaged while it
            is integrated.

        Raises:
            ValueError: times that are not positive and finite.
        """
        unit = "s" if self.strength != 1 else None
        given = finite("times", times, (-1,), batch=False, unit=unit)
        given = where_valid("times", given, given > 0, "be positive")
        start = Start(jnp.asarray(self.variables), jnp.asarray(self.strength, given.dtype))
        resolved = concrete(start, self.regime) and self.regime == Regime.RESOLVED
        law = Resolved() if resolved else law_of(start, jnp.asarray(self.regime))
        values = law.history(start, given)
        return History(given, *values)

    def __repr__(self) -> str:
        """Return the numbers of one prediction, quantiles of many, or the shapes of traced ones."""
        if not concrete(self):
            return eqx.tree_pformat(self)
        n, many = self.outcome.size, self.outcome.ndim > 0
        p = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(n, -1), self)
        inertia, omega = p.variables[:, :9].reshape(-1, 3, 3), p.variables[:, 12:]
        with np.errstate(all="ignore"):
            whole = np.einsum("ni,nij,nj->n", omega, inertia, omega)[:, None] / 2
            lost = p.radiated_energy / whole
        mean, error = float(np.mean(p.ratio)), float(np.max(p.error))
        ratio = f"{mean:.4g} on average" if many else with_error(mean, error * mean)
        if len(set(np.ravel(p.ratio_quantiles))) > 1:
            ratio += f" ({_quantiles(p.ratio_quantiles, WEIGHTS)})"
        rate, time, energy = (" rad/s", duration, " J") if self.strength != 1 else ("", _plain, "")
        names = [fate.name for fate in PREDICTED_FATES]
        first = [
            f"{n} starts: quantiles 0.1, 0.5, 0.9" if many else "",
            _shares((word.name, np.mean(p.outcome == word)) for word in Outcome),
            _shares(zip(names, np.mean(p.probability, axis=0), strict=True)),
            _shares((law.name, np.mean(p.regime == law)) for law in Regime),
            f"error up to {error:.1g}" if many else "",
        ]
        lines = [
            "; ".join(filter(None, first)),
            f"ratio={ratio}; omega_inf={_quantiles(p.omega_inf)}{rate}",
            f"half_time={_quantiles(p.half_time, form=time)}",
            f"lifetime={_quantiles(p.lifetime, form=time)}",
            f"radiated_energy={_quantiles(p.radiated_energy)}{energy}; {_quantiles(lost)} of E₀",
            "in vacuum at temperature 0" if self.balance is None else self.balance.sentence,
        ]
        return "Prediction({})".format("\n           ".join(lines))


def _shares(shares: Iterable[tuple[str, float]]) -> str:
    """What occurs, with its share unless that is 1."""
    return ", ".join(x if share == 1 else f"{share:.3g} {x}" for x, share in shares if share > 0)


def _plain(number: float) -> str:
    return f"{number:.6g}"


def _quantiles(
    values: Float[np.ndarray, "n m"],
    weights: Sequence[float] = (1.0,),
    form: Callable[[float], str] = _plain,
) -> str:
    """The quantiles 0.1, 0.5, 0.9 of the known values, one if all are the same."""
    known = ~np.isnan(values)
    if not known.any():
        return form(np.nan)
    weighted = np.broadcast_to(weights, values.shape)[known]
    found = np.quantile(values[known], (0.1, 0.5, 0.9), weights=weighted, method="inverted_cdf")
    texts = [form(x) for x in found]
    unknown = "" if known.all() else f" ({np.sum(~known)} not known)"
    return ", ".join(texts if len(set(texts)) > 1 else texts[:1]) + unknown


def predict(
    body: Body | Particle,
    omega0: ArrayLike,
    *,
    pressure: Any = None,
    temperature: Any = None,
    loss: Any = None,
) -> Prediction:
    """Predict how a rotation that radiates ends, by the slow flow of E and L where it holds.

        dE/dt = −κ⟨|n₂|²⟩,   d(L²)/dt = −2κ⟨L·(n₁×n₂)⟩,   averaged over free rotation,

    with n₁, n₂ the derivatives of the dipole's direction n in space. May be jitted, vmapped, and
    differentiated with respect to the inertia, the dipole and ω₀. By the inertia of a body with
    equal moments, a derivative holds for changes that keep them equal.

    Args:
        body: a `Body` (dimensionless), or a `Particle` (SI).
        omega0: initial angular velocity in body axes, shape (3,), not zero; dimensionless, or in
            rad/s for a `Particle`.
        pressure: the pressure around a particle, Pa, or a `Gas`, as for `balance`; with any of the
            surroundings the result says which torque brakes most at the start. The prediction
            itself counts radiation only.
        temperature: temperature of the surroundings, K.
        loss: χ, as for `balance`.

    Returns:
        A `Prediction`, for a body in vacuum at temperature 0.

    Raises:
        ValueError: bad arguments; float64 is off; a rotation that no law here describes, or whose
            rim is relativistic. If ω₀ is traced, the former is UNDECIDED, and the latter is not
            checked.

    Example:
        >>> import dipoletop as dt
        >>> body = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [0, 0, 1])
        >>> prediction = dt.predict(body, [1e-20, 2e-20, 3e-20])
        >>> dt.Outcome(int(prediction.outcome)).name, f"{prediction.ratio:.6f}"
        ('RESIDUAL', '0.912825')
    """
    instance("body", body, Body | Particle, "be a Body or a Particle")
    if body.inertia.ndim != 2:
        refuse("body", "be a single one (`jax.vmap` takes a batch)", "is a batch of them")
    unit = ANGULAR if isinstance(body, Particle) else None
    omega = finite("omega0", omega0, (3,), batch=False, unit=unit)
    if omega.dtype != jnp.float64:
        hint = 'jax.config.update("jax_enable_x64", True) switches float64 on'
        refuse("omega0", "be float64", f"is {omega.dtype} ({hint})")
    omega = where_valid("omega0", omega, (on_host(omega) != 0).any(), "not be zero")
    strength = RADIATION if isinstance(body, Particle) else 1.0
    coupling = on_device(np.asarray(strength, omega.dtype))
    parts = [on_host(array).ravel() for array in (body.inertia, body.dipole, omega)]
    variables = on_device(namespace(*parts).concatenate(parts))
    if concrete(variables):
        refuse_relativistic("omega0", body, omega)
    compared = _compared(body, omega, pressure, temperature, loss)
    start = Start(variables, coupling)
    with untraced(start):
        first = first_law(body.inertia, body.dipole, omega, coupling)
        _, end = averaged_law_and_end(start, first)
        if concrete(start) and float(end.error) > HANDOVER:
            law = resolved_law(start, end.ratio)
            end = (law and law.end(start)) or end
            if end.error > LARGEST_ERROR:
                must = f"be so small that the estimated relative error is at most {LARGEST_ERROR}"
                was = f"makes it {float(end.error):.2g} (`classify` follows every turn)"
                refuse("omega0", must, was)
    return Prediction(**vars(end), variables=variables, strength=strength, balance=compared)


def _compared(
    body: Body | Particle, omega: Array, pressure: Any, temperature: Any, loss: Any
) -> Balance | None:
    """Return the balance of all torques, if any surroundings are given."""
    given = {"pressure": pressure, "temperature": temperature, "loss": loss}
    given = {name: value for name, value in given.items() if value is not None}
    if not given:
        return None
    if not isinstance(body, Particle):
        name = next(iter(given))
        refuse(name, "be None for a Body, which has no unit of torque", "is given")
    return balance(body, omega, **given)
