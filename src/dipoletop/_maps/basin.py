"""Basins: outcomes on a grid or a sample, with the settings that gave them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._base.checks import described, refuse
from .._base.statistics import Share, share_of
from .._base.types import Outcome, Regime, implied_probability
from .columns import AXES, DERIVATIVE_PREFIX, BasinParts, column_spec
from .grids import counted, described_axis
from .store import contents
from .store.errors import StoreDamaged

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Basin:
    """Outcomes on a grid or a sample; every property is an array of its shape.

    | property | column | meaning |
    |---|---|---|
    | `outcome` | `outcome` | member of `Outcome`: FAILED −1, UNDECIDED 0, RESIDUAL 1, STOP 2 |
    | `omega_inf` | `omega_inf` | ω∞ along the dipole, signed, in 1/τ₀ |
    | `omega_inf_error` | `omega_inf_error` | its estimated absolute error, in 1/τ₀ |
    | `time` | `time` | τ at which the outcome was certain; NaN where it was predicted |
    | `steps` | `steps` | integration steps tried |
    | `certified` | `certified` | whether the region that ended the run is proven to decide |
    | `stop` | `stop` | member of `Stop`: in which way a top stops |
    | `regime` | `regime` | member of `Regime`: the law that decided, RESOLVED by integration |
    | `probability` | `probability` | that the rotation is residual: between 0 and 1 for chance |
    | `changed` | `changed` | with `confirm`: whether the second tolerance gives another outcome |
    | `derivative(axis)` | `d_omega_inf_d_…` | with `derivatives`: ∂ω∞/∂axis |
    | `column("computed")` | `computed` | of `adaptive.refine`: integrated, not filled in |

    Further, `level` is the level of the equation of motion, and `fractions()` gives the share of
    every outcome. `to_xarray()`, `save(path)` and `Basin.load(path)` convert and store.

    Attributes:
        dims: names of the axes.
        shape: lengths of the axes.
        coords: values on the axes; empty for points and samples.
        columns: the flat columns, in memory or on disk.
        attrs: level of the equation, settings, versions.
        seconds: wall time of the sweep, compilation included; NaN for a loaded basin.
    """

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Float[np.ndarray, "..."]]
    columns: Mapping[str, Any]
    attrs: dict[str, Any]
    seconds: float = field(default=np.nan, compare=False)

    def column(self, name: str) -> np.ndarray:
        """One column, in the shape of the grid.

        Raises:
            ValueError: the basin has no such column.
            StoreDamaged: the column is on disk, and is not what was written there.
        """
        if not isinstance(name, str) or name not in self.columns:
            refuse(
                "name", f"be a column of this basin ({', '.join(self.columns)})", described(name)
            )
        return np.asarray(self.columns[name][:]).reshape(self.shape)

    @property
    def outcome(self) -> Int[np.ndarray, "*shape"]:
        """Members of `Outcome`."""
        return self.column("outcome")

    @property
    def omega_inf(self) -> Float[np.ndarray, "*shape"]:
        """Residual angular velocity along the dipole, signed; 0 for STOP, NaN where unknown."""
        return self.column("omega_inf")

    @property
    def omega_inf_error(self) -> Float[np.ndarray, "*shape"]:
        """Estimated absolute error of ω∞; 0 for STOP, infinite where there is no estimate."""
        return self.column("omega_inf_error")

    @property
    def time(self) -> Float[np.ndarray, "*shape"]:
        """τ at which the outcome was certain; NaN where it was predicted."""
        return self.column("time")

    @property
    def steps(self) -> Int[np.ndarray, "*shape"]:
        """Integration steps tried."""
        return self.column("steps")

    @property
    def certified(self) -> Bool[np.ndarray, "*shape"]:
        """Whether the region that ended the run is proven to decide."""
        return self.column("certified")

    @property
    def stop(self) -> Int[np.ndarray, "*shape"]:
        """Members of `Stop`."""
        return self.column("stop")

    @property
    def regime(self) -> Int[np.ndarray, "*shape"]:
        """Members of `Regime`; RESOLVED everywhere in a basin without this column."""
        if "regime" in self.columns:
            return self.column("regime")
        return np.full_like(self.outcome, Regime.RESOLVED)

    @property
    def probability(self) -> Float[np.ndarray, "*shape"]:
        """The probability that the rotation is residual: 1 for RESIDUAL, 0 for STOP.

        Between 0 and 1 chance decides, and the outcome is UNDECIDED; NaN where nothing is known. In
        a basin without this column it is what the outcome implies.
        """
        if "probability" in self.columns:
            return self.column("probability")
        return implied_probability(self.outcome)

    @property
    def changed(self) -> Bool[np.ndarray, "*shape"]:
        """Whether the outcome differs at the second tolerance (sweeps with `confirm`)."""
        return self.column("changed")

    def derivative(self, axis: str) -> Float[np.ndarray, "*shape"]:
        """∂ω∞/∂axis (sweeps with `derivatives`).

        | where | value |
        |---|---|
        | the top stops, and so do its neighbours | 0 |
        | ω∞ is unknown, or not differentiable, such as at a basin boundary | NaN |
        | a change turns the dipole of a general body off its principal axis | infinite |
        | a change violates the condition (δ = 0 or ω₃ = 0) under which ω₁ is conserved | infinite |

        See `residual_rotation` for the last two.

        Raises:
            ValueError: the sweep was not asked for this derivative.
        """
        if not isinstance(axis, str) or DERIVATIVE_PREFIX + axis not in self.columns:
            prefixed = [name for name in self.columns if name.startswith(DERIVATIVE_PREFIX)]
            known = ", ".join(name.removeprefix(DERIVATIVE_PREFIX) for name in prefixed)
            must = f"be among the `derivatives` of the sweep, {known or 'which had none'}"
            refuse("axis", must, f"is {axis!r}")
        return self.column(DERIVATIVE_PREFIX + axis)

    @property
    def level(self) -> str:
        """The level of the equation of motion that was integrated."""
        return self.attrs["level"]

    def fractions(self) -> dict[str, Share]:
        """Share of every outcome that occurs, with 95 % intervals (Wilson).

        The intervals are those of independent random starts; on a regular grid they overstate the
        error.
        """
        values, counts = np.unique(self.outcome, return_counts=True)
        size = int(np.prod(self.shape))
        return {
            Outcome(value).name: share_of(count, size)
            for value, count in zip(values.tolist(), counts.tolist(), strict=True)
        }

    def to_xarray(self) -> "xarray.Dataset":
        """The basin as an `xarray.Dataset`, with units, versions and settings as attributes."""
        import xarray

        columns, coords = {}, {}
        for name in self.columns:
            spec = column_spec(name)
            columns[name] = (self.dims, self.column(name), _labels(spec.unit, spec.meaning))
        for name, values in self.coords.items():
            dims = (name, *(f"{name}_{k}" for k in range(1, values.ndim)))
            coords[name] = (dims, values, _labels(*AXES[name]) if name in AXES else {})
        return xarray.Dataset(columns, coords, self.attrs)

    def save(self, path: str | bytes | PathLike[Any]) -> None:
        """Write the basin as a Zarr group; `Basin.load` reads it back.

        Args:
            path: a folder that does not exist yet.

        Raises:
            StoreMismatch: something is there already; nothing of it is touched.
        """
        columns = {name: self.column(name).reshape(-1) for name in self.columns}
        contents.save(BasinParts(self.dims, self.shape, self.coords, columns, self.attrs), path)

    @staticmethod
    def load(path: str | bytes | PathLike[Any]) -> "Basin":
        """A basin from disk: one that was saved, or a sweep's `store`.

        Args:
            path: the folder.

        Raises:
            StoreMismatch: it is missing, not a basin, or a sweep that is not finished.
            StoreDamaged: it is not what was written. Stores of older versions have no checksums:
                of these only missing and unreadable data are detected.
        """
        return Basin(*contents.load(path))

    def __repr__(self) -> str:
        axes = [described_axis(name, values) for name, values in self.coords.items()]
        lines = [
            f"Basin({self.attrs.get('level', 'level not known')}; rtol {self.attrs.get('rtol')}",
            f"{', '.join(axes) or ', '.join(self.dims)}; {counted(self.shape)}",
            self._summary(),
        ]
        return "\n      ".join(lines) + ")"

    def _summary(self) -> str:
        """The share of every outcome, and of certified ones."""
        try:
            shares = [f"{name} {x.share:.2%}" for name, x in self.fractions().items()]
            if "certified" in self.columns:
                shares.append(f"certified {np.mean(self.certified):.2%}")
        except StoreDamaged as error:
            return str(error)
        return ", ".join(shares)


def _labels(unit: str, meaning: str) -> dict[str, str]:
    return {"units": unit, "long_name": meaning}
