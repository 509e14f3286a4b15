"""heyoka in batch mode up to ω∞: labels and residual rotations, without estimates of their errors.

As in `with_heyoka`: rounds of a few steps, after each one test of all starts by the regions of
dipoletop, and the undecided starts are packed together. After each round the units are renewed,
y = ω/|ω| and s = |ω|τ, since heyoka's tolerance is absolute below 1 and ω∞ may be far below |ω₀|.
"""

from typing import Any

import equinox as eqx
import heyoka
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers.with_heyoka import FOREVER, batch_integrator, in_batches, rounds

Vectors = Float[np.ndarray, "3 n"]


def _top(y: list[Any], size: Any, par: list[Any]) -> list[Any]:
    """Return dy/ds of a transverse top, semi-reduced; the parameter is δ."""
    (w1, w2, w3), (d,) = y, par
    a, b, c = w1 * w1, w2 * w2, w3 * w3
    r2 = -d * w1 * w3 - size * (a + b + c + d * (1 + d) * c) * w2
    r3 = -size * (a + b + c - d * b) * w3
    det = 1 - d + 4 * size * size * a
    return [
        d * w2 * w3,
        ((1 - d) * r2 - 2 * size * w1 * r3) / det,
        (r3 + 2 * size * w1 * r2) / det,
    ]


def _body(y: list[Any], size: Any, par: list[Any]) -> list[Any]:
    """Return dy/ds of a body with moments J and dipole e₁, semi-reduced; 1/J₂₃ are parameters.

    {J − [d]×(ω dᵀ + 2(d·ω))} ω̇ = −N + d×(d×(ω²ω − ω̈)), with ω̈ of free rotation.
    """
    (w1, w2, w3), (p, q, j2, j3) = y, par  # p = (J₂ − J₃)/J₁, q = (J₃ − J₁)/J₂
    r = (1 - j2) / j3  # (J₁ − J₂)/J₃, J₁ = 1
    f1, f2, f3 = p * w2 * w3, q * w3 * w1, r * w1 * w2
    g2, g3 = q * (f3 * w1 + w3 * f1), r * (f1 * w2 + w1 * f2)
    square = w1 * w1 + w2 * w2 + w3 * w3
    # d×(d×v) = −(0, v₂, v₃); [d]×ω = (0, −ω₃, ω₂), [d]×ω̇ = (0, −ω̇₃, ω̇₂).
    b2 = j2 * f2 - size * (square * w2 - g2) - size * w3 * f1
    b3 = j3 * f3 - size * (square * w3 - g3) + size * w2 * f1
    # J₂ω̇₂ + 2εω₁ω̇₃ = b₂ and J₃ω̇₃ − 2εω₁ω̇₂ = b₃.
    k = 2 * size * w1
    det = j2 * j3 + k * k
    return [f1, (j3 * b2 - k * b3) / det, (j2 * b3 + k * b2) / det]


class Ends:
    """An integrator of one kind of body, compiled once.

    Args:
        equation: one equation, `TransverseSemi`; or `SemiReduced` with moments 1, J₂, J₃ and a
            unit dipole on axis 1; with a leading axis of N on its arrays.
        rtol: the tolerance.
    """

    def __init__(self, equation: Any, rtol: float) -> None:
        self.equation, self.rtol = equation, rtol
        if isinstance(equation, dt.TransverseSemi):
            field, self.parameters = _top, np.asarray(equation.delta)[None]
        else:
            field = _body
            j2, j3 = (np.asarray(equation.body.inertia)[:, k, k] for k in (1, 2))
            self.parameters = np.stack([j2 - j3, (j3 - 1) / j2, j2, j3])
        size, *par = (heyoka.par[k] for k in range(1 + len(self.parameters)))
        variables = heyoka.make_vars("y1", "y2", "y3")
        system = list(zip(variables, field(list(variables), size, par), strict=True))
        self.integrator = batch_integrator(system, rtol, len(par) + 1)

    def find(self, omegas: Float[np.ndarray, "n 3"], max_steps: int) -> tuple[Any, Any]:
        """Return the labels, and ω∞ along the dipole."""
        states, live = omegas.T.copy(), np.arange(len(omegas))
        labels, values = np.zeros(len(omegas), int), np.full(len(omegas), np.nan)
        for steps in [*rounds(max_steps), 0]:
            done, outcome, omega_inf = self._judged(live, states)
            labels[live[done]], values[live[done]] = outcome[done], omega_inf[done]
            live, states = live[~done], states[:, ~done]
            if live.size == 0 or steps == 0:
                break
            states = self._advanced(live, states, steps)
        return labels, values

    def _judged(self, live: np.ndarray, states: Vectors) -> tuple[Any, Any, Any]:
        size = max(128, 1 << (live.size - 1).bit_length())
        padded = np.resize(live, size) if live.size else np.zeros(size, int)
        lanes = jax.tree.map(
            lambda x: np.moveaxis(np.asarray(x)[padded], 0, -1),
            eqx.filter(self.equation, eqx.is_array),
        )
        given = np.ones((3, size))
        given[:, : live.size] = states
        found = _judge(eqx.combine(lanes, self.equation), given, jnp.asarray(self.rtol))
        return tuple(np.asarray(x)[: live.size] for x in found)

    def _advanced(self, live: np.ndarray, states: Vectors, steps: int) -> Vectors:
        sizes = np.max(np.abs(states), axis=0)  # |ω|² may underflow
        given = np.concatenate([sizes[None], self.parameters[:, live]])

        def advance() -> None:
            self.integrator.set_time(0.0)
            self.integrator.propagate_for(FOREVER, max_steps=steps)

        return sizes * in_batches(self.integrator, states / sizes, given, advance)


@eqx.filter_jit
def _judge(equation: Any, y: Any, rtol: Any) -> tuple[Any, Any, Any]:
    """Return whether outcome and ω∞ are known to the tolerance, and both."""
    return engines.known_end(equation, y, rtol)
