"""How every test runs: float64, strict promotion, no windows.

Nothing here imports dipoletop at once: the jaxtyping plugin (see pyproject.toml) must see it first.
"""

import os

import jax
import matplotlib
import matplotlib.pyplot as plt
import pytest

import quick

# `.ci/run` also runs what users do, with all of XLA's optimisations.
os.environ.setdefault("XLA_FLAGS", quick.FLAGS)
# Tests neither use what is kept between processes nor leave anything there.
os.environ["DIPOLETOP_CACHE"] = "off"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

matplotlib.use("Agg")


@pytest.fixture(autouse=True, scope="session")
def lanes_as_users_compile_them():
    quick.compile_lanes_as_users_do()


@pytest.fixture(autouse=True)
def close_figures():
    """No picture outlives its test."""
    yield
    plt.close("all")
