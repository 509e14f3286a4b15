"""Numbers as text."""

import math


def with_error(value: float, error: float) -> str:
    """A value with its estimated error, to one digit more than that error leaves certain."""
    if not math.isfinite(error):
        return f"{value:.6g} (error not estimated)"
    digits = 16
    if error > 0 and value != 0 and math.isfinite(value):
        digits = max(2, min(16, math.ceil(math.log10(abs(value) / error)) + 1))
    return f"{value:.{digits}g} ± {error:.1g}"
