"""Python code that reproduces a view."""

import numpy as np
from jaxtyping import Float

from .scenes import Scene
from .views import View, cells_of


def code_of(scene: Scene, view: View) -> str:
    """Return a script that computes and draws the same map."""
    cells = cells_of(scene, view, view.size)
    system = scene.system_of(*view.values)
    needed = ["import jax.numpy as jnp"] if "amplitude" in system else []
    imports = ["import jax", *needed, "import numpy as np", "", "import dipoletop as dt"]
    parts = ["\n".join(imports), 'jax.config.update("jax_enable_x64", True)']
    if scene.source.before:
        parts.append("\n".join(scene.source.before))
    axes = [f"    {name}={_values(values)}," for name, values in cells.grid.axes.items()]
    parts.append("\n".join(["grid = dt.Grid(", *axes, ")"]))
    draw, names = "basin", ("basin",)
    if len(view.levels) == 2:
        draw, names = "compare", ("first", "second")
    for name, level in zip(names, view.levels or (None,), strict=True):
        problem = scene.source.problem(level, system)
        if problem:
            parts.append("\n" + "\n".join(problem) + "\n")
        parts.append(f"{name} = dt.sweep(problem, grid, rtol={view.rtol!r})")
    drawn = f'{", ".join(names)}, x="{view.x}", y="{view.y}", unfold={cells.folded}'
    parts.append(f'dt.plots.save(dt.plots.{draw}({drawn}), "map.png")')
    return "\n\n".join(parts) + "\n"


def _values(values: Float[np.ndarray, "n"]) -> str:
    if len(values) == 1:
        return repr(float(values[0]))
    return f"np.linspace({float(values[0])!r}, {float(values[-1])!r}, {len(values)})"
