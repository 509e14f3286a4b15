"""How every test runs: float64, strict promotion, and every shape and type checked.

Nothing here imports dipoletop at once: jaxtyping must see it first.
"""

import os
from importlib.util import find_spec
from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import pytest
from jaxtyping import install_import_hook

import quick

# `.ci/run` also runs what users do, with all of XLA's optimisations.
os.environ.setdefault("XLA_FLAGS", quick.FLAGS)
# Tests neither use what is kept between processes nor leave anything there.
os.environ["DIPOLETOP_CACHE"] = "off"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

matplotlib.use("Agg")

UNCHECKED = {
    "_engines/" + name
    for name in ("constant_folding", "jaxpr_to_llvm", "machine_code", "native_queue", "vector_code")
} | {"_base/digests"}
"""Modules that write machine code: they handle few arrays, in calls so many that checks of their
types would take as long as all else."""


def checked_modules():
    """The modules of dipoletop whose shapes and types are checked."""
    (root,) = find_spec("dipoletop").submodule_search_locations
    for file in Path(root).rglob("*.py"):
        module = file.relative_to(root).with_suffix("").as_posix()
        if file.stem != "__init__" and module not in UNCHECKED:
            yield "dipoletop." + module.replace("/", ".")


install_import_hook(list(checked_modules()), "beartype.beartype")


@pytest.fixture(autouse=True, scope="session")
def lanes_as_users_compile_them():
    quick.compile_lanes_as_users_do()


@pytest.fixture(autouse=True)
def close_figures():
    """No picture outlives its test."""
    yield
    plt.close("all")
