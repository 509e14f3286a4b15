"""Bodies and starts for the slow flow: forty chosen bodies, and random bodies.

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
