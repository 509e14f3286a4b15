"""The tables that the command line prints: checks, the paper's ledger, spectra."""

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import validation
from ..paper import ledger
from ..stability import spectrum


def checks() -> Iterator[tuple[str, bool]]:
    """Lines of `dipoletop validate`, and whether what they say is good."""
    yield f"{'check':46} {'expected':>20} {'found':>20} {'error':>8} {'allowed':>8}", True
    for check in validation.run():
        line = (
            f"{check.name:46} {check.expected:20.12g} {check.found:20.12g} "
            f"{check.error:8.1e} {check.tolerance:8.1e} {'ok' if check.passed else 'FAILED'}"
        )
        yield line, check.passed


def paper() -> Iterator[tuple[str, bool]]:
    """Lines of `dipoletop validate --paper`, and whether they hold."""
    columns = "{:9}  {:24}  {:>8}  {:>8}  {}"
    yield columns.format("verdict", "where in the paper", "residual", "allowed", "what holds"), True
    for entry in ledger():
        residual, limit = f"{entry.residual:.1e}", f"{entry.limit:.1e}"
        yield columns.format(entry.verdict, entry.place, residual, limit, entry.claim), entry.holds
        if entry.printed:
            residual = f"{entry.printed_residual:.1e}"
            yield columns.format("", "  the paper has:", residual, "", entry.printed), True


def spectra(equations: list[Any], w: float) -> Iterator[str]:
    """Lines of `dipoletop spectrum`: eigenvalues at ω = (w, 0, 0), level by level."""
    for equation in equations:
        found = spectrum(equation, jnp.array([w, 0.0, 0.0]))
        yield f"{equation.level}: {'stable' if found.stable else 'not stable'}"
        yield f"  slow      {_numbers(found.slow)}"
        if found.fast.size:
            yield f"  runaways  {_numbers(found.fast)}"
        back, reactivity = float(found.return_time), float(found.reactivity)
        yield f"  return time {back:.6g}, reactivity {reactivity:.6g}"


def _numbers(values: Any) -> str:
    """Complex numbers, the imaginary part where there is one."""
    parts = []
    for value in np.asarray(values).tolist():
        text = f"{value.real:.10g}"
        parts.append(text + (f"{value.imag:+.10g}i" if value.imag else ""))
    return "   ".join(parts)
