"""How 2 718 starts end, by every entry: labels as they were recorded, and numbers to 1e-12.

The recorded ends are those of this library, so they prove nothing about physics. They show that a
change of its structure changes no result. `python tests/whole/test_golden_ends.py` records them
again, which needs a reason.
"""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt

pytestmark = pytest.mark.slow

RECORD = Path(__file__).with_name("golden_ends.npz")
AMPLITUDES = (1e-25, 1e-12, 1e-6, 1e-3, 0.05, 0.3)
STARTS = 8  # of each body and amplitude
PART_OF_ERROR = 1e-3  # another processor may round otherwise, by far less than the stated error
EXACT = {"outcome", "stop", "certified", "regime", "steps", "ending"}
BODIES = {
    "dipole on 1": ((0.7, 0.9, 1.1), (1, 0, 0)),
    "dipole on 2": ((0.7, 0.9, 1.1), (0, 1, 0)),
    "dipole on 3": ((0.7, 0.9, 1.1), (0, 0, 1)),
    "stops": ((0.5, 0.55, 1.0), (1, 0, 0)),
    "oblique": ((0.7, 0.9, 1.1), (0.5, 0.3, -0.7)),
    "needle": ((0.6, 1.0, 1.0), (0, 1, 0)),
    "nearly a needle": ((0.6, 0.9999, 1.0), (0, 0, 1)),
    "disc": ((0.6, 0.6, 1.0), (1, 0, 0)),
    "sphere": ((1.0, 1.0, 1.0), (0, 0.6, 0.8)),
}
TOPS = {
    "order 1": dt.TransverseReduced,
    "semi": dt.TransverseSemi,
    "full": dt.TransverseFull,
    "longitudinal": dt.LongitudinalSemi,
}
RIGID = {
    "order 1": dt.Reduced,
    "order 2": lambda body: dt.Reduced(body, order=2),
    "semi": dt.SemiReduced,
}
SHAPES = (-0.7, -0.3, -0.05, 1e-4, 0.2, 0.8)
FIELDS = [
    "outcome",
    "omega_inf",
    "omega_inf_error",
    "time",
    "steps",
    "certified",
    "stop",
    "regime",
    "probability",
]
OF_PREDICTIONS = [
    "outcome",
    "probability",
    "omega_inf",
    "ratio",
    "half_time",
    "lifetime",
    "radiated_energy",
    "error",
]


def starts():
    """The starts of each body: STARTS directions at every amplitude."""
    ways = np.random.default_rng(43).normal(size=(STARTS, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.concatenate([size * ways for size in AMPLITUDES])


def of_tops(level):
    """The ends of tops of all shapes, by `classify_many`."""
    omegas = np.tile(starts(), (len(SHAPES), 1))
    deltas = np.repeat(SHAPES, len(starts()))
    most = 60 if level == "full" else 2000
    runs = dt.classify_many(TOPS[level](jnp.asarray(deltas)), omegas, max_steps=most)
    return {name: np.asarray(getattr(runs, name)) for name in FIELDS}


def of_bodies(level):
    """The ends of all bodies, by `sweep`."""
    inertia, dipole = (np.array([body[k] for body in BODIES.values()], float) for k in range(2))
    many = len(starts())
    j, n = (np.repeat(x, many, axis=0) for x in (inertia, dipole))
    names = [f"{letter}{k}" for letter in "jnw" for k in range(3)]
    columns = np.concatenate([j, n, np.tile(starts(), (len(BODIES), 1))], axis=1).T

    def problem(j0, j1, j2, n0, n1, n2, w0, w1, w2):
        body = dt.Body(jnp.diag(jnp.stack([j0, j1, j2])), jnp.stack([n0, n1, n2]))
        return RIGID[level](body), jnp.stack([w0, w1, w2])

    points = dt.Points(**dict(zip(names, columns, strict=True)))
    basin = dt.sweep(problem, points, max_steps=2000, progress=False)
    return {name: basin.column(name) for name in FIELDS}


def of_predictions(which):
    """The predicted ends of slow starts, by `predict` one after another or under `vmap`."""
    slow = starts()[: 3 * STARTS]  # of 1e-25 to 1e-6
    rows = [(np.diag(j), np.array(n, float), omega) for j, n in BODIES.values() for omega in slow]

    def predict(inertia, dipole, omega):
        return dt.predict(dt.Body(inertia, dipole), omega)

    if which == "single":
        found = jax.tree.map(lambda *leaves: np.stack(leaves), *(predict(*x) for x in rows[::4]))
    else:
        found = jax.jit(jax.vmap(predict))(
            *(jnp.asarray(np.stack(x)) for x in zip(*rows, strict=True))
        )
    return {name: np.asarray(getattr(found, name)) for name in OF_PREDICTIONS}


def of_atlas(which):
    """The endings of small atlases."""
    body = dt.Body(np.diag([0.7, 0.9, 1.1]), [0, 0, 1.0])
    found = dt.atlas(body=body, n=4) if which == "dipoles" else dt.atlas(int(which), n=4)
    names = "ending", "probability", "ratio", "error"
    return {name: np.asarray(getattr(found, name)) for name in names}


CASES = {f"top, {level}": (of_tops, level) for level in TOPS}
CASES |= {f"body, {level}": (of_bodies, level) for level in RIGID}
CASES |= {f"predictions, {which}": (of_predictions, which) for which in ("single", "batch")}
CASES |= {f"atlas, {which}": (of_atlas, which) for which in ("1", "2", "3", "dipoles")}


@pytest.mark.parametrize("case", CASES)
def test_ends_are_as_they_were_recorded(case):
    """Every end is the recorded one, except for rounding."""
    function, argument = CASES[case]
    found = function(argument)
    with np.load(RECORD) as record:
        recorded = {name: record[f"{case}: {name}"] for name in found}
    for name, values in found.items():
        known = recorded[name]
        if name in EXACT:
            assert np.array_equal(values, known), name
            continue
        room = 1e-12 * np.abs(known)
        if name == "omega_inf" and "omega_inf_error" in found:
            room += PART_OF_ERROR * np.nan_to_num(found["omega_inf_error"], posinf=0)
        elif name == "probability":
            room += 1e-8  # from an adaptive integration
        elif name == "ratio":  # from the same one, where chance decides
            room *= np.where(np.max(found["probability"], axis=-1) < 1, 1e4, 1.0)
        elif name.endswith("error"):  # which estimates rounding, too
            size = np.abs(found["omega_inf"]) if name == "omega_inf_error" else 1.0
            room = PART_OF_ERROR * np.abs(known) + 1e-12 * size
        same = (values == known) | (np.isnan(values) & np.isnan(known))
        with np.errstate(invalid="ignore"):
            assert np.all(same | (np.abs(values - known) <= room)), name


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    every = {}
    for case, (function, argument) in CASES.items():
        begin = time.process_time()
        every |= {f"{case}: {name}": x for name, x in function(argument).items()}
        print(case, f"{time.process_time() - begin:.1f} s")
    np.savez_compressed(RECORD, **every)
    print(sum(x.shape[0] for name, x in every.items() if name.endswith(": outcome")), "starts")
