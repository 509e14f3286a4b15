"""How notebooks show results."""

import base64
import re

import jax.numpy as jnp
import made_basins
import numpy as np
import pytest
from matplotlib import pyplot as plt

import dipoletop as dt
from dipoletop.plots import in_notebooks


def picture_in(page):
    """The bytes of the picture in a page."""
    return base64.b64decode(re.search(r"base64,([^\"]*)", page)[1])


def test_a_result_is_its_text_and_a_picture():
    run = dt.simulate(dt.TransverseSemi(-0.2), [0.1, 0.2, 0.1], jnp.linspace(0.0, 9.0, 4))
    for result in (made_basins.every_class(), run):
        before = plt.get_fignums()
        page = result._repr_html_()
        first = repr(result).splitlines()[0].replace("<", "&lt;").replace(">", "&gt;")
        assert page.startswith(f"<pre>{first}")
        assert picture_in(page).startswith(b"\x89PNG")
        assert plt.get_fignums() == before


@pytest.mark.parametrize("most", [3, 2])
def test_a_line_is_drawn_and_what_is_too_large_is_not(monkeypatch, most):
    basin = made_basins.made(np.ones(3, np.int8), 0.1, axes={"delta": [-0.2, 0.1, 0.3]})
    monkeypatch.setattr(in_notebooks, "MOST", most)
    assert ("<img" in basin._repr_html_()) == (most == 3)
