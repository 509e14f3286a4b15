"""Python code that reproduces a view."""

import numpy as np
from jaxtyping import Float

from .scenes import Scene
from .views import View, cells_of


def code_of(scene: Scene, view: View) -> str:
    """Return a script that computes and draws the same map."""
    cells = cells_of(scene, view, view.size)
    system = scene.system_of(*view.values)
    parts = [_imports(system), 'jax.config.update("jax_enable_x64", True)']
    if scene.source.before:
        parts.append("\n".join(scene.source.before))
    axes = [f"    {name}={_values(values)}," for name, values in cells.grid.axes.items()]
    parts.append("\n".join(["grid = dt.Grid(", *axes, ")"]))
    names = ("first", "second") if len(view.levels) == 2 else ("basin",)
    for name, level in zip(names, view.levels or (None,), strict=True):
        problem = scene.source.problem(level, system)
        if problem:
            parts.append("\n" + "\n".join(problem) + "\n")
        parts.append(f"{name} = dt.sweep(problem, grid, rtol={view.rtol!r})")
    where = f'x="{view.x}", y="{view.y}", unfold={cells.folded}'
    if len(names) == 2:
        parts.append(f'dt.plots.save(dt.plots.compare(first, second, {where}), "map.png")')
    else:
        parts.append(f'dt.plots.save(dt.plots.basin(basin, {where}), "map.png")')
    return "\n\n".join(parts) + "\n"


def _imports(system: tuple[str, ...]) -> str:
    lines = ["import jax", "import jax.numpy as jnp", "import numpy as np"]
    if "amplitude" not in system:
        lines.remove("import jax.numpy as jnp")
    return "\n".join([*lines, "", "import dipoletop as dt"])


def _values(values: Float[np.ndarray, "n"]) -> str:
    if len(values) == 1:
        return repr(float(values[0]))
    return f"np.linspace({float(values[0])!r}, {float(values[-1])!r}, {len(values)})"
