"""The benchmark problem "mixed basin": its starts, its right-hand side, and its certificate.

Axisymmetric tops with a transverse dipole, equation (4.2)–(4.4), δ uniform in (−0.45, 0.45),
|ω| log-uniform in 0.05 … 1, isotropic directions. A run ends at a certificate: a region of
(δ, ω) from which the outcome is certain. All integrators get the same starts and the same
certificate.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

UNDECIDED, RESIDUAL, STOP = 0, 1, 2  # the integers of dipoletop.Outcome
DELTA_MAX = 0.45
AMPLITUDES = (0.05, 1.0)
MAX_STEPS = 4096  # a run that takes more stays UNDECIDED
HORIZON = 1e30  # a time τ that no run reaches


def sample(n: int, seed: int = 0) -> tuple[Float[np.ndarray, "{n}"], Float[np.ndarray, "{n} 3"]]:
    """Return shapes δ (n,) and starts ω (n, 3); start i depends on (seed, i) only."""
    shape, size, height, turn = np.random.default_rng(seed).random((n, 4)).T
    low, high = AMPLITUDES
    speed = low * (high / low) ** size
    cosine, azimuth = 2 * height - 1, 2 * np.pi * turn
    sine = np.sqrt(1 - cosine**2)
    direction = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)
    return DELTA_MAX * (2 * shape - 1), speed[:, None] * direction


def isotropic(n: int, amplitude: float) -> Float[np.ndarray, "{n} 3"]:
    """Return the directions of the mixed basin, all with |ω| = amplitude."""
    _, omegas = sample(n)
    return amplitude * omegas / np.linalg.norm(omegas, axis=1)[:, None]


def rate(delta: Any, w: Any, strength: Any = 1.0) -> tuple[Any, Any, Any]:
    """Return dω/dτ of (4.2)–(4.4) as a tuple, for numbers, arrays or symbols.

    With ω = Ay and s = Aτ the equation for dy/ds is the same, its radiation terms (the cubic
    ones) multiplied by `strength` = A.
    """
    w1, w2, w3 = w
    square = w1**2 + w2**2 + w3**2
    return (
        delta * w2 * w3,
        -delta * w1 * w3 - strength * (square + delta * (1 + delta) * w3**2) * w2,
        -strength * (square + delta * (2 * w1**2 - w2**2)) * w3 / (1 - delta),
    )


def certificate(delta: Any, w: Any, xp: Any = np) -> Any:
    """Return the label of a state, −1/2 < δ < 1: UNDECIDED unless the outcome is certain.

    `w` holds the components on axis 0 (any sequence of three); `xp` is numpy or jax.numpy. ω is in
    units of 1/τ₀ (the regions change when it is scaled). States on an invariant line or plane
    (ω₃ = 0, …) are not handled: they have measure zero and do not occur in the sample.
    """
    w1, w2, w3 = w
    a, b, c = w1**2, w2**2, w3**2
    u = a + b  # ω⊥²
    # δ < 0: ω₂² ≤ u(1+2δ)/(2+δ), |ω₃| ≤ u√((1−δ)(1+2δ))/(|δ|(2+δ));  δ ≥ 0: ω₂² ≤ ω₁², 2δ|ω₃| ≤ u
    oblate = delta < 0
    precession = xp.abs(delta * w3)
    room = xp.maximum((1 - delta) * (1 + 2 * delta), 0.0)
    width = xp.where(oblate, (1 + 2 * delta) / (2 + delta), 0.5)
    height = xp.where(oblate, xp.sqrt(room) / (2 + delta), 0.5)
    residual = (a > 0) & (b <= u * width) & (precession <= u * height)
    # δ < 0: q > S and ln q + S/q > 1 (Mω₃² ≤ 0.8u) or 1.1 (anywhere)
    inertia = (1 + delta + delta**2) * c  # Mω₃²
    tiny = np.finfo(np.float64).tiny
    q = xp.maximum(2 * precession / xp.maximum(u + inertia, tiny), tiny)
    s = xp.sign(w3) * 2 * w1 * w2 / xp.maximum(u, tiny)
    enough = xp.where(inertia <= 0.8 * u, 1.0, 1.1)
    stop = oblate & (q > s) & (xp.log(q) + s / q > enough)
    certain = residual | (delta > 0)  # where almost every start is residual
    return xp.where(certain, RESIDUAL, xp.where(stop, STOP, UNDECIDED))
