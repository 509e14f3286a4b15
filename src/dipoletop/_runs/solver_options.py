"""The options of `simulate` that concern the solver: their names, their checks, their defaults."""

import inspect
from collections.abc import Callable
from typing import Any, TypedDict

import diffrax
import jax
from jaxtyping import Array, Float

from .._base.checks import ArrayLike, NumberLike, flag, instance, positive
from .._base.refusals import refuse
from .._base.types import State


class Options(TypedDict, total=False):
    """The further arguments of `simulate`."""

    solver: diffrax.AbstractSolver | None
    stepsize_controller: diffrax.AbstractStepSizeController | None
    dt0: NumberLike | None
    event: diffrax.Event | None
    saveat: diffrax.SaveAt | None
    progress_meter: diffrax.AbstractProgressMeter | None
    adjoint: diffrax.AbstractAdjoint | None
    throw: bool
    dense: bool
    balance: bool
    attitude: ArrayLike | None


OF_DIFFRAX = {
    "solver": "a solver of diffrax, such as `diffrax.Tsit5()`",
    "stepsize_controller": "a step size controller, such as `diffrax.PIDController(1e-8, 1e-10)`",
    "event": "an event of diffrax, `diffrax.Event(condition)`",
    "saveat": "what diffrax saves, such as `diffrax.SaveAt(steps=True)`",
    "progress_meter": "a progress meter of diffrax, such as `diffrax.TqdmProgressMeter()`",
    "adjoint": "an adjoint of diffrax, such as `diffrax.ForwardMode()`",
}
"""The description of each of the `Options` that is an object of diffrax."""
OF_BRANCH = ("throw", "balance", "attitude")
"""The options of a motion along a physical branch."""
SAVED_STATE: Any = diffrax.SaveAt(t1=True).subs


def check_options(options: Options) -> None:
    """Refuse options of other names, and values that they cannot have; numbers become arrays."""
    kinds = Options.__annotations__
    for name, value in options.items():
        if name not in kinds:
            refuse("options", f"be among {', '.join(kinds)}", f"one is `{name}`")
        if name in OF_DIFFRAX:
            instance(name, value, kinds[name], f"be {OF_DIFFRAX[name]}")
        elif kinds[name] is bool:
            flag(name, value)
    step = options.get("dt0")
    if step is not None:
        options["dt0"] = positive("dt0", step, batch=False)  # an array, so that nothing recompiles
    elif isinstance(options.get("stepsize_controller"), diffrax.ConstantStepSize):
        refuse("dt0", "be given with `diffrax.ConstantStepSize`, as its step", "is None")
    saveat = options.get("saveat")
    if saveat is not None:
        saved: Any = saveat.subs
        if not isinstance(saved, diffrax.SubSaveAt) or saved.fn is not SAVED_STATE.fn:
            must = "save states at times or steps, such as `diffrax.SaveAt(steps=True)`"
            refuse("saveat", must, "saves something else")


def check_branch_options(options: Options) -> None:
    """Refuse options for diffrax, which cannot follow a physical branch."""
    for name, value in options.items():
        if name not in OF_BRANCH and value:
            refuse(
                "options",
                "be `throw`, `balance` or `attitude` for a start of shape (3,) of a full equation, "
                "whose physical branch diffrax cannot follow (give a whole state for the vector "
                "field)",
                f"one is `{name}`",
            )


def saved_at(options: Options, times: Float[Array, "T"]) -> diffrax.SaveAt:
    """Return what diffrax saves: the states at `times`, and at the event if there is one."""
    saveat, dense = options.get("saveat"), options.get("dense", False)
    if saveat is None:
        return diffrax.SaveAt(ts=times, t1=options.get("event") is not None, dense=dense)
    return diffrax.SaveAt(subs=saveat.subs, dense=saveat.dense or dense)


def event_of(options: Options, n: int) -> diffrax.Event | None:
    """Return the event, whose conditions receive only the n numbers of the equation's state."""
    event = options.get("event")
    if event is None:
        return None

    def of_state(condition: Callable[..., Any]) -> Callable[..., Any]:
        kinds = {x.kind for x in inspect.signature(condition).parameters.values()}
        takes_more = inspect.Parameter.VAR_KEYWORD in kinds  # the keywords that diffrax passes

        def seen(t: Any, y: State, args: Any, **rest: Any) -> Any:
            return condition(t, y[:n], args, **(rest if takes_more else {}))

        return seen

    conditions = jax.tree.map(of_state, event.cond_fn, is_leaf=callable)
    return diffrax.Event(conditions, event.root_finder, event.direction)
