"""Checks of an installation against known values, run by `dipoletop validate`.

Every expected value is a closed form, an identity, the result of an independent method, or of an
integration in extended precision.
"""

import platform
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from . import exact, radiation
from ._base.types import Equation, Outcome
from ._maps.grids import Sample
from ._runs.classify import classify
from ._runs.classify_many import classify_many
from ._runs.simulate import simulate
from .equations.coordinates import cylindrical
from .equations.rigid import Reduced, SemiReduced
from .equations.transverse import TransverseFull, TransverseReduced, TransverseSemi

Values = ArrayLike | Sequence[float]

RTOL = 1e-12
TIMES = np.array([0.0, 10.0, 100.0, 1000.0, 10_000.0])
STATES = 64  # random states at which an identity is checked
MANY = 4096  # starts of every batch: the engine compiles once for equal sizes

# Order 1, δ = −1/5, ω⊥ = ω₃ = 1/5: the orbits of figure 2 at `TIMES` after the first.
RESIDUAL_ORBIT = (
    (0.185555686561096036045, 0.05743298900673097677, 0.130962297180287836067),
    (0.1209087994924958206313, 0.05090107187023380722, 0.02679120426570824635),
    (0.09887339256908715014567, 0.00077847913870556059, 0.00019391247310483405),
)
STOPPING_ORBIT = (
    (0.05404559122058723876573, 0.1260617421411106762582, 0.127760780811526733152),
    (-0.04514019174161701474, 0.03591698188708402409, 0.04922850368292863180),
    (0.02613354341674689589, -0.00382910795663942604, 0.01195041984961604198),
    (0.00271573533552523797, 0.00929826240567040816, 0.00236759169485001768),
)
RESIDUAL_ROTATION = 0.09887029638156489613509
# δ = −0.2, |ω₀| = 0.2: residual share of 200 000 isotropic starts.
RESIDUAL_SHARE = 0.5197


class Check(NamedTuple):
    """One computed number and its expected value."""

    name: str
    expected: float
    found: float
    scale: float
    """The scale of the error."""
    tolerance: float

    @property
    def error(self) -> float:
        """|found − expected| / scale."""
        return abs(self.found - self.expected) / self.scale

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; False if it is NaN."""
        return self.error <= self.tolerance

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "FAILED"
        numbers = f"{self.found:.12g}, expected {self.expected:.12g}"
        error = f"error {self.error:.1e}, allowed {self.tolerance:.1e}"
        return f"{verdict:6}  {self.name}: {numbers}; {error}"


def environment() -> str:
    """Return the versions of Python and packages, and JAX's devices, in one line."""
    names = ("dipoletop", "jax", "jaxlib", "diffrax", "equinox", "numpy")
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    devices = ", ".join(f"{device.platform}:{device.id}" for device in jax.devices())
    return f"Python {platform.python_version()}, {versions}; devices {devices}"


def run() -> Iterator[Check]:
    """Yield all checks; an exception becomes a failed check with its message."""
    for check in CHECKS:
        try:
            yield from check()
        except Exception as error:  # of any type: the check shows it
            reason = str(error).strip().splitlines()
            name = f"{check.__name__}: {reason[0] if reason else type(error).__name__}"
            yield Check(name, np.nan, np.nan, 1.0, 0.0)


def _worst(name: str, expected: Values, found: Values, *, scale: float, tolerance: float) -> Check:
    """Return the check of the component with the largest error, or of the first NaN."""
    expected, found = np.ravel(np.asarray(expected)), np.ravel(np.asarray(found))
    worst = int(np.argmax(np.abs(found - expected)))
    return Check(name, float(expected[worst]), float(found[worst]), scale, tolerance)


def float64() -> list[Check]:
    """Check that arithmetic is in double precision."""
    spacing = float(jnp.asarray(1.0) + 2.0**-52) - 1
    return [Check("double precision: (1 + 2⁻⁵²) − 1", 2.0**-52, spacing, 2.0**-52, 0.0)]


def figure_2() -> list[Check]:
    """Check the two orbits of the paper's figure 2."""
    checks = []
    for part, phi, orbit in (("a", np.pi / 30, RESIDUAL_ORBIT), ("b", np.pi / 3, STOPPING_ORBIT)):
        run = simulate(TransverseReduced(-0.2), cylindrical(0.2, 0.2, phi), TIMES, rtol=RTOL)
        for tau, expected, found in zip(TIMES[1:], orbit, np.asarray(run.omega)[1:], strict=False):
            scale = float(np.linalg.norm(expected))
            name = f"figure 2{part}, ω at τ = {tau:.0f}"
            checks.append(_worst(name, expected, found, scale=scale, tolerance=1e-9))
    return checks


def residual_rotation() -> list[Check]:
    """Check ω∞ of the run of figure 2a."""
    result = classify(TransverseReduced(-0.2), cylindrical(0.2, 0.2, np.pi / 30), rtol=RTOL)
    expected, name = RESIDUAL_ROTATION, "figure 2a, residual rotation ω∞"
    return [Check(name, expected, float(result.omega_inf), expected, 1e-9)]


