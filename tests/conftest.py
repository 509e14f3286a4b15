"""How every test runs: float64, strict promotion, and property tests that repeat exactly.

Nothing here imports dipoletop: the jaxtyping plugin (see pyproject.toml) must see it first.
"""

import os

import hypothesis
import jax
import matplotlib

# Nearly all of the time is XLA's, which compiles some hundred programs and runs each for a moment:
# without its optimisations a third less. `.ci/run` also runs what users do, with them.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

matplotlib.use("Agg")

# A first call compiles, so a deadline would only measure the compiler.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("repeatable")
