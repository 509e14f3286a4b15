"""Results as text: numbers with their errors, arrays by their shape and range."""

import dataclasses
import enum
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

FEW = 4  # numbers that are all shown
UNITS = {"years": 365.25 * 86400, "days": 86400.0, "hours": 3600.0}


def summary(result: Any, *omit: str, **errors: str) -> str:
    """Return `Name(field=value, …)` for a dataclass or a named tuple.

    Args:
        result: the result.
        omit: fields that are not shown.
        errors: field = name of the attribute with its error; it is shown as value ± error.
    """
    fields = getattr(result, "_fields", None) or [x.name for x in dataclasses.fields(result)]
    names = [name for name in fields if name not in (*omit, *errors.values())]
    values = ((getattr(result, x), getattr(result, errors.get(x, ""), None)) for x in names)
    texts = (f"{name}={_text(*value)}" for name, value in zip(names, values, strict=True))
    return f"{type(result).__name__}({', '.join(texts)})"


def with_error(value: float, error: float) -> str:
    """Return a value with its estimated error as text, to one digit beyond the certain ones."""
    if not math.isfinite(error):
        return f"{value:.6g} (error not estimated)"
    digits = 16
    if error > 0 and value != 0 and math.isfinite(value):
        digits = max(2, min(16, math.ceil(math.log10(abs(value) / error)) + 1))
    return f"{value:.{digits}g} ± {error:.1g}"


def duration(seconds: float) -> str:
    """A time in seconds, and in years, days or hours where it is long."""
    for name, length in UNITS.items():
        if length <= seconds < math.inf:
            return f"{seconds:.4g} s ({seconds / length:.3g} {name})"
    return f"{seconds:.4g} s"


def span(values: Any) -> str:
    """Return the range of an array and its number of NaN, as text."""
    array = np.asarray(values)
    known = array[~np.isnan(array)]
    unknown = f"{array.size - known.size} NaN" if known.size < array.size else ""
    ends = dict.fromkeys(f"{end:.6g}" for end in (known.min(), known.max())) if known.size else ()
    return " and ".join(filter(None, (" to ".join(ends), unknown))) or "none"


def _text(value: Any, error: Any = None) -> str:
    """Return a short text of a value."""
    if isinstance(value, Mapping):
        parts = (f"{key}: {_text(x, error and error[key])}" for key, x in value.items())
        return f"{{{', '.join(parts)}}}"
    if isinstance(value, np.ndarray) and value.size > FEW:
        return f"<{' × '.join(map(str, value.shape))}: {span(value)}>"
    if isinstance(value, np.ndarray):
        return f"[{', '.join(f'{x:.6g}' for x in value.ravel())}]"
    if isinstance(value, float):
        return f"{value:.6g}" if error is None else with_error(value, error)
    return value.name if isinstance(value, enum.Enum) else str(value)
