"""The separatrix of order 1 by Taylor series in 80-bit numbers, without any certificate."""

from typing import Any, NamedTuple

import numpy as np

from dipoletop import Outcome

DELTA = -0.2  # shape of the tops
NEAREST, FARTHEST = 1e-14, 1e-2  # distances of the wall's starts from the separatrix, in φ
HALVINGS = 6  # 2^HALVINGS angles in each round of the search
ORDER = 26  # of the Taylor series


def _series(d: np.longdouble, y: np.ndarray) -> np.ndarray:
    """Return Taylor coefficients (ORDER + 1, 3, N) of the solution of (4.2)–(4.4)."""
    c = np.zeros((ORDER + 1, *y.shape), np.longdouble)
    c[0] = y
    drag, axial = np.zeros((2, ORDER + 1, y.shape[1]), np.longdouble)
    w1, w2, w3 = c[:, 0], c[:, 1], c[:, 2]
    for k in range(ORDER):

        def product(a: np.ndarray, b: np.ndarray, k: int = k) -> np.ndarray:
            return np.sum(a[: k + 1] * b[k::-1], axis=0)

        s1, s2, s3 = product(c, c)
        drag[k] = s1 + s2 + s3 + d * (1 + d) * s3
        axial[k] = (s1 + s2 + s3 + d * (2 * s1 - s2)) / (1 - d)
        rate = [d * product(w2, w3), -d * product(w1, w3) - product(drag, w2), -product(axial, w3)]
        c[k + 1] = np.stack(rate) / (k + 1)
    return c


def outcomes(delta: float, omegas: np.ndarray) -> np.ndarray:
    """Integrate starts (3, N) until precession or the line clearly wins; return the outcomes."""
    d, y = np.longdouble(delta), np.array(omegas, np.longdouble)
    labels, live = np.zeros(y.shape[1], int), np.arange(y.shape[1])
    while live.size:
        c = _series(d, y[:, live])
        sizes = np.sqrt(np.sum(c**2, axis=1))
        reach = [(sizes[0] / sizes[k]) ** (1 / np.longdouble(k)) for k in (ORDER - 1, ORDER)]
        h = np.minimum(*reach) * np.exp(np.longdouble(-2))
        new = c[ORDER]
        for lower in c[-2::-1]:
            new = new * h + lower
        y[:, live] = new
        w1, w2, w3 = new
        stop = np.abs(d * w3) > 6 * (w1**2 + w2**2)
        line = (w1 * w2) ** 2 + (d * w3) ** 2 < 1e-4 * w1**4
        labels[live] = np.where(stop, Outcome.STOP, np.where(line, Outcome.RESIDUAL, 0))
        live = live[~(stop | line)]
    return labels


def starts_at(phi: np.ndarray) -> np.ndarray:
    """Return starts with ω⊥ = ω₃ = 1/5 at the angles φ, shape (3, N)."""
    fifth = np.longdouble(1) / 5
    return np.stack([fifth * np.cos(phi), fifth * np.sin(phi), np.full_like(phi, fifth)])


def wrong(labels: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Whether labels are wrong, of starts that both decide."""
    return (labels > 0) & (truth > 0) & (labels != truth)


def counted(labels: np.ndarray, truth: np.ndarray) -> dict[str, int]:
    """Wrong labels, and undecided ones."""
    return {"wrong": int(np.sum(wrong(labels, truth))), "undecided": int(np.sum(labels <= 0))}


class Wall(NamedTuple):
    """Starts on both sides of the separatrix."""

    edge: Any
    """The angle φ of the separatrix."""
    between: float
    """The uncertainty of `edge`."""
    starts: np.ndarray  # (3, N)
    truth: np.ndarray
    """Their outcomes, (N,)."""
    distance: np.ndarray
    """Their distances from the separatrix, in φ, (N,)."""

    def farthest(self, which: np.ndarray) -> float:
        """The largest distance of some of them."""
        return float(np.max(self.distance[which], initial=0))

    def judged(self, labels: np.ndarray) -> dict[str, Any]:
        """Numbers of wrong and undecided labels, and the largest distance of a wrong one."""
        farthest = self.farthest(wrong(labels, self.truth))
        return counted(labels, self.truth) | {"farthest": farthest}

    def about(self) -> dict[str, Any]:
        """Which wall it is."""
        about = {"edge": str(self.edge), "between": self.between, "span": [NEAREST, FARTHEST]}
        return about | {"starts": len(self.truth)}


def wall(each: int, rounds: int = 10) -> Wall:
    """So many starts on either side of the separatrix, ω⊥ = ω₃ = 1/5, found by bisection."""
    low, high = np.longdouble(0), np.longdouble(1)
    for _ in range(rounds):
        phi = low + (high - low) * np.arange(2**HALVINGS + 1) / np.longdouble(2**HALVINGS)
        last = np.flatnonzero(np.diff(outcomes(DELTA, starts_at(phi))))[0]
        low, high = phi[last], phi[last + 1]
    edge, far = (low + high) / 2, np.geomspace(FARTHEST, NEAREST, each).astype(np.longdouble)
    starts = starts_at(np.concatenate([edge - far, edge + far])).astype(float)
    truth = outcomes(DELTA, starts)  # of the rounded starts
    return Wall(edge, float(high - low), starts, truth, np.concatenate([far, far]).astype(float))
