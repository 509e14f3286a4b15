"""Scenes: what may be explored, its quantities and their ranges."""

import jax.numpy as jnp
import pytest

import dipoletop as dt
from dipoletop.explorer import scenes

BODY = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [1, 0, 0])


def problem(delta, scale):
    return dt.TransverseSemi(delta), scale * jnp.array([0.1, 0.2, 0.3])


def test_an_equation_of_the_top_may_vary_its_shape_and_level():
    scene = scenes.scene_of(dt.TransverseReduced(0.3, order=2), {"w3": 0.1})
    assert scene.at_first == (dt.Level.ORDER_2,)
    assert dt.Level.SEMI in scene.levels
    assert scene.quantities["delta"].default == 0.3
    assert scene.quantities["w3"].default == 0.1


def test_other_equations_have_starts_only():
    scene = scenes.scene_of(dt.SemiReduced(BODY), None)
    assert "delta" not in scene.quantities
    assert scene.levels == ()
    assert scene.symmetric
    turned = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [1, 0, 0.2])
    assert not scenes.scene_of(dt.SemiReduced(turned), None).symmetric
    equation, omega0 = scene.problem_at(None)(w_perp=0.3, w3=0.2, phi=0.0)
    assert isinstance(equation, dt.SemiReduced)
    assert omega0.tolist() == [0.3, 0.0, 0.2]


def test_what_is_given_decides_how_starts_are_given():
    assert "amplitude" in scenes.scene_of(None, {"amplitude": 0.4}).systems[0]
    assert "w_perp" in scenes.scene_of(None, {"phi": (0.0, 1.0)}).systems[0]


def test_a_problem_has_the_quantities_of_its_arguments():
    scene = scenes.scene_of(problem, {"delta": (-0.5, 0.5), "scale": (0.5, 1.0)})
    assert scene.free == ("delta", "scale")
    assert scene.quantities["delta"].symbol == "δ"
    assert scene.quantities["scale"].symbol == "scale"
    assert scene.quantities["scale"].default == 0.75


@pytest.mark.parametrize(
    ("explored", "over", "sentence"),
    [
        (3, None, "Argument `problem` must be a function"),
        (dt.TransverseSemi(jnp.zeros(3)), None, "Argument `equation` must"),
        (None, {"gamma": 1.0}, "Argument `over` must name quantities .*but names 'gamma'"),
        (None, [1], "Argument `over` must map names of quantities to numbers or to ranges"),
        (None, {"w3": 0.1, "theta": 0.2}, "Argument `start` must be given by delta"),
        (None, {"delta": (0.5, -0.5)}, "Argument `delta` must have a range that increases"),
        (None, {"delta": (0.5, 1.5)}, r"Argument `delta` must lie in \[-1, 1\), but is 1.5"),
        (None, {"delta": "x"}, "Argument `delta` must be a finite number, but is 'x'"),
        (problem, {"delta": (-0.5, 0.5)}, "Argument `over` must give .*none for `scale`"),
        (problem, {"delta": (-0.5, 0.5), "scale": 1.0}, "Argument `over` must give a range for"),
        (problem, {"eta": 1.0}, "Argument `over` must name arguments of `problem`"),
    ],
)
def test_what_cannot_be_explored_is_refused(explored, over, sentence):
    with pytest.raises(ValueError, match=sentence):
        scenes.scene_of(explored, over)
