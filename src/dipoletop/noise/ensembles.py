"""The paths of an ensemble: energies, momenta, dipoles, means with their errors, spectra."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._base.attitudes import rotate
from .._base.refusals import refuse
from .._base.summaries import with_error
from ..bodies import Body


class Mean(NamedTuple):
    """A mean over paths."""

    value: Any
    error: Any
    """The standard error: the standard deviation of the paths over √n."""

    def __repr__(self) -> str:
        if np.ndim(self.value):
            return f"Mean(shape={np.shape(self.value)})"
        return f"Mean({with_error(float(self.value), float(self.error))})"


class Spectrum(NamedTuple):
    """The power spectral density of the dipole in the laboratory, one-sided."""

    frequency: Float[np.ndarray, "F"]
    """Angular frequencies ω, in units of 1/τ₀."""
    density: Float[np.ndarray, "F 3"]
    """Of each component along x, y, z: its integral over ω is the variance in a segment."""


class Ensemble(eqx.Module):
    """N paths of a body with noise, at T times, dimensionless.

    Attributes:
        ts: times τ, shape (T,).
        omega: ω in body axes, shape (N, T, 3). Of an averaged ensemble at a random phase of the
            free rotation.
        energy: property; ½ω·Iω, shape (N, T).
        momentum: property; Iω in body axes, shape (N, T, 3).
        size: property; |Iω|, shape (N, T).
        dipole: property; the dipole in the laboratory, shape (N, T, 3); needs the attitude.
        attitude: unit quaternions from body axes to the laboratory, scalar first, shape
            (N, T, 4); None if they were not followed.
        body: the body.
    """

    ts: Float[np.ndarray, "T"]
    omega: Float[np.ndarray, "N T 3"]
    attitude: Float[np.ndarray, "N T 4"] | None
    body: Body

    @property
    def momentum(self) -> Float[np.ndarray, "N T 3"]:
        """L = Iω in body axes."""
        return self.omega @ np.asarray(self.body.inertia)

    @property
    def energy(self) -> Float[np.ndarray, "N T"]:
        """E = ½ω·Iω."""
        return np.sum(self.omega * self.momentum, axis=-1) / 2

    @property
    def size(self) -> Float[np.ndarray, "N T"]:
        """|L|."""
        return np.linalg.norm(self.momentum, axis=-1)

    @property
    def dipole(self) -> Float[np.ndarray, "N T 3"]:
        """The dipole in the laboratory."""
        if self.attitude is None:
            refuse("attitude", "be given to `ensemble`", "is None")
        q = jnp.moveaxis(jnp.asarray(self.attitude), -1, 0)
        d = jnp.asarray(self.body.dipole).reshape(3, 1, 1)
        return np.moveaxis(np.asarray(rotate(q, jnp.broadcast_to(d, q[1:].shape))), 0, -1)

    @property
    def well(self) -> Int[np.ndarray, "N T"]:
        """The well of L: 1 if L moves round the axis of J₁, 3 round that of J₃, signed.

        The sign is that of L along the axis, whose own sign is that of `numpy.linalg.eigh`.
        """
        moments, axes = np.linalg.eigh(np.asarray(self.body.inertia))
        first, _, last = np.moveaxis(self.momentum @ axes, -1, 0)
        p1, p2, p3 = 1 / moments
        high = (p1 - p2) * first**2 > (p2 - p3) * last**2
        sense = np.where(high, first, last) < 0
        return np.where(high, 1, 3) * np.where(sense, -1, 1)

    def escape_times(self, inside: Any) -> Float[np.ndarray, "N"]:
        """Return the first of the times at which each path is outside; infinite if it never is.

        Args:
            inside: whether a path is inside, such as `ensemble.well == 1`, shape (N, T).
        """
        inside = np.asarray(inside)
        if inside.shape != self.size.shape:
            refuse("inside", f"have shape {self.size.shape}", f"has shape {inside.shape}")
        first = self.ts[np.argmin(inside, axis=1)]
        return np.where(np.all(inside, axis=1), np.inf, first)

    def mean(self, values: Any) -> Mean:
        """Return the mean over the paths, the first axis of `values`, with its standard error."""
        values = np.asarray(values)
        if values.shape[:1] != self.omega.shape[:1]:
            must = f"have the paths on the first axis, of length {len(self.omega)}"
            refuse("values", must, f"has shape {values.shape}")
        error = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
        return Mean(np.mean(values, axis=0), error)

    def spectrum(self, segments: int = 8) -> Spectrum:
        """Estimate the spectrum of the dipole in the laboratory, by Welch's method over all paths.

        Args:
            segments: the number of half-overlapping parts of the time is about twice this.

        Raises:
            ValueError: times that are not evenly spaced, or paths without attitudes.
        """
        from scipy.signal import welch

        gaps = np.diff(self.ts)
        if np.ptp(gaps) > 1e-6 * gaps[0]:
            refuse("ts", "be evenly spaced for a spectrum", "is not")
        length = max(2, len(self.ts) // segments)
        rate = 2 * np.pi / gaps[0]
        frequency, density = welch(self.dipole, rate, nperseg=length, axis=1, detrend="constant")
        return Spectrum(frequency, np.mean(density, axis=0))

    def __repr__(self) -> str:
        """Return the number of paths, the times, and the last means."""
        if not all(isinstance(leaf, np.ndarray | jax.Array) for leaf in jax.tree.leaves(self)):
            return eqx.tree_pformat(self)
        n, count, _ = self.omega.shape
        energy, size = (self.mean(x[:, -1]) for x in (self.energy, self.size))
        shown = f"{n} paths at {count} times from {self.ts[0]:g} to {self.ts[-1]:g}"
        return f"Ensemble({shown}; at the last ⟨E⟩={energy}, ⟨|L|⟩={size})".replace("Mean", "")
