"""How every test runs: float64, strict promotion, and property tests that repeat exactly.

Nothing here imports dipoletop: the jaxtyping plugin (see pyproject.toml) must see it first.
"""

import atexit
import os
import shutil
import tempfile

import hypothesis
import jax
import matplotlib

# Nearly all of the time is XLA's, which compiles some hundred programs and runs each for a moment:
# without its optimisations a third less. `.ci/run` also runs what users do, with them.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
)

# Several processes test: what one has compiled, the others read.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="dipoletop-tests-")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

matplotlib.use("Agg")

# A first call compiles, so a deadline would only measure the compiler.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("repeatable")
