"""How every test runs: float64, strict promotion, and, in plain tests, shapes and types checked.

Nothing here imports dipoletop at once: jaxtyping must see it first.
"""

import atexit
import collections
import contextlib
import ctypes
import gc
import os
import resource
import shutil
import tempfile
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
# The processes of one run share their machine code, and leave nothing behind.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["DIPOLETOP_CACHE"] = tempfile.mkdtemp(prefix="dipoletop-")
    atexit.register(shutil.rmtree, os.environ["DIPOLETOP_CACHE"], ignore_errors=True)

# A command in the tests' own process would let all tests behind it read what others compiled.
jax.config.update("jax_enable_compilation_cache", "JAX_COMPILATION_CACHE_DIR" in os.environ)
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

matplotlib.use("Agg")

PLAIN = "not slow and not system"  # the tests that plain `pytest` runs
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


def pytest_configure(config):
    """Check shapes and types, but not in the long tests: checks take a fifth of their time."""
    if config.option.markexpr not in ("slow", "system"):
        install_import_hook(list(checked_modules()), "beartype.beartype")
    quick.set_compiler_options()


MOST_PROGRAMS = 170
"""Programs that the tests of one file may compile; a file that needs more has its own number."""
MEMORY_OF_SLOW_TESTS = 3500
"""MB above which a worker gives up what was compiled; one that runs plain tests does so earlier."""
compiled = collections.Counter()


def count_programs(event, _seconds, **_):
    if event.endswith("backend_compile_duration"):
        compiled["programs"] += 1


jax.monitoring.register_event_duration_secs_listener(count_programs)


@pytest.fixture(autouse=True, scope="module")
def limit_of_a_file(request):
    """No file compiles too many programs, and it begins with few in memory."""
    is_plain = request.config.option.markexpr == PLAIN
    give_programs_up(1000 if is_plain else MEMORY_OF_SLOW_TESTS)
    before = compiled["programs"]
    yield
    number = compiled["programs"] - before
    if is_plain:
        most = getattr(request.module, "MOST_PROGRAMS", MOST_PROGRAMS)
        assert number <= most, f"{number} programs were compiled, where {most} are allowed"


def give_programs_up(most):
    """Give up what was compiled if the process has more than so many MB."""
    if resident_memory() > most:
        jax.clear_caches()
        compiled.clear()  # a file that compiles them again has no ceiling
        gc.collect()
        give_memory_back()


def resident_memory():
    """The memory of this process in MB; 0 where it is not known."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def give_memory_back():
    """Give free memory back to the system, which the C library keeps."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def pytest_collection_finish():
    """Collect garbage rarely: a trace makes many objects, and what is loaded now stays."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def pytest_sessionfinish(session):
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["peak"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error):
    peaks[node.gateway.id] = getattr(node, "workeroutput", {}).get("peak", 0)


peaks = {}


def pytest_terminal_summary(terminalreporter):
    if peaks:
        shown = ", ".join(f"{name} {peak:.0f} MB" for name, peak in sorted(peaks.items()))
        terminalreporter.write_line(f"Peak memory of the workers: {shown}")


@pytest.fixture(autouse=True)
def nothing_is_left(request):
    """No picture outlives its test, and no worker keeps too many programs in its memory."""
    yield
    plt.close("all")
    give_programs_up(1150 if request.config.option.markexpr == PLAIN else MEMORY_OF_SLOW_TESTS)
