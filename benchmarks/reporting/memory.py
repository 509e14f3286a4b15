"""The largest memory of a process; no import that would add to it."""

import sys
from pathlib import Path


def peak_memory() -> int | None:
    """The largest resident memory of this process, bytes; None where the system does not report it.

    Linux's own counter first: getrusage counts the process that started this one, too.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        if "VmHWM" in lines:
            return 1024 * int(lines["VmHWM"].split()[0])
    return _largest("RUSAGE_SELF")


def peak_memory_of_children() -> int | None:
    """The same of the largest process that this one started and that has ended."""
    return _largest("RUSAGE_CHILDREN")


def _largest(who: str) -> int | None:
    try:
        import resource
    except ImportError:
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(getattr(resource, who)).ru_maxrss
