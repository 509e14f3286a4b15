"""A sweep that is made again and again, over other values on the same axes."""

import time
from dataclasses import dataclass, replace
from typing import Any

from .._base.tolerances import tolerance
from .basin import Basin
from .grids import Grid
from .problems import Problem
from .sweep_plan import Plan, Settings, plan_of
from .sweep_stores import ColumnsInMemory, MemoryStore
from .tiling import Tiling
from .unfinished_tiles import finish


@dataclass(frozen=True)
class PreparedSweep:
    """What does not depend on the values on the axes is found once; see `sweep`.

    Tracing the problem and choosing an engine take longer than some ten thousand starts. So do
    several tiles: what is done for each of them in Python is done by one thread at a time. An
    engine that has its own threads is therefore given all starts at once.

    Attributes:
        plan: the plan of a sweep over any grid with the same axes.
    """

    plan: Plan

    @classmethod
    def of(cls, problem: Problem, grid: Grid, **settings: Any) -> "PreparedSweep":
        """A sweep with the `settings` that `Settings` names, all checked.

        Raises:
            ValueError: bad arguments.
        """
        plan = plan_of(problem, grid, Settings(**settings))
        if not all(engine.has_own_threads for engine in plan.engines.values()):
            return cls(plan)
        threads = len(plan.devices)
        return cls(replace(plan, devices=plan.devices[:1], cut=Tiling.whole, threads=threads))

    def __call__(self, grid: Grid, rtol: float) -> Basin:
        """The basin over a grid with these axes, as `sweep` gives it.

        Raises:
            ValueError: a bad tolerance, or values that the problem refuses.
        """
        began = time.perf_counter()
        blocks = replace(self.plan.blocks, over=grid)
        rules = self.plan.rules._replace(rtols=[tolerance("rtol", rtol)])
        plan = replace(self.plan, blocks=blocks, rules=rules)
        columns = ColumnsInMemory(plan)
        finish(plan, MemoryStore(plan, columns.add), False)
        return Basin(*columns.contents(), seconds=time.perf_counter() - began)
