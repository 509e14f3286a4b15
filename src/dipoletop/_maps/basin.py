"""What a sweep finds: outcomes on a grid or a sample, with where they came from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._base.checks import described, refuse
from .._base.types import Outcome
from .._runs.classification import Classification

if TYPE_CHECKING:
    import xarray

FIELDS: dict[str, tuple[str, str, str]] = {
    "outcome": ("int8", "1", "FAILED -1, UNDECIDED 0, RESIDUAL 1, STOP 2"),
    "omega_inf": ("float64", "1/tau_0", "residual angular velocity along the dipole, signed"),
    "omega_inf_error": ("float64", "1/tau_0", "estimated absolute error of omega_inf"),
    "time": ("float64", "tau_0", "time at which the outcome was certain"),
    "steps": ("int32", "1", "integration steps tried"),
    "certified": (
        "bool",
        "1",
        "whether the region that ended the run is proven to decide for its level",
    ),
    "stop": ("int8", "1", "NONE 0, AXIS 1, ROTATING 2, WOBBLING 3, TUMBLING 4"),
}
"""Columns of a basin: type, unit, meaning."""

AXES: dict[str, tuple[str, str]] = {
    "delta": ("1", "1 - I3/I1"),
    "phi": ("rad", "azimuth of the angular velocity about axis 3"),
    "theta": ("rad", "polar angle of the angular velocity from axis 3"),
    "w_perp": ("1/tau_0", "angular velocity across axis 3"),
    **{f"w{k}": ("1/tau_0", f"angular velocity along axis {k}") for k in (1, 2, 3)},
    "amplitude": ("1/tau_0", "magnitude of the angular velocity"),
}
"""Axes with a customary name: unit, meaning. Of others only their user knows."""

EXTRA = {
    "changed": ("bool", "1", "whether the outcome differs at the second tolerance"),
    "computed": ("bool", "1", "whether the start was integrated, not filled in"),
}
"""Columns that only some basins have."""

SLOPE = "d_omega_inf_d_"
"""What the name of a column of derivatives begins with; the name of the axis follows."""


def kind_of(column: str) -> tuple[str, str, str]:
    """Type, unit and meaning of a column."""
    if column.startswith(SLOPE):
        axis = column.removeprefix(SLOPE)
        return "float64", f"1/tau_0 per unit of {axis}", f"derivative of omega_inf by {axis}"
    return (FIELDS | EXTRA)[column]


class Share(NamedTuple):
    """A share of the starts, with its 95 % interval (Wilson)."""

    share: float
    low: float
    high: float
    count: int


def wilson(counts: Int[np.ndarray, "*any"], n: int) -> tuple[np.ndarray, np.ndarray]:
    """95 % intervals of shares counts/n: all p with (p − k/n)² ≤ z²p(1 − p)/n (Wilson)."""
    z2 = 1.959963984540054**2  # the 97.5 % point of the normal distribution, squared
    p = counts / n
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = np.sqrt(z2 * p * (1 - p) / n + (z2 / (2 * n)) ** 2) / (1 + z2 / n)
    # The ends at 0 and 1, which rounding would miss.
    low = np.where(p == 0, 0.0, middle - half)
    return low, np.where(p == 1, 1.0, middle + half)


@dataclass(frozen=True)
class Basin:
    """Outcomes over a grid or a sample; every array has the shape of that.

    Attributes:
        dims: names of the axes.
        shape: their lengths.
        coords: values on the axes (none for a sample).
        columns: the raw columns, flat, in memory or on disk.
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
            StoreDamaged: it is on disk, and is not what was written there.
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
        """Residual angular velocity along the dipole, signed; 0 for STOP, NaN where not known."""
        return self.column("omega_inf")

    @property
    def omega_inf_error(self) -> Float[np.ndarray, "*shape"]:
        """Estimated absolute error of ω∞; 0 for STOP, infinite where there is no estimate."""
        return self.column("omega_inf_error")

    @property
    def time(self) -> Float[np.ndarray, "*shape"]:
        """τ at which the outcome was certain."""
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
    def changed(self) -> Bool[np.ndarray, "*shape"]:
        """Whether the outcome differs at the second tolerance (sweeps with `confirm`)."""
        return self.column("changed")

    def derivative(self, axis: str) -> Float[np.ndarray, "*shape"]:
        """∂ω∞/∂axis (sweeps with `derivatives`): 0 where the top stops as its neighbours do.

        NaN where ω∞ is not known or not differentiable, as at a boundary; infinite where a change
        turns the dipole of a general body off its principal axis, which ends all residual rotation,
        or leaves what alone keeps ω₁ constant (see `residual_rotation`).

        Raises:
            ValueError: the sweep was not asked for this derivative.
        """
        if not isinstance(axis, str) or SLOPE + axis not in self.columns:
            has = [name.removeprefix(SLOPE) for name in self.columns if name.startswith(SLOPE)]
            must = f"be among the `derivatives` of the sweep, {', '.join(has) or 'which had none'}"
            refuse("axis", must, f"is {axis!r}")
        return self.column(SLOPE + axis)

    @property
    def level(self) -> str:
        """Which level of the equation of motion the outcomes came from."""
        return self.attrs["level"]

    def fractions(self) -> dict[str, Share]:
        """Share of every outcome that occurs, with 95 % intervals (Wilson).

        The interval is that of independent random starts; on a regular grid it overstates the
        error.
        """
        values, counts = np.unique(self.outcome, return_counts=True)
        size = int(np.prod(self.shape))
        shares = {}
        low, high = wilson(counts, size)
        for k, (value, count) in enumerate(zip(values.tolist(), counts.tolist(), strict=True)):
            share = Share(count / size, float(low[k]), float(high[k]), count)
            shares[Outcome(value).name] = share
        return shares

    def to_xarray(self) -> "xarray.Dataset":
        """The same as an `xarray.Dataset`, with units, versions and settings as attributes."""
        import xarray

        def said(unit: str, meaning: str) -> dict[str, str]:
            return {"units": unit, "long_name": meaning}

        columns = {
            name: (self.dims, self.column(name), said(*kind_of(name)[1:])) for name in self.columns
        }
        coords = {
            name: (
                (name, *(f"{name}_{k}" for k in range(1, values.ndim))),
                values,
                said(*AXES[name]) if name in AXES else {},
            )
            for name, values in self.coords.items()
        }
        return xarray.Dataset(columns, coords, self.attrs)

    def save(self, path: Any) -> None:
        """Write the basin as a Zarr group; `Basin.load` reads it back.

        Args:
            path: a folder that does not exist yet.

        Raises:
            ValueError: something is there already; nothing of it is touched.
        """
        from . import store

        store.save(self, path)

    @staticmethod
    def load(path: Any) -> "Basin":
        """A basin from disk: one that was saved, or a sweep's `store`.

        Args:
            path: the folder.

        Raises:
            ValueError: it is missing, not a basin, or a sweep that is not finished.
            StoreDamaged: it is not what was written; of a store without checksums, which older
                versions made, only what is missing or cannot be read is found.
        """
        from . import store

        return store.load(path)


def columns_of(found: Classification, derivatives: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """The columns of a basin from classifications, which have slopes along the `derivatives`."""
    columns = {name: np.asarray(getattr(found, name), kind[0]) for name, kind in FIELDS.items()}
    for k, name in enumerate(derivatives):
        columns[SLOPE + name] = np.asarray(found.slopes)[k]
    return columns
