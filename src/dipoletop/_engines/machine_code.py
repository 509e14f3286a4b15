"""Machine code from LLVM code, compiled once for this processor and kept on disk."""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
from llvmlite import binding

from .._base import private_cache
from .._base.digests import digest
from .._base.monitoring import report_native_compilation


class MachineCode(NamedTuple):
    """A compiled function."""

    address: int
    owner: Any
    """The object that keeps the code alive."""


def machine_code(text: str) -> MachineCode:
    """Return the function `treat` of a module of LLVM code, as machine code for this processor."""
    key = digest(text.encode(), *_circumstances())
    code = private_cache.load(key)
    if code is None:
        code = _compile(text)
        private_cache.save(key, code)
    # Stored and new code are loaded in the same way.
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), _target_machine())
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return MachineCode(engine.get_function_address("treat"), engine)


def _compile(text: str) -> bytes:
    """Return the object file of a module."""
    report_native_compilation()
    machine = _target_machine()
    module = binding.parse_assembly(text)
    module.verify()
    passes = binding.create_pass_builder(machine, binding.create_pipeline_tuning_options(3))
    passes.getModulePassManager().run(module, passes)
    return machine.emit_object(module)


def _target_machine() -> Any:
    """Return this processor as a target; an engine takes ownership, so each needs a new one."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple()
    return target.create_target_machine(
        cpu=binding.get_host_cpu_name(), features=_processor_features(), opt=3
    )


@functools.cache
def _processor_features() -> str:
    features = binding.get_host_cpu_features()
    if features.get("avx512f"):  # by default LLVM prefers narrower vectors
        features["prefer-256-bit"] = False
    return features.flatten()


@functools.cache
def _circumstances() -> tuple[bytes, ...]:
    """Return the rest that machine code depends on: versions, processor, this module."""
    versions = llvmlite.__version__, binding.llvm_version_info
    processor = binding.get_process_triple(), binding.get_host_cpu_name(), _processor_features()
    return *(str(x).encode() for x in (*versions, *processor)), Path(__file__).read_bytes()
