"""A loop that XLA compiles for a processor into one function.

By default XLA:CPU makes a function of every fusion and calls them one after another; each computes
again what it shares with others. The frontend attributes below are those by which XLA itself marks
small loops that it compiles whole: a step of lanes then takes from a half to a seventh of the time.

They are no documented part of XLA. Of some programs version 0.10 compiles nothing but ends the
process, and we know no rule that tells which. So only equations and versions that the tests try
are compiled so.
"""

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import jax

from ..equations.transverse import TransverseReduced, TransverseSemi

TRIED = TransverseReduced, TransverseSemi
IS_TRIED_VERSION = version("jaxlib").startswith("0.10.")
ATTRIBUTES = {"xla_cpu_small_call": "true", "inlineable": "false"}


def can_be_one_function(equation: Any) -> bool:
    """Whether the loop over steps of such an equation is known to compile."""
    return IS_TRIED_VERSION and type(equation) in TRIED


def while_loop_in_one_function(
    go_on: Callable[[Any], Any], step: Callable[[Any], Any], start: Any
) -> Any:
    """`jax.lax.while_loop` over arrays, compiled into one function."""
    from jax.experimental.xla_metadata import set_xla_metadata

    def loop(start: Any) -> Any:
        with set_xla_metadata(**dict.fromkeys(ATTRIBUTES)):  # not the operations inside
            return jax.lax.while_loop(go_on, step, start)

    with set_xla_metadata(**ATTRIBUTES):
        return jax.jit(loop)(start)
