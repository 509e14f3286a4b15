"""The code that a view writes: it runs, and gives the same map."""

import math
from dataclasses import replace

import jax.numpy as jnp
import pytest

import dipoletop as dt
from dipoletop.explorer import drawing, recipes, scenes, views

BODY = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [0.1, 0, 1 / 3])


def problem(delta, scale):
    return dt.TransverseSemi(delta), scale * jnp.array([0.1, 0.2, 0.3])


def views_of(explored, over=None, **changes):
    scene = scenes.scene_of(explored, over)
    view = views.first_view(scene, levels=scene.at_first)
    return scene, views.checked_view(scene, replace(view, size=64, **changes))


CASES = {
    "whole plane": views_of(None),
    "zoomed": views_of(None, ranges={"phi": (0.1, 0.1 + 1e-9), "w3": (0.31, 0.33)}),
    "two levels": views_of(None, levels=(dt.Level.ORDER_1, dt.Level.SEMI), rtol=1e-6),
    "spherical": views_of(None, {"amplitude": 0.3, "theta": (0.0, math.pi / 2)}),
    "a body": views_of(dt.SemiReduced(BODY), {"w_perp": 0.1}),
    "a function": views_of(problem, {"delta": (-0.5, 0.4), "scale": (0.2, 1.0)}),
}


@pytest.mark.parametrize(
    "name",
    [x if x == "zoomed" else pytest.param(x, marks=pytest.mark.slow) for x in CASES],
)
def test_code_gives_the_same_map(name, tmp_path, monkeypatch):
    scene, view = CASES[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drawing, "OVERHEAD", math.inf)  # no sweep takes any time: all at once
    shown: list = []
    for _ in drawing.Drawing(scene).pictures(view, shown.append, pytest.fail):
        pass
    code = recipes.code_of(scene, view)
    names: dict = {"problem": problem, "dt": dt, "jnp": jnp}
    exec(compile(code, "view.py", "exec"), names)
    found = [names[key] for key in ("first", "second", "basin") if key in names]
    for basin, expected in zip(found, shown[-1].basins, strict=True):
        assert basin == expected
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_what_python_cannot_write_is_said():
    class Mine(dt.TransverseSemi):
        pass

    scene = scenes.scene_of_equation(Mine(-0.2), {})
    code = recipes.code_of(scene, views.first_view(scene))
    assert "# `equation` is the one that was given to `dt.explore`" in code
    scene = scenes.scene_of(
        lambda w3, phi: (dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)),
        {"w3": (0.0, 0.5), "phi": (0.0, 3.0)},
    )
    code = recipes.code_of(scene, views.first_view(scene))
    assert "# `problem` is the function that was given to `dt.explore`" in code
