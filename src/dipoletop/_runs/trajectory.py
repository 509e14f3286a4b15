"""A simulated motion: its states, and the energies, powers and balance computed from them."""

import functools
from typing import TYPE_CHECKING, Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import radiation
from .._base.attitudes import rotate
from .._base.batches import over_batch
from .._base.checks import (
    ArrayLike,
    NumberLike,
    check_body,
    concrete,
    finite,
    real,
    shape_of,
    where_valid,
)
from .._base.compiling import compiled_soon
from .._base.pictured import Pictured
from .._base.refusals import refuse
from .._base.tables import rows_of
from .._base.types import Equation, Vector
from ..equations._common import follows_attitude, rate_of_omega
from ..equations.levels import level_of

if TYPE_CHECKING:
    import pandas
    import xarray

COLUMNS = {
    "omega": ("1/tau_0", "angular velocity in body axes", ("component",)),
    "energy": ("I_1/tau_0^2", "kinetic energy", ()),
    "power": ("I_1/tau_0^3", "radiated power", ()),
    "emitted": ("I_1/tau_0^2", "energy radiated since the first time", ()),
    "work": ("I_1/tau_0^2", "work of the torque from outside since the first time", ()),
    "balance_defect": ("1", "error of the energy balance", ()),
    "attitude": ("1", "unit quaternion from body axes to the laboratory", ("part",)),
    "dipole": ("1", "dipole in the laboratory", ("component",)),
}
"""Columns of tables: units, meaning, axes behind the times."""


@compiled_soon
def _rotated(q: Float[Array, "*all 4"], v: Float[Array, "..."]) -> Float[Array, "*all 3"]:
    """Compute q∘v∘q*, of one vector or of one vector for each quaternion."""
    v = jnp.broadcast_to(v, (*q.shape[:-1], 3))
    return jnp.moveaxis(rotate(jnp.moveaxis(q, -1, 0), jnp.moveaxis(v, -1, 0)), 0, -1)


class BranchSolution(eqx.Module):
    """The counterpart of diffrax's `Solution` for a motion on the physical branch."""

    stats: dict[str, Int[Array, ""]]
    """`num_steps`: the number of windows solved."""
    reached: Float[Array, ""]
    """The time up to which the motion is known."""


def _batch_axes(trajectory: Any) -> int:
    """Return the number of batch axes of a trajectory."""
    ts, ys = trajectory.ts.shape, trajectory.ys.shape
    if ts != ys[:-1]:
        must = "have its batch axes in front of all its arrays, as `jax.vmap` puts them"
        refuse("trajectory", must, f"has ts of {ts} and ys of {ys}")
    return len(ts) - 1


