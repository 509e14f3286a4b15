"""XLA flags that halve the time of compilation: XLA_FLAGS="$(python tests/quick.py)".

Nearly all of the tests' time is XLA's, which compiles some thousand programs and runs each for a
moment: without its optimisations, and with its older emitters where it has them, half as much.
"""

from importlib.metadata import version

FLAGS = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
OLDER_EMITTERS = version("jaxlib").startswith("0.10.")
if OLDER_EMITTERS:
    FLAGS += " --xla_cpu_use_fusion_emitters=false"


def set_compiler_options():
    """Compile the host's programs like all others, but lanes by the newer emitters.

    With the older ones the last bits of a lane depend on its place. Programs take their options
    when they are imported, so that this comes first.
    """
    from dipoletop._base import compiling

    compiling.COMPILED_SOON["xla_backend_optimization_level"] = 0
    if OLDER_EMITTERS:
        for options in (compiling.CPU_OPTIONS, compiling.LANE_OPTIONS):
            options["xla_cpu_use_fusion_emitters"] = True


if __name__ == "__main__":
    print(FLAGS)
