"""The points of a sweep: a grid of named axes, listed points, or a random sample."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int
from typing_extensions import TypeAliasType

from .._base.checks import finite, positive, real, shape_of
from .._base.quantities import Quantity
from .._base.refusals import described, refuse
from .._base.tolerances import budget, whole

PointValues = Array | Mapping[str, Array | np.ndarray]
"""The arguments of a problem: the start ω₀, or named values; of one point or of many."""
Draw = Callable[[Array], PointValues]
"""A function from a random key to one point."""
BLOCK = 1 << 32  # starts of a sample that one number of 32 bits can index
MOST_STARTS = BLOCK**2 // 2 - 1
GENERATOR = "threefry2x32"
"""The generator of random numbers, whatever the default of JAX is."""
Numbers = TypeAliasType("Numbers", ArrayLike | Sequence[Any] | Quantity)
"""Numbers as an array, or as nested lists."""


class Header(NamedTuple):
    """Plain values and arrays that identify a grid, points or a sample."""

    kind: str
    settings: dict[str, Any]
    values: dict[str, np.ndarray]


class Grid:
    """Every combination of the values on named axes.

    The names are the arguments of the sweep's `problem`, such as δ, ω⊥, ω₃, φ, an amplitude, a
    direction or an inertia ratio.

    Args:
        axes: name = values; shape (n,) for numbers, or (n, …) for vectors such as directions. A
            single number is an axis of length 1.

    Raises:
        ValueError: there is no axis, or one is empty, not finite, or not made of numbers.

    Example:
        >>> import dipoletop as dt
        >>> dt.Grid(delta=[-0.2, 0.2], phi=[0.0, 1.0, 2.0]).shape
        (2, 3)
    """

    def __init__(self, **axes: Numbers) -> None:
        if not axes:
            refuse("axes", "name at least one axis", "names none")
        self.axes = {name: _axis(name, values) for name, values in axes.items()}

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the axes, in order."""
        return tuple(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each axis."""
        return tuple(len(values) for values in self.axes.values())

    @property
    def coords(self) -> dict[str, Float[np.ndarray, "..."]]:
        """The values on each axis."""
        return self.axes

    @property
    def header(self) -> Header:
        """Plain values and arrays that identify this grid."""
        return Header("Grid", {}, self.axes)

    def points(self, index: Int[np.ndarray, "n"]) -> dict[str, Float[np.ndarray, "n *rest"]]:
        """Return the arguments of the problem at flat indices (C order)."""
        per_axis = np.unravel_index(index, self.shape)
        return {
            name: values[along]
            for (name, values), along in zip(self.axes.items(), per_axis, strict=True)
        }

    def __repr__(self) -> str:
        return f"Grid({described_axes(self.axes)}; {counted(self.shape)})"


class Points:
    """A list of single points.

    Args:
        columns: name = values, all of the same length; the names are the arguments of the
            sweep's `problem`. Shape (n,) for numbers, or (n, …) for vectors such as starts.

    Raises:
        ValueError: there is no column, one is not finite, or their lengths differ.

    Example:
        >>> import dipoletop as dt
        >>> dt.Points(w3=[0.1, 0.2, 0.3], phi=[0.0, 1.0, 2.0]).shape
        (3,)
    """

    dims = ("point",)

    def __init__(self, **columns: Numbers) -> None:
        if not columns:
            refuse("columns", "name at least one column", "names none")
        self.columns = {name: _axis(name, values) for name, values in columns.items()}
        lengths = {name: len(values) for name, values in self.columns.items()}
        if len(set(lengths.values())) > 1:
            shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
            refuse("columns", "all have the same length", f"have lengths {shown}")

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of points."""
        return (len(next(iter(self.columns.values()))),)

    @property
    def coords(self) -> dict[str, Float[np.ndarray, "..."]]:
        """The values of every point."""
        return self.columns

    @property
    def header(self) -> Header:
        """Plain values and arrays that identify these points."""
        return Header("Points", {}, self.columns)

    def points(self, index: Int[np.ndarray, "n"]) -> dict[str, Float[np.ndarray, "n *rest"]]:
        """Return the arguments of the problem for the points with these numbers."""
        return {name: values[index] for name, values in self.columns.items()}

    def __repr__(self) -> str:
        return f"Points({described_axes(self.columns)}; {counted(self.shape)})"


def _axis(name: str, values: Numbers) -> np.ndarray:
    array = np.atleast_1d(np.asarray(real(name, values, (-1,) * len(shape_of(values)))))
    if array.size == 0:
        refuse(name, "hold at least one value", "holds none")
    # In NumPy: JAX would compile the test for every new number of points.
    if not np.isfinite(array).all():
        finite(name, array, (-1,) * array.ndim)
    return array


def described_axes(axes: Mapping[str, np.ndarray]) -> str:
    """Return a description of axes, such as "delta: -0.2, phi: 256 values in [0, 3.129]"."""
    return ", ".join(_described_axis(name, values) for name, values in axes.items())


def _described_axis(name: str, values: np.ndarray) -> str:
    """Return a description of an axis, such as "phi: 256 values in [0, 3.129]"."""
    if values.ndim > 1:
        shape = str(values.shape[1:])
        return f"{name}: {len(values)} vector{'s' * (len(values) > 1)} of shape {shape}"
    if values.size == 1:
        return f"{name}: {values.item():.4g}"
    return f"{name}: {len(values)} values in [{np.min(values):.4g}, {np.max(values):.4g}]"


def counted(shape: tuple[int, ...]) -> str:
    """Return the number of starts, such as "51 456 starts"."""
    size = int(np.prod(shape))
    return f"{size:,} start{'s' * (size != 1)}".replace(",", " ")


def symmetry_cell(n_phi: int = 512, n_w3: int = 512, w3_max: ArrayLike = 0.5) -> Grid:
    """Return a grid over one symmetry cell of the transverse top: 0 ≤ φ < π, 0 ≤ ω₃ ≤ ω₃max.

    Every level of the equation has the symmetries (ω₂, ω₃) → −(ω₂, ω₃) and φ → φ + π, which give
    all other starts; `plots.basin` draws them, too.

    Args:
        n_phi: number of points on φ.
        n_w3: number of points on ω₃.
        w3_max: the largest ω₃, dimensionless.

    Raises:
        ValueError: a number of points is not positive, or the largest ω₃ is not.
    """
    n_phi, n_w3 = budget("n_phi", n_phi), budget("n_w3", n_w3)
    w3 = np.linspace(0.0, float(positive("w3_max", w3_max, batch=False)), n_w3)
    return Grid(w3=w3, phi=np.arange(n_phi) * (np.pi / n_phi))


class Sample:
    """Random starts; start i depends on (seed, i) only.

    Args:
        n: number of starts.
        amplitude: |ω₀| of isotropic starts; a pair (least, most) draws it log-uniformly.
        seed: a whole number.
        draw: a function from a random key to ω₀, or to a dict of the `problem`'s arguments, such as
            `uniform_box(low, high)`; None: isotropic starts.

    Raises:
        ValueError: n < 1, an amplitude that is not positive, or a `draw` that is not callable.

    Example:
        >>> import dipoletop as dt
        >>> dt.Sample(n=1000, amplitude=0.2, seed=0).shape
        (1000,)
    """

    dims = ("sample",)

    def __init__(
        self, n: int, amplitude: Numbers = 1.0, *, seed: int = 0, draw: Draw | None = None
    ) -> None:
        self.n = whole("n", n, 1, "be a positive whole number", MOST_STARTS)
        self.seed = whole("seed", seed, -(2**63), "be a whole number")
        if draw is not None and not callable(draw):
            refuse("draw", "be a function of a random key, or None", described(draw))
        self.amplitude = None if draw else amplitude
        self.draw = draw if draw else isotropic(amplitude)

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of starts."""
        return (self.n,)

    @property
    def coords(self) -> dict[str, Float[np.ndarray, "..."]]:
        """An empty dict: a sample has no coordinates; a basin keeps its starts in columns."""
        return {}

    @property
    def header(self) -> Header:
        """Plain values that identify this sample, except for the function `draw`."""
        settings: dict[str, Any] = {"seed": self.seed}
        if self.amplitude is not None:
            settings["amplitude"] = np.asarray(self.amplitude, float).tolist()
        return Header("Sample", settings, {})

    def points(self, index: Int[np.ndarray, "n"]) -> Any:
        """Return the starts with these numbers, shape (n, 3), or a dict of arrays."""
        with jax.threefry_partitionable(True):  # a setting of the user may differ
            key = jax.random.key(self.seed, impl=GENERATOR)
            # A key takes 32 bits at once.
            high, low = (jnp.asarray(part, "uint32") for part in np.divmod(index, BLOCK))
            if np.any(index >= BLOCK):
                key = jax.vmap(lambda n: jnp.where(n > 0, jax.random.fold_in(key, n), key))(high)
            keys = jax.vmap(jax.random.fold_in, (0 if key.ndim else None, 0))(key, low)
            return jax.vmap(self.draw)(keys)

    def __repr__(self) -> str:
        drawn = f"amplitude={self.amplitude}"
        if self.amplitude is None:
            drawn = f"draw={getattr(self.draw, '__qualname__', self.draw)}"
        return f"Sample(n={self.n}, {drawn}, seed={self.seed})"


def isotropic(amplitude: Numbers) -> Draw:
    """Return a `draw` of isotropic starts, |ω₀| = amplitude or log-uniform in (least, most)."""
    bounds = np.atleast_1d(np.asarray(finite("amplitude", amplitude)))
    if len(bounds) not in (1, 2) or bounds[0] <= 0 or bounds[-1] < bounds[0]:
        refuse("amplitude", "be positive, or a pair 0 < least ≤ most", f"is {amplitude}")
    return _Isotropic(np.log(bounds[0]), np.log(bounds[-1]))


@dataclass(frozen=True)
class _Isotropic:
    """Isotropic starts with ln |ω₀| uniform between two numbers."""

    low: float
    high: float

    def __call__(self, key: Array) -> Float[Array, "3"]:
        key_direction, key_size = jax.random.split(key)
        normal = jax.random.normal(key_direction, (3,), float)
        unit = normal / jnp.sqrt(jnp.sum(normal**2))
        return jnp.exp(jax.random.uniform(key_size, (), float, self.low, self.high)) * unit


def uniform_box(low: Numbers, high: Numbers) -> Draw:
    """Return a `draw` of starts uniform in the box low ≤ ω₀ ≤ high, bounds of shape (3,)."""
    least = finite("low", low, (3,), batch=False)
    most = finite("high", high, (3,), batch=False)
    if bool(jnp.any(least > most)):
        refuse("low", "nowhere exceed `high`", f"is {low}")
    return _InBox(np.asarray(least), np.asarray(most))


@dataclass(frozen=True, eq=False)
class _InBox:
    """Starts uniform in a box."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    def __call__(self, key: Array) -> Float[Array, "3"]:
        return jax.random.uniform(key, (3,), float, self.low, self.high)

    def __repr__(self) -> str:
        return f"uniform_box({self.low.tolist()}, {self.high.tolist()})"
