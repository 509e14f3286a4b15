"""A sweep that is repeated with other values on the same axes."""

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
    """A sweep whose preparation, independent of the values on the axes, is done once; see `sweep`.

    Tracing the problem and choosing an engine take longer than running some ten thousand starts. So
    does a division into tiles, whose Python code runs in one thread at a time. An engine with its
    own threads therefore gets all starts at once.

    Attributes:
        plan: the plan of a sweep over any grid with the same axes.
    """

    plan: Plan

    @classmethod
    def of(cls, problem: Problem, grid: Grid, **settings: Any) -> "PreparedSweep":
        """Prepare a sweep with `settings`, the fields of `Settings`, after checking them.

        Raises:
            ValueError: bad arguments.
        """
        plan = plan_of(problem, grid, Settings(**settings))
        if not all(engine.has_own_threads for engine in plan.engines.values()):
            return cls(plan)
        threads = len(plan.devices)
        return cls(replace(plan, devices=plan.devices[:1], cut=Tiling.whole, threads=threads))

    def __call__(self, grid: Grid, rtol: float) -> Basin:
        """Return the basin over a grid with these axes, as from `sweep`.

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
