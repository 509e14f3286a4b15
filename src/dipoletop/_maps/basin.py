"""Basins: outcomes on a grid or a sample, with the settings of the sweep."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._base.checks import flag, instance
from .._base.pictured import Pictured
from .._base.refusals import described, refuse
from .._base.statistics import Share, share_of
from .._base.tables import rows_of
from .._base.types import Outcome
from .columns import (
    DERIVATIVE_PREFIX,
    LEVEL,
    MISSING,
    START,
    BasinParts,
    component_dims,
    coordinate_dims,
    is_result,
    labels,
    with_level,
    without_versions,
)
from .grids import counted, described_axes
from .selection import at_positions, places_of, positions_of
from .store import saved_basins
from .store.errors import StoreDamaged

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(frozen=True, eq=False)
class Basin(Pictured):
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
    | `probability` | `probability` | of residual rotation; between 0 and 1 if chance decides |
    | `changed` | `changed` | with `confirm`: whether the second tolerance gives another outcome |
    | `derivative(axis)` | `d_omega_inf_d_…` | with `derivatives`: ∂ω∞/∂axis |
    | `column("computed")` | `computed` | of `adaptive.refine`: integrated, not filled in |
    | `omega0` | `omega0` | of a `Sample`: the starts, in 1/τ₀, shape (N, 3) |
    | `column(parameter)` | its name | of a `Sample`: an argument that `draw` gives by name |

    Further, `level` is the level of the equation of motion, and `fractions()` gives the share of
    every outcome. `sel` and `isel` take a part, by values or positions on the axes; `==` compares
    two basins, and `compare` counts where their outcomes differ. `to_xarray()`, `save(path)` and
    `Basin.load(path)` convert and store.

    Attributes:
        dims: names of the axes.
        shape: lengths of the axes.
        coords: values on the axes, or of every point; a single value where one was selected.
        columns: the columns, flat except for components, in memory or on disk.
        attrs: level of the equation, settings, versions.
        seconds: wall time of the sweep, compilation included; NaN for a loaded basin.
    """

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Float[np.ndarray, "..."]]
    columns: Mapping[str, Any]
    attrs: dict[str, Any]
    seconds: float = np.nan

    def column(self, name: str) -> np.ndarray:
        """Return one column, in the shape of the grid.

        Raises:
            ValueError: the basin has no such column.
            StoreDamaged: the column on disk differs from what was written.
        """
        if not isinstance(name, str) or name not in self.columns:
            refuse(
                "name", f"be a column of this basin ({', '.join(self.columns)})", described(name)
            )
        values = np.asarray(self.columns[name][:])
        return values.reshape(self.shape + values.shape[1:])

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
        """Members of `Regime`."""
        return self.column("regime")

    @property
    def probability(self) -> Float[np.ndarray, "*shape"]:
        """The probability that the rotation is residual: 1 for RESIDUAL, 0 for STOP.

        Between 0 and 1 chance decides, and the outcome is UNDECIDED; NaN where it is unknown.
        """
        return self.column("probability")

    @property
    def changed(self) -> Bool[np.ndarray, "*shape"]:
        """Whether the outcome differs at the second tolerance (sweeps with `confirm`)."""
        return self.column("changed")

    @property
    def omega0(self) -> Float[np.ndarray, "N 3"]:
        """The starts ω₀ of a sample, in body axes."""
        return self.column(START)

    def derivative(self, axis: str) -> Float[np.ndarray, "*shape"]:
        """Return ∂ω∞/∂axis, for sweeps with `derivatives`.

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
        """Return the share of every outcome that occurs, with 95 % intervals (Wilson).

        The intervals hold for independent random starts; on a regular grid they overstate the
        error. The shares of an unfinished sweep are among the starts computed so far.
        """
        outcome = self.outcome
        values, counts = np.unique(outcome[outcome != MISSING["int8"]], return_counts=True)
        size = int(np.sum(counts))
        return {
            Outcome(value).name: share_of(count, size)
            for value, count in zip(values.tolist(), counts.tolist(), strict=True)
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Return the basin as an `xarray.Dataset`, with units, versions and settings as attributes.

        The level is a coordinate, so that `xarray.concat` keeps that of each basin.
        `xarray.open_zarr` of its store gives the same, except that the level is an attribute, and
        columns of whole numbers become floating-point numbers, NaN where a tile is not computed
        yet.
        """
        import xarray

        variables, coords = {}, {}
        for name in self.columns:
            values = self.column(name)
            dims = (*self.dims, *component_dims(name, values.ndim - len(self.dims)))
            kind = variables if is_result(name) else coords
            kind[name] = (dims, values, labels(name))
        for name, values in self.coords.items():
            coords[name] = (coordinate_dims(name, self.dims, values.ndim), values, labels(name))
        data = xarray.Dataset(variables, *with_level(coords, self.attrs))
        if "outcome" not in variables or np.all(computed := data.outcome != MISSING["int8"]):
            return data
        truths = {name: x.astype("int8") for name, x in data.items() if x.dtype == bool}
        return data.assign(truths).where(computed)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return a `pandas.DataFrame` with a row for each start.

        Components have columns of their own, such as `omega_1`; units are in `attrs["units"]`.

        Example:
            >>> import dipoletop as dt
            >>> def problem(w3, phi):
            ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
            >>> basin = dt.sweep(problem, dt.Grid(w3=[0.1, 0.3], phi=[0.0, 0.8, 1.6]))
            >>> table = basin.to_dataframe()
            >>> len(table), table.attrs["units"]["w3"]
            (6, '1/tau_0')
        """
        # The level is the same in every row.
        return rows_of(self.to_xarray().drop_vars(LEVEL, errors="ignore"), self.dims)

    def isel(self, **positions: Any) -> "Basin":
        """Return the part at positions on axes; other axes are kept whole.

        Args:
            positions: name = number, slice, or list. An axis with a single number is dropped, and
                its value kept in `coords`.

        Raises:
            ValueError: there is no such axis, or position.

        Example:
            >>> import dipoletop as dt
            >>> def problem(w3, phi):
            ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
            >>> basin = dt.sweep(problem, dt.Grid(w3=[0.1, 0.3], phi=[0.0, 0.8, 1.6]))
            >>> basin.isel(w3=1, phi=slice(2)).shape, basin.sel(phi=0.7, method="nearest").shape
            ((2,), (2,))
        """
        return Basin(*at_positions(self._parts, positions))

    def sel(self, *, method: str | None = None, **values: Any) -> "Basin":
        """Return the part at values on axes; other axes are kept whole.

        Args:
            method: None for exactly these values, or "nearest", "pad" or "backfill", as in xarray.
            values: name = number, list, or slice, which includes both ends.

        Raises:
            ValueError: there is no such axis, or value.
        """
        return self.isel(**positions_of(self._parts, values, method))

    @property
    def _parts(self) -> BasinParts:
        return BasinParts(self.dims, self.shape, self.coords, self.columns, self.attrs)

    def __eq__(self, other: object) -> bool:
        """Return whether axes, settings except versions, and every bit of the columns are equal."""
        if not isinstance(other, Basin):
            return NotImplemented
        plain, others = (
            (x.dims, x.shape, list(x.columns), without_versions(x.attrs)) for x in (self, other)
        )
        if plain != others or self.coords.keys() != other.coords.keys():
            return False
        pairs = [(x, other.coords[name]) for name, x in self.coords.items()]
        return all(_same_bits(*pair) for pair in pairs) and all(
            _same_bits(self.column(name), other.column(name)) for name in self.columns
        )

    __hash__ = None  # pyright: ignore[reportAssignmentType]

    def compare(self, other: "Basin") -> dict[tuple[str, str], Share]:
        """Return the share of every pair of outcomes of the same start, here and in another basin.

        Args:
            other: a basin of the same starts, such as at another level or tolerance; their order,
                and that of the axes, may be another one.

        Returns:
            The shares by the names of both outcomes, with 95 % intervals as in `fractions`; of
            unfinished sweeps among the starts that both have computed.

        Raises:
            ValueError: a basin of other starts.
        """
        places = places_of(instance("other", other, Basin)._parts, self._parts)
        pairs = np.stack([self.outcome.ravel(), other.outcome.ravel()[places]])
        pairs = pairs[:, np.all(pairs != MISSING["int8"], axis=0)]
        values, counts = np.unique(pairs, axis=1, return_counts=True)
        return {
            (Outcome(here).name, Outcome(there).name): share_of(count, pairs.shape[1])
            for here, there, count in zip(*values.tolist(), counts.tolist(), strict=True)
        }

    def save(self, path: str | bytes | PathLike[Any]) -> None:
        """Write the basin as a Zarr group; `Basin.load` reads it back.

        Args:
            path: a folder that does not exist yet.

        Raises:
            StoreMismatch: something exists there already; it is left unchanged.
        """
        saved_basins.save(self._parts, path)

    @staticmethod
    def load(path: str | bytes | PathLike[Any], *, unfinished: bool = False) -> "Basin":
        """Load a basin from disk: one that was saved, or a sweep's `store`.

        Args:
            path: the folder.
            unfinished: whether to load an unfinished sweep, too, in its present state. Starts not
                computed yet have `outcome`, `stop` and `regime` −128, `steps` −2³¹, `certified`
                False, and NaN for other numbers; `to_xarray` has NaN for all. Data are then
                verified only when they are used.

        Raises:
            StoreMismatch: the store is missing, not a basin, or an unfinished sweep.
            StoreDamaged: the store differs from what was written.
        """
        return Basin(*saved_basins.load(path, flag("unfinished", unfinished)))

    def __repr__(self) -> str:
        lines = [
            f"Basin({self.attrs.get('level', 'level not known')}; rtol {self.attrs.get('rtol')}",
            f"{described_axes(self.coords) or ', '.join(self.dims)}; {counted(self.shape)}",
            self._summary(),
        ]
        return "\n      ".join(lines) + ")"

    def _summary(self) -> str:
        """Return the shares of every outcome and of certified starts, as text."""
        try:
            shares = [f"{name} {x.share:.2%}" for name, x in self.fractions().items()]
            computed = self.outcome != MISSING["int8"]
            if "certified" in self.columns and computed.any():
                shares.append(f"certified {np.mean(self.certified[computed]):.2%}")
            if not computed.all():
                shares = [f"of what is computed so far: {', '.join(shares)}"]
                shares.append(f"not computed yet {1 - np.mean(computed):.2%}")
        except StoreDamaged as error:
            return str(error)
        return ", ".join(shares)


def _same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    same_kind = one.dtype == other.dtype and one.shape == other.shape
    return same_kind and one.tobytes() == other.tobytes()
