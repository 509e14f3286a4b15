"""Bodies and starts for the slow flow: forty chosen bodies, random bodies, and degenerate bodies.

The largest moment is 1, except for axisymmetric bodies, whose moment across the axis is 1; the
dipole has length 1.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.problems.random_bodies import Starts, directions, moments

TILT = 1e-3  # of a dipole off a principal axis
DELTAS = (-0.6, -0.3, 0.3, 0.6, 0.9)
DIPOLES = {"on J1": (1, 0, 0), "on J2": (0, 1, 0), "on J3": (0, 0, 1), "off axis": (0.3, 0.5, 0.8)}
TILTED = {"off J1": (1, TILT, TILT), "off J2": (TILT, 1, TILT), "off J3": (TILT, TILT, 1)}
SHAPES = {  # family: moments and dipoles
    "nearly oblate, 1e-2": [((0.6, 0.606, 1.0), "on J1", "on J2", "on J3")],
    "nearly oblate, 1e-3": [((0.6, 0.6006, 1.0), "on J1", "on J2", "on J3")],
    "nearly prolate, 1e-2": [((0.6, 0.99, 1.0), "on J1", "on J2", "on J3")],
    "nearly prolate, 1e-3": [((0.6, 0.999, 1.0), "on J1", "on J2", "on J3")],
    "asymmetric": [
        ((0.6, 0.75, 1.0), *DIPOLES),
        ((0.45, 0.55, 1.0), *DIPOLES),
        ((0.1, 0.95, 1.0), "on J1", "on J2", "on J3"),
    ],
    "asymmetric, dipole 1e-3 off": [((0.6, 0.75, 1.0), *TILTED)],
    "nearly spherical, 1e-2": [((0.99, 0.995, 1.0), *DIPOLES)],
}
SLOW = 1e-12  # |ω| of `everywhere`
KINDS = ("principal", "random", "1e-3 off", "principal")  # of random dipoles, in turn


class Bodies(NamedTuple):
    """Some bodies."""

    family: list[str]
    inertia: np.ndarray  # (B, 3, 3)
    dipole: np.ndarray  # (B, 3)

    def started(self, omegas: np.ndarray) -> Starts:
        """Each body with each of S starts, shape (S, 3): B·S of them, the starts in turn."""
        bodies = (np.repeat(part, len(omegas), axis=0) for part in (self.inertia, self.dipole))
        return Starts(*bodies, np.tile(omegas, (len(self.family), 1)))


def chosen(small: bool) -> Bodies:
    """Return the forty chosen bodies, or a few of them if `small`."""
    rows = []
    for delta in DELTAS:
        kind = "needle, transverse" if delta > 0 else "disc, transverse"
        rows.append((kind, (1, 1, 1 - delta), (1, 0, 0)))
        rows.append(("axisymmetric, longitudinal", (1, 1, 1 - delta), (0, 0, 1)))
    for family, shapes in SHAPES.items():
        for principal, *places in shapes:
            rows += [(family, principal, (DIPOLES | TILTED)[place]) for place in places]
    if small:  # needles compile for long
        rows = [row for row in rows if row[0] != "needle, transverse"][::6]
    family, principal, dipoles = zip(*rows, strict=True)
    n = np.array(dipoles, float)
    inertia = np.einsum("ni,ij->nij", np.array(principal, float), np.eye(3))
    return Bodies(list(family), inertia, n / np.linalg.norm(n, axis=1)[:, None])


def at_random(n: int) -> tuple[list[str], Starts]:
    """Kinds of dipole, and bodies with a start: moments uniform among the possible ones.

    |ω| is log-uniform from 10^−3.5 to 10^−2.5.
    """
    rng = np.random.default_rng([0, 24])
    j = np.sort(moments(rng, n), axis=1)
    j /= j[:, 2:]
    kinds = [KINDS[k % len(KINDS)] for k in range(n)]
    axis, way = np.eye(3)[rng.integers(0, 3, n)], directions(n, rng)
    tilted = axis + TILT * way
    dipole = np.select(
        [np.array([[kind == name] for kind in kinds]) for name in ("principal", "random")],
        [axis, way],
        tilted / np.linalg.norm(tilted, axis=1)[:, None],
    )
    omega = 10 ** rng.uniform(-3.5, -2.5, n)[:, None] * directions(n, rng)
    return kinds, Starts(np.einsum("ni,ij->nij", j, np.eye(3)), dipole, omega)


def everywhere(n: int, randoms: int) -> dict[str, Starts]:
    """Return bodies in their principal axes with slow isotropic starts, |ω| = `SLOW`.

    Args:
        n: number of bodies of each degenerate family: moments that are equal, or so nearly equal or
            so small that terms cancel, by a log-uniform difference.
        randoms: number of random bodies.
    """
    rng = np.random.default_rng([0, 42])
    one, axes = np.ones(n), np.eye(3)

    def small(low: float, high: float) -> np.ndarray:
        return 10 ** rng.uniform(low, high, n)

    def either(sizes: np.ndarray) -> np.ndarray:
        return rng.choice([-1, 1], n) * sizes

    thin, split, two = small(-13, -2), small(-14, -2), small(-9, -2.3)
    least, share = rng.uniform(0.35, 0.9, n), rng.uniform(0, 1, n)
    # The zero h* of F of a dipole on J₂ comes to the axis of J₃ where J₂J₁² = (J₃ − J₂)(J₃ − J₁)².
    middle = (1 - least) ** 2 / (least**2 + (1 - least) ** 2)
    middle = middle * (1 + either(small(-14, -3)))
    exists = (middle > least) & (middle < 1) & (least + middle > 1)
    shapes = {
        "cylinder, length = radius": ((one, one, 1.5 + either(split)), axes[0]),
        "disc, transverse": ((one, one, 2 - split), axes[0]),
        "rod, longitudinal": ((thin, one, one), axes[0]),
        "nearly spherical": ((1 - two, 1 - share * two, one), axes[rng.integers(0, 3, n)]),
        "nearly oblate": ((0.6 * one, 0.6 * (1 + split), one), axes[rng.integers(0, 3, n)]),
        "nearly prolate": ((0.6 * one, 1 - split, one), axes[rng.integers(0, 3, n)]),
        "square plate": ((one / 2, (1 + split) / 2, 1 + split / 2), axes[rng.integers(0, 2, n)]),
        "h* next to an axis": ((least, np.where(exists, middle, 0.95), one), axes[1]),
        "rod, transverse": ((small(-10, -2), one, one), axes[2]),
    }
    found = {}
    for family, (moments_of, dipole) in shapes.items():
        inertia = np.einsum("in,ij->nij", np.stack(moments_of), axes)
        omega = SLOW * directions(n, rng)
        found[family] = Starts(inertia, np.broadcast_to(dipole, (n, 3)), omega)
    _, sample = at_random(randoms)
    slow = SLOW * sample.omega / np.linalg.norm(sample.omega, axis=1)[:, None]
    return found | {"at random": sample._replace(omega=slow)}
