"""The kind of a processor, on which the last bits of results depend."""

import functools
import platform

from .._base.digests import digest
from .._base.parallel import Device


def kind_of(device: Device) -> str:
    """Return the kind of the processor of a device."""
    return host_processor() if device.platform == "cpu" else device.device_kind


@functools.cache
def host_processor() -> str:
    """Return the name of this machine's processor, and a digest of its instruction set."""
    try:
        from llvmlite import binding
    except ImportError:
        return platform.machine()
    features = binding.get_host_cpu_features().flatten()
    return f"{binding.get_host_cpu_name()} {digest(features.encode()).hex()[:8]}"
