"""What the page draws beside its sliders."""

import re

import pytest

from dipoletop.explorer import texts


@pytest.mark.parametrize("delta", [-0.9, -0.2, 0.0, 0.5])
def test_the_outline_of_a_shape_has_its_moments(delta):
    """I₃/I₁ of a homogeneous spheroid with the half-axes that are drawn is 1 − δ."""
    across, along = (float(x) for x in re.findall(r'r[xy]="([\d.]+)"', texts.outline(delta)))
    assert 2 * across**2 / (across**2 + along**2) == pytest.approx(1 - delta, abs=0.01)


def test_only_the_scale_of_shapes_has_outlines():
    assert texts.scale("delta", -1.0, 0.9).count("<ellipse") == texts.SHAPES
    scale = texts.scale("w_perp", 0.0, 0.5)
    assert "<ellipse" not in scale
    assert re.findall(r"<span>([\d.]+)</span>", scale) == ["0", "0.5"]
