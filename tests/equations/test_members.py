"""What an equation offers is written in one place, the protocols of `_base.types`."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import pytest

import dipoletop as dt
from dipoletop import equations
from dipoletop._base.types import DecidingEquation, Equation, FullEquation, OptionalMembers
from dipoletop.equations._common import has_body_field, is_full

BODY = dt.axisymmetric(-0.2)
CLASSES = [getattr(equations, name) for name in equations.__all__]
EQUATIONS = [
    kind(BODY)
    if "body" in kind.__dataclass_fields__
    else kind(*[0.1] * sum(name != "order" for name in kind.__dataclass_fields__))
    for kind in CLASSES
    if isinstance(kind, type) and kind is not dt.Level
]
OF_THEIR_OWN = {"lyapunov", "domain"}  # which users ask of the rotator, but the library does not
NAMES = {type(equation).__name__ for equation in EQUATIONS}


def members(protocol):
    """The public names that a protocol lists."""
    kinds = [kind for kind in protocol.__mro__ if kind.__module__ == Equation.__module__]
    names = {name for kind in kinds for name in (*vars(kind), *vars(kind)["__annotations__"])}
    return {name for name in names if not name.startswith("_")}


def test_all_equations_are_looked_at():
    assert set(equations.__all__) - {"Level", "equation_at"} == NAMES


@pytest.mark.parametrize("equation", EQUATIONS, ids=lambda equation: type(equation).__name__)
def test_an_equation_offers_nothing_else(equation):
    fields = {field.name for field in dataclasses.fields(equation)}
    public = {name for name in dir(type(equation)) if not name.startswith("_")} - OF_THEIR_OWN
    assert public <= members(OptionalMembers) | members(FullEquation) | fields
    assert isinstance(equation, Equation)


def test_which_equations_are_full_and_which_decide():
    full = {type(equation).__name__ for equation in EQUATIONS if is_full(equation)}
    assert full == {"Full", "LongitudinalFull", "RotatorFull", "TransverseFull"}
    for equation in EQUATIONS:
        if is_full(equation) and not hasattr(equation, "branch"):
            assert all(hasattr(equation, name) for name in members(FullEquation))
    silent = {type(e).__name__ for e in EQUATIONS if not isinstance(e, DecidingEquation)}
    assert silent == {"TransverseAveraged", "TransverseLinearised"}


def test_which_bodies_are_parameters():
    free = {type(equation).__name__ for equation in EQUATIONS if has_body_field(equation)}
    assert free == {"Full", "Reduced", "SemiReduced"}


@pytest.mark.slow
def test_a_body_that_is_no_field_is_no_parameter():
    """A plain class has no arrays that vary, so its gradient is that with respect to ω₀ only."""

    class Plain:
        def __init__(self):
            self.inner = dt.TransverseReduced(-0.2)
            self.body = self.inner.body

        def __call__(self, t, y, args=None):
            return self.inner(t, y)

        def lift(self, omega0):
            return omega0

        def omega(self, y):
            return y

        def verdict(self, y):
            return self.inner.verdict(y)

    assert not has_body_field(Plain())
    start = jnp.array([0.2, 0.01, 0.01])
    slopes = [jax.grad(partial(dt.residual_rotation, e))(start) for e in (Plain(), Plain().inner)]
    assert jnp.allclose(*slopes, rtol=1e-6)
