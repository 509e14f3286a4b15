"""XLA flags that halve the time of compilation: XLA_FLAGS="$(python tests/quick.py)".

Nearly all of the tests' time is XLA's, which compiles some thousand programs and runs each for a
moment: without its optimisations, and with its older emitters where it has them, half as much.
"""

from importlib.metadata import version

FLAGS = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
OLDER_EMITTERS = version("jaxlib").startswith("0.10.")
if OLDER_EMITTERS:
    FLAGS += " --xla_cpu_use_fusion_emitters=false"


def compile_without_optimisation():
    """Compile the programs of the host like all others, if this runs before they are imported."""
    from dipoletop._base.compiling import COMPILED_SOON

    COMPILED_SOON["xla_backend_optimization_level"] = 0


def compile_lanes_as_users_do():
    """With the older emitters the last bits of a lane depend on its place."""
    from dipoletop._engines.jax_engine import LANE_OPTIONS

    if OLDER_EMITTERS:
        LANE_OPTIONS["xla_cpu_use_fusion_emitters"] = True


if __name__ == "__main__":
    print(FLAGS)
