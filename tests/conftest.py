"""How every test runs: float64, strict promotion, and property tests that repeat exactly.

Nothing here imports dipoletop: the jaxtyping plugin (see pyproject.toml) must see it first.
"""

import hypothesis
import jax
import matplotlib

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

matplotlib.use("Agg")

# A first call compiles, so a deadline would only measure the compiler.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("repeatable")