class Trajectory(Pictured, eqx.Module):
    """The states of an equation at T given times; other quantities are computed when read.

    From `jax.vmap` every field and property has the batch axes in front of the shape given here.

    Attributes:
        equation: the equation of motion.
        ts: times τ, shape (T,), in units of τ₀.
        ys: states of the equation, shape (T, n).
        emitted: ∫|d₂|²dτ, the energy radiated since the first time, shape (T,); None without
            `balance=True`.
        solution: diffrax's `Solution` with its result and its interpolation; of a motion on the
            physical branch of a full equation a `BranchSolution`.
        omega: property; angular velocity Ω in body axes, shape (T, 3), in units of 1/τ₀.
        omega_dot: property; its rate dΩ/dτ, shape (T, 3).
        energy: property; kinetic energy E = ½ Ω·IΩ, shape (T,).
        power: property; radiated power |d₂|², shape (T,).
        work: ∫Ω·M dτ, the work of a torque M from outside since the first time, shape (T,); None
            without `balance=True`, and without such a torque.
        balance_defect: property; error of the energy balance, shape (T,); needs `balance=True`.
        attitude: property; unit quaternions from body axes to the laboratory, scalar first, shape
            (T, 4); needs `attitude=q0`, or an equation whose state holds it.
        dipole: property; the dipole in the laboratory, shape (T, 3); needs the attitude.
        stats: property; counts of steps, a dict.
        level: property; the level of approximation of the equation, a text.
    """

    equation: Equation
    ts: Float[Array, "*batch T"]
    ys: Float[Array, "*batch T n"]
    emitted: Float[Array, "*batch T"] | None
    solution: diffrax.Solution | BranchSolution
    work: Float[Array, "*batch T"] | None = None
    _attitude: Float[Array, "*batch T 4"] | None = None

    def __repr__(self) -> str:
        """Return the level, the range of times and the number of steps; if traced, the shapes."""
        steps = self.stats["num_steps"]
        known = [isinstance(x, jax.Array | np.ndarray) for x in (self.ts, self.ys, steps)]
        if not (all(known) and concrete(self.ts, self.ys, steps)):
            return eqx.tree_pformat(self)
        *batch, times = self.ts.shape
        runs = f"{'x'.join(map(str, batch))} runs, " if batch else ""
        span = f"{float(self.ts.min()):g} ≤ τ ≤ {float(self.ts.max()):g}"
        return f"Trajectory({self.level}: {runs}{times} times, {span}, {np.sum(steps)} steps)"

    @property
    @over_batch(_batch_axes)
    def omega(self) -> Float[Array, "*batch T 3"]:
        """Angular velocity in body axes, in units of 1/τ₀."""
        return jax.vmap(self.equation.omega)(self.ys)

    @property
    @over_batch(_batch_axes)
    @compiled_soon
    def omega_dot(self) -> Float[Array, "*batch T 3"]:
        """Rate of the angular velocity in body axes, in units of 1/τ₀²."""
        return jax.vmap(functools.partial(rate_of_omega, self.equation))(self.ts, self.ys)

    @property
    @over_batch(_batch_axes)
    @compiled_soon
    def energy(self) -> Float[Array, "*batch T"]:
        """E = ½ Ω·IΩ."""
        return jax.vmap(lambda omega: radiation.kinetic_energy(self._body, omega))(self.omega)

    @property
    @over_batch(_batch_axes)
    @compiled_soon
    def power(self) -> Float[Array, "*batch T"]:
        """Radiated power |d₂|²."""
        power = functools.partial(radiation.radiated_power, self._body)
        return jax.vmap(power)(self.omega, self.omega_dot)

    @property
    @over_batch(_batch_axes)
    def balance_defect(self) -> Float[Array, "*batch T"]:
        """Change of E − d₁·d₂ + ∫(|d₂|² − Ω·M)dτ since the first time, over the initial energy.

        M is the torque from outside, if there is one. The defect is zero for any motion of the full
        equation. At a reduced level it measures the distance from the full equation. For a motion
        that begins at rest it is absolute.

        Raises:
            ValueError: the trajectory was computed without `balance=True`.
        """
        if self.emitted is None:
            refuse("balance", "be True in `simulate` for a balance defect", "was not")
        return self._balance_defect()

    @compiled_soon
    def _balance_defect(self) -> Float[Array, "T"]:
        schott = functools.partial(radiation.schott_energy, self._body)
        emitted: Any = self.emitted  # not None: `balance_defect` has refused that
        total = self.energy - jax.vmap(schott)(self.omega, self.omega_dot) + emitted
        total = total if self.work is None else total - self.work
        initial = self.energy[0]
        return (total - total[0]) / jnp.where(initial > 0, initial, 1.0)

    @property
    def attitude(self) -> Float[Array, "*batch T 4"]:
        """Unit quaternions q with v_lab = q∘v∘q* for v in body axes, scalar first.

        Raises:
            ValueError: the trajectory was computed without `attitude=q0`, by an equation that does
                not follow the attitude.
        """
        if follows_attitude(self.equation):
            return self._attitude_of_states()
        if self._attitude is None:
            refuse("attitude", "be given to `simulate` for attitudes in the laboratory", "was not")
        return self._attitude

    @over_batch(_batch_axes)
    @compiled_soon
    def _attitude_of_states(self) -> Float[Array, "*batch T 4"]:
        equation: Any = self.equation
        return jax.vmap(equation.attitude)(self.ys)

    @property
    @over_batch(_batch_axes)
    def dipole(self) -> Float[Array, "*batch T 3"]:
        """The dipole d in the laboratory.

        Raises:
            ValueError: there is no attitude, or the equation has no body.
        """
        check_body(self.equation)
        return self.to_laboratory(self._body.dipole)

    def to_laboratory(self, vectors: ArrayLike) -> Float[Array, "*batch T 3"]:
        """Compute v_lab = q∘v∘q*, the laboratory components of vectors in body axes.

        Args:
            vectors: one vector at each time, such as `omega`, shape (T, 3) behind any batch axes;
                or one that is fixed in the body, shape (3,).

        Returns:
            Their components in the laboratory, shape (T, 3) behind any batch axes.

        Raises:
            ValueError: an array of another shape, or a trajectory without attitude.

        Example:
            >>> import jax.numpy as jnp, dipoletop as dt
            >>> ts, level = jnp.array([0.0, 1.0]), [1.0, 0.0, 0.0, 0.0]
            >>> run = dt.simulate(dt.RotatorReduced(), [0.0, 0.0, 2.0], ts, attitude=level)
            >>> angle = jnp.sqrt(1 + 2 * 2.0**2) / 2.0 - 1 / 2.0  # ∫ω dτ with ω by (2.4)
            >>> expected = jnp.array([jnp.cos(angle), jnp.sin(angle), 0.0])
            >>> bool(jnp.allclose(run.to_laboratory([1.0, 0.0, 0.0])[-1], expected, atol=1e-9))
            True
        """
        q = self.attitude
        wanted = (*q.shape[:-1], 3)
        shape = shape_of(vectors)
        if shape not in ((3,), wanted):
            refuse("vectors", f"have shape (3,) or {wanted}", f"has shape {shape}")
        return _rotated(q, real("vectors", vectors, shape, batch=False))

    def to_xarray(self) -> "xarray.Dataset":
        """Return all quantities of the trajectory as an `xarray.Dataset`, with units.

        Axes of a batch are called `batch_1`, …; then `tau` is a coordinate over `time`.

        Example:
            >>> import jax.numpy as jnp, dipoletop as dt
            >>> ts = jnp.linspace(0.0, 10.0, 5)
            >>> run = dt.simulate(dt.TransverseSemi(-0.2), [0.2, 0.0, 0.1], ts)
            >>> data = run.to_xarray()
            >>> data.omega.dims, data.omega.attrs["units"]
            (('tau', 'component'), '1/tau_0')
        """
        import xarray

        batch = tuple(f"batch_{k + 1}" for k in range(_batch_axes(self)))
        dims = (*batch, "time" if batch else "tau")
        variables = {}
        for name, (unit, meaning, behind) in COLUMNS.items():
            if self._has(name):
                values = np.asarray(getattr(self, name))
                attrs = {"units": unit, "long_name": meaning}
                variables[name] = ((*dims, *behind), values, attrs)
        times = {"tau": (dims, np.asarray(self.ts), {"units": "tau_0", "long_name": "time"})}
        return xarray.Dataset(variables, times, {"level": self.level})

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return a `pandas.DataFrame` with a row for each time; see `to_xarray`.

        Components have columns of their own, such as `omega_1`; units are in `attrs["units"]`.
        """
        data = self.to_xarray()
        return rows_of(data, tuple(map(str, data.tau.dims)))

    def _has(self, name: str) -> bool:
        """Return whether there is a quantity of `COLUMNS`."""
        turns = self._attitude is not None or follows_attitude(self.equation)
        has_body = hasattr(self.equation, "body")
        return {
            "omega": True,
            "emitted": self.emitted is not None,
            "work": self.work is not None,
            "balance_defect": self.emitted is not None,
            "attitude": turns,
            "dipole": turns and has_body,
        }.get(name, has_body)

    @property
    def stats(self) -> dict[str, Any]:
        """Steps: `num_steps`, `num_accepted_steps`, `num_rejected_steps`, …."""
        return self.solution.stats

    @property
    def level(self) -> str:
        """The level of approximation of the equation of motion."""
        return level_of(self.equation)

    @property
    def _body(self) -> Any:
        """The body of the equation, if it has one."""
        return self.equation.body  # pyright: ignore[reportAttributeAccessIssue]

    def evaluate(self, t: NumberLike | ArrayLike) -> Float[Array, "..."]:
        """Compute ω at any times within the run, by the solver's own interpolation (`dense=True`).

        Args:
            t: τ, of any shape.

        Returns:
            Shape (*batch, *t, 3): the axes of a batch, the axes of `t`, the components.

        Raises:
            ValueError: the trajectory was computed without `dense=True`, or a time lies outside
                the run. A traced time outside the run gives NaN.
        """
        solution = self.solution
        if isinstance(solution, BranchSolution) or solution.interpolation is None:
            refuse("dense", "be True in `simulate` for values in between", "was not")
        times = finite("t", t, shape_of(t), batch=False)
        first, last = self.ts[..., 0].max(), self.ts[..., -1].min()
        inside = (times >= first) & (times <= last)
        times = where_valid("t", times, inside, "lie within the run")
        return self._interpolated(times)

    @over_batch(_batch_axes)
    def _interpolated(self, times: Float[Array, "..."]) -> Float[Array, "..."]:
        solution: Any = self.solution  # diffrax's: `evaluate` has refused any other
        n = self.ys.shape[-1]

        def omega(time: Float[Array, ""]) -> Vector:
            return self.equation.omega(solution.evaluate(time)[:n])

        return jax.vmap(omega)(times.ravel()).reshape(*times.shape, 3)
