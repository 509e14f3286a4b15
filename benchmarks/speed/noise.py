"""Paths with noise: steps a second and errors of means, beside diffrax and a plain scan.

    python -m benchmarks.speed.noise --small     a look
    python -m benchmarks.speed.noise             all, some minutes
    python -m benchmarks.speed.noise --write     the same, kept: results/noise.md

A triaxial body with an oblique dipole in thermal radiation, on one core.
"""

from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks.reporting import measure, pages
from dipoletop.noise.bath import Kicks

MOMENTS = np.array([1.0, 1.3, 1.9])
DIRECTION = np.array([0.5, 0.6, -0.4]) / np.linalg.norm([0.5, 0.6, -0.4])
KAPPA, STEP = 1 / 16, 0.05
BODY = dt.Body(np.diag(MOMENTS), np.sqrt(KAPPA) * DIRECTION)
EQUATION = dt.Reduced(BODY, order=1)
KICKS = Kicks(BODY, dt.noise.Bath(1.0), (True, False))


def heated(n: int, seed: int = 0) -> Any:
    """Rotations in equilibrium at kT = 1."""
    return np.random.default_rng(seed).normal(size=(n, 3)) / np.sqrt(MOMENTS)


def ours(starts: Any, time: float, step: float) -> Any:
    """Final ω by `noise.ensemble`."""
    noisy = dt.noise.with_noise(EQUATION, dt.noise.Bath(1.0))
    return dt.noise.ensemble(noisy, starts, [0.0, time], n=len(starts), step=step).omega[:, -1]


def averaged(starts: Any, time: float, step: float) -> Any:
    """Final ω by `noise.averaged_ensemble`; the step is a relative change.

    All of it at τ₀Ω = 1e-3, where turns are short beside the time of friction.
    """
    scale = 1e-3
    found = dt.noise.averaged_ensemble(
        BODY,
        dt.noise.Bath(scale**2),
        scale * starts,
        [0.0, time / scale**2],
        n=len(starts),
        step=step,
        seed=1,
    )
    return found.omega[:, -1] / scale


def forces(omega: Any) -> tuple[Any, Any]:
    """The drift and the matrix of the noise of one path, in the sense of Stratonovich."""
    momentum = KICKS.inertia @ omega
    columns = [KICKS.inverse @ KICKS.field(momentum, each) for each in jnp.eye(3)]
    matrix = jnp.stack(columns, axis=1)
    return EQUATION(0.0, omega) + matrix @ KICKS.shift, KICKS.spread * matrix


def plain(starts: Any, time: float, step: float) -> Any:
    """Final ω by `vmap` of a scan over steps of Heun's method."""
    return _plain(jnp.asarray(starts), round(time / step), step)


@jax.jit(static_argnums=1)
def _plain(starts: Any, count: int, step: float) -> Any:
    def path(key: Any, omega: Any) -> Any:
        def one(omega: Any, key: Any) -> tuple[Any, None]:
            kick = jnp.sqrt(step) * jax.random.normal(key, (3,))

            def change(omega: Any) -> Any:
                drift, matrix = forces(omega)
                return step * drift + matrix @ kick

            first = change(omega)
            return omega + (first + change(omega + first)) / 2, None

        return jax.lax.scan(one, omega, jax.random.split(key, count))[0]

    return jax.vmap(path)(jax.random.split(jax.random.key(2), len(starts)), starts)


@jax.jit
def by_diffrax(starts: Any, time: float, step: float) -> Any:
    """Final ω by diffrax: Heun's method, a virtual Brownian tree, constant steps."""

    def path(key: Any, omega: Any) -> Any:
        tree = diffrax.VirtualBrownianTree(0.0, time, tol=step / 2, shape=(3,), key=key)
        drift = diffrax.ODETerm(lambda t, y, args: forces(y)[0])
        noise = diffrax.ControlTerm(lambda t, y, args: forces(y)[1], tree)
        terms = diffrax.MultiTerm(drift, noise)
        saved = diffrax.SaveAt(t1=True)
        found = diffrax.diffeqsolve(
            terms, diffrax.Heun(), 0.0, time, step, omega, saveat=saved, max_steps=None
        )
        return found.ys[0]

    return jax.vmap(path)(jax.random.split(jax.random.key(3), len(starts)), starts)


WAYS = {
    "`noise.ensemble`": ours,
    "`vmap` of a scan, Heun": plain,
    "diffrax, Heun, virtual Brownian tree": by_diffrax,
}


def speeds(paths: int, steps: int, repeats: int) -> list[measure.Record]:
    """Processor time of a step of a path."""
    starts, rows = heated(paths), []

    def case(way: Any) -> measure.Record:
        return measure.timed(lambda: np.asarray(way(starts, steps * STEP, STEP)))[1]

    cases: dict[Any, Any] = {name: partial(case, way) for name, way in WAYS.items()}
    measure.interleaved(cases, 1)  # everybody is measured warm
    runs = measure.interleaved(cases, repeats)
    least = {name: min(run["processor_seconds"] for run in found) for name, found in runs.items()}
    for name, seconds in least.items():
        row = {"way": name, "paths": paths, "steps": steps, "ns": 1e9 * seconds / paths / steps}
        rows.append(row | {"ratio": seconds / least["`noise.ensemble`"]})
    return rows


def biases(paths: int, time: float) -> list[measure.Record]:
    """The error of ⟨E⟩ and of ⟨L²⟩ after a time that begins in equilibrium."""
    rows, starts = [], heated(paths, 5)
    names = "`noise.ensemble`", "`vmap` of a scan, Heun", "`noise.averaged_ensemble`"
    for name, way in zip(names, (ours, plain, averaged), strict=True):
        for step in (0.4, 0.2, 0.1):
            omega = np.asarray(way(starts, time, step))
            energy = np.sum(MOMENTS * omega**2, axis=1) / 2
            square = np.sum((MOMENTS * omega) ** 2, axis=1)
            row: measure.Record = {"way": name, "step": step, "paths": paths}
            for quantity, values, exact in (("E", energy, 1.5), ("L2", square, 4.2)):
                row[quantity] = float(np.mean(values) / exact - 1)
                row[f"{quantity} noise"] = float(np.std(values) / exact / np.sqrt(paths))
            rows.append(row)
    return rows


def relaxation(paths: int) -> measure.Record:
    """A real particle: paths of a body with τ₀Ω = 1e-20 for three relaxation times."""
    scale = 1e-20
    body = dt.Body(np.diag(MOMENTS), DIRECTION)
    bath, starts = dt.noise.Bath(scale**2), scale * heated(paths)
    given = body, bath, starts, [0.0, 3 / scale**2]
    dt.noise.averaged_ensemble(*given, n=paths)
    return measure.timed(dt.noise.averaged_ensemble, *given, n=paths)[1] | {"paths": paths}


def measured(small: bool) -> measure.Record:
    """All cases, on one core."""
    with measure.confined(1):
        return {
            "speeds": speeds(*((512, 64, 1) if small else (1024, 2000, 3))),
            "biases": biases(*((512, 4.0) if small else (1 << 16, 20.0))),
            "relaxation": relaxation(512 if small else 100_000),
        }


if __name__ == "__main__":
    pages.command("noise", measured)