def exact_solutions() -> list[Check]:
    """Check motions with closed forms."""
    order_1, semi = TransverseReduced, TransverseSemi
    cases = (
        ("rotator (2.4), order 1", order_1, 0.3, (0.0, 0.5, 0.0)),
        ("rotator (2.4), semi-reduced", semi, 0.3, (0.0, 0.5, 0.0)),
        ("plane motion ω₃ = 0, order 1", order_1, -0.3, (0.03, 0.4, 0.0)),
        ("sphere δ = 0, order 1", order_1, 0.0, (0.03, 0.24, 0.32)),
    )
    checks = []
    for name, family, delta, omega0 in cases:
        across = float(np.hypot(omega0[1], omega0[2]))
        expected = exact.transverse(delta, omega0, TIMES)
        found = simulate(family(delta), np.array(omega0), TIMES, rtol=RTOL).omega
        checks.append(_worst(name, expected, found, scale=across, tolerance=1e-10))
    return checks


def sphere() -> list[Check]:
    """Check ω∞ at δ = 0: ω₁ is constant, so ω∞ = ω₁ at the start."""
    starts = _starts(1)
    found = classify_many(TransverseReduced(0.0), starts).omega_inf
    name = f"sphere δ = 0, ω∞ of {MANY} starts"
    return [_worst(name, starts[:, 0], found, scale=0.2, tolerance=1e-12)]


def _starts(seed: int) -> Float[Array, "n 3"]:
    return Sample(MANY, amplitude=0.2, seed=seed).points(np.arange(MANY))


def _random_states(components: int) -> tuple[Float[Array, "n"], Float[Array, "n c"]]:
    rng = np.random.default_rng(0)
    delta = rng.uniform(-0.9, 0.9, STATES)
    return jnp.asarray(delta), jnp.asarray(rng.normal(size=(STATES, components)))


CLOSED_FORMS: tuple[tuple[str, Callable[..., Equation], Callable[..., Equation]], ...] = (
    ("order 1", TransverseReduced, Reduced),
    ("order 2", lambda delta: TransverseReduced(delta, 2), lambda body: Reduced(body, 2)),
    ("semi-reduced", TransverseSemi, SemiReduced),
)


def closed_forms() -> list[Check]:
    """Check the closed forms of section 4 against the equation of motion of a general body."""
    checks = []
    for level, special, general in CLOSED_FORMS:

        def both(delta: Array, omega: Array, special=special, general=general):
            equation = special(delta)
            return equation(0.0, omega), general(equation.body)(0.0, omega)

        expected, found = jax.jit(jax.vmap(both))(*_random_states(3))
        scale = float(jnp.max(jnp.abs(expected)))
        name = f"closed form = general body, {level}"
        checks.append(_worst(name, expected, found, scale=scale, tolerance=1e-12))
    return checks


def energy_balance() -> list[Check]:
    """Check the full equation: d/dτ(E − d₁·d₂) = −|d₂|² at every state."""

    def rates(delta: Array, y: Array) -> tuple[Array, Array]:
        equation = TransverseFull(delta)

        def stored(y: Array) -> Array:
            omega, rate = y[:3], equation(0.0, y)[:3]
            schott = radiation.schott_energy(equation.body, omega, rate)
            return radiation.kinetic_energy(equation.body, omega) - schott

        flow = equation(0.0, y)
        power = radiation.radiated_power(equation.body, y[:3], flow[:3])
        return -power, jax.jvp(stored, (y,), (flow,))[1]

    expected, found = jax.jit(jax.vmap(rates))(*_random_states(5))
    scale = float(jnp.max(jnp.abs(expected)))
    name = "energy balance, full equation"
    return [_worst(name, expected, found, scale=scale, tolerance=1e-12)]


def engine() -> list[Check]:
    """Check the engine that computes maps against single runs through diffrax."""
    few = slice(0, MANY, 32)
    starts, deltas = _starts(2), jnp.linspace(-0.45, 0.2, MANY)
    many = jax.tree.map(lambda x: x[few], classify_many(TransverseReduced(deltas), starts))
    single = jax.vmap(lambda d, w: classify(TransverseReduced(d), w))(deltas[few], starts[few])
    size = len(many.outcome)
    same = int(np.sum(np.asarray(single.outcome) == many.outcome))
    name = "maps' engine = diffrax, ω∞ of the same"
    value = _worst(name, single.omega_inf, many.omega_inf, scale=0.2, tolerance=1e-6)
    return [Check(f"maps' engine = diffrax, {size} outcomes", size, same, size, 0.0), value]


def residual_share() -> list[Check]:
    """Check the share of residual rotation within four standard errors."""
    outcome = classify_many(TransverseReduced(-0.2), _starts(3)).outcome
    share = float(np.mean(outcome == Outcome.RESIDUAL))
    spread = np.sqrt(RESIDUAL_SHARE * (1 - RESIDUAL_SHARE) * (1 / MANY + 1 / 200_000))
    name = f"residual share of {MANY} random starts"
    return [Check(name, RESIDUAL_SHARE, share, 1.0, 4 * float(spread))]


CHECKS: tuple[Callable[[], list[Check]], ...] = (
    float64,
    figure_2,
    residual_rotation,
    exact_solutions,
    sphere,
    closed_forms,
    energy_balance,
    engine,
    residual_share,
)
