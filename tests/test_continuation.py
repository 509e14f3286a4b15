"""Continuation: fractions of physics.md, closed forms of eigenvalues, known thresholds."""

import numpy as np
import pytest

from dipoletop import planar
from dipoletop._base.types import Outcome, Stop
from dipoletop.continuation import (
    Threshold,
    _continuous,
    continuation,
    follow_spectrum,
    thresholds,
)
from dipoletop.equations.levels import Level
from dipoletop.paper import figure_data

N = 8000
DELTAS = [-0.9, -0.5, -0.4, -0.3, -0.2, -0.1, -0.05, 0.3, 0.75, 0.76]
SEMI = {-0.9: 0.0675, -0.5: 0.2096, -0.3: 0.4154, -0.2: 0.5894, -0.1: 0.7973}  # of 20 000 starts
ORDER_1 = {-0.4: 0.1402, -0.2: 0.5197, -0.1: 0.7755, -0.05: 0.8972}  # of 200 000 starts
DIFFER = {-0.9: 0.0675, -0.3: 0.1139, -0.2: 0.0629, -0.1: 0.0295}


@pytest.fixture(scope="module")
def found():
    return continuation(DELTAS, n=N)


def assert_shares(values, share, known, size):
    """Within four standard errors of the difference between two samples."""
    p = np.array(list(known.values()))
    at = [list(values).index(value) for value in known]
    error = np.sqrt(p * (1 - p) * (1 / N + 1 / size))
    np.testing.assert_array_less(np.abs(share[at] - p), 4 * error)


def test_residual_fractions_are_the_known_ones(found):
    share = found.fractions(Outcome.RESIDUAL).share
    assert_shares(DELTAS, share[0], ORDER_1, 200_000)
    assert_shares(DELTAS, share[1], SEMI, 20_000)
    assert np.all(share[0, :2] == 0)
    assert np.all(share[0, 7:] == 1)


def test_levels_share_their_starts(found):
    """By starts of their own, half of the outcomes would differ at δ = −0.2."""
    first, second = (basin.outcome[:, 0] for basin in found.basins)
    assert_shares(DELTAS, np.mean(first != second, axis=1), DIFFER, 20_000)


def test_all_ends_add_up_and_stops_are_of_the_known_kinds(found):
    total = sum(found.fractions(end).share for end in Outcome)
    np.testing.assert_allclose(total, 1, rtol=1e-15)
    stops = found.fractions(Outcome.STOP).share
    rotating = found.fractions(Outcome.STOP, Stop.ROTATING).share
    wobbling = found.fractions(Outcome.STOP, Stop.WOBBLING).share
    np.testing.assert_array_equal(rotating[1, :7], stops[1, :7])
    np.testing.assert_array_equal(wobbling[1, 7:], stops[1, 7:])
    assert stops[1, 8] == 0
    assert wobbling[1, 9] > 0.1  # the basin of the cycle is born with a finite size


def test_intervals_are_those_of_wilson(found):
    p, low, high = found.fractions(Outcome.RESIDUAL)
    z = 1.959963984540054
    for end in (low, high):  # the roots of (p̂ − p)² = z²p(1 − p)/n
        np.testing.assert_allclose((p - end) ** 2, z**2 * end * (1 - end) / N, atol=1e-12)
    assert np.all(low <= p)
    assert np.all(p <= high)
    assert np.all(low < high)


def test_amplitudes_have_the_known_fractions_and_the_same_directions(found):
    """physics.md: δ = −0.2 at |ω| = 0.01, 0.2 and 1."""
    amplitudes = [0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0]  # as many as DELTAS
    again = continuation(-0.2, amplitudes, levels="semi", n=N)
    known = {0.01: 0.0437, 0.2: 0.5894, 1.0: 0.8937}
    assert_shares(amplitudes, again.fractions(Outcome.RESIDUAL).share[0], known, 20_000)
    at = again.basins[0].outcome[0, 4], found.basins[1].outcome[DELTAS.index(-0.2), 0]
    np.testing.assert_array_equal(*at)
    with pytest.raises(ValueError, match="`continuation` must be a continuation in delta"):
        thresholds(again)


def test_thresholds_lie_in_their_brackets(found, monkeypatch):
    monkeypatch.setattr(planar, "critical_delta", lambda: 0.7532357993909)
    rows = {(row.level, row.event): row for row in thresholds(found)}
    line = rows.pop(("order-1", "line changes stability"))
    assert line.delta == pytest.approx(-0.5, abs=1e-12)
    assert line.bracket == (-0.5, -0.4)
    assert line.hidden == pytest.approx(3.841458820694124 / (N + 3.841458820694124), rel=1e-12)
    wobbling = rows.pop(("semi", "wobbling stops begin"))
    assert wobbling.delta == 0.7532357993909
    assert wobbling.bracket == (0.75, 0.76)
    assert {key: (row.delta, row.bracket) for key, row in rows.items()} == {
        (level, "stops end"): (0.0, (-0.05, 0.3)) for level in found.levels
    }


def test_branches_are_the_closed_forms():
    d, w = np.array(DELTAS), 1e-5
    found = follow_spectrum(d, w)
    expected = np.stack([-(1 + 2 * d) / (1 - d), -np.ones(len(d))])  # (4.22)–(4.24)
    np.testing.assert_allclose(found.slow[0] / w**2, expected, rtol=1e-9, atol=1e-12)
    limit = figure_data.small_w(d)
    sizes = np.abs(found.slow[1].T[:, :, None] / w**2 - limit[:, None, :])
    np.testing.assert_allclose(np.min(sizes, axis=1), 0, atol=1e-6)  # each of one side
    np.testing.assert_allclose(np.min(sizes, axis=2), 0, atol=1e-6)  # is on the other
    np.testing.assert_array_equal(found.growth, np.max(np.real(found.slow), axis=1))
    np.testing.assert_array_equal(found.stable, [d > -0.5, d > -1])


def test_branches_go_straight_through_a_crossing_and_turn_at_a_repulsion():
    x = np.sort(np.random.default_rng(1).uniform(-1, 1, 200))
    crossing = np.stack([x + 0j, 0.3 - x + 0.5 * x**2], axis=1)
    repelled = np.stack([np.sqrt(x**2 + 0.01) + 0j, -np.sqrt(x**2 + 0.01)], axis=1)
    for pairs in (crossing, repelled):
        falling = -np.sort(-pairs, axis=1)  # as `spectrum` gives them
        first, second = _continuous(x, falling)
        expected = pairs if first[0] == pairs[0, 0] else pairs[:, ::-1]
        np.testing.assert_array_equal(np.stack([first, second], axis=1), expected)


def test_results_are_shown_with_their_numbers(found):
    share = found.fractions(Outcome.RESIDUAL).share[1]
    lines = repr(found).splitlines()
    assert lines[0].startswith(
        f"Continuation(delta from -0.9 to 0.76, 10 values, {N} starts at each"
    )
    assert lines[2] == f"  semi: from {share[0]:.4g} to {share[-1]:.4g}, at most {max(share):.4g})"
    branches = follow_spectrum(DELTAS, 0.1, levels="order-1")
    assert repr(branches) == (
        "Branches(delta from -0.9 to 0.76, 10 values, w = 0.1; largest Re λ/w²:\n"
        "  order-1: from -1 to 0.4211, stable at 8)"
    )
    row = Threshold(Level.SEMI, "stops end", Outcome.STOP, 0.0, (-0.05, 0.3), 0.0005)
    assert "semi: stops end at delta = 0; STOP in the sample changes between -0.05" in repr(row)
