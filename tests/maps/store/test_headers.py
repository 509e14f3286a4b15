"""How two sweeps differ: the refusal of a store names it, with both values."""

import pickle

import numpy as np
import pytest
from store_helpers import GRID, header_of, reduced, rewrite

import dipoletop as dt
from stored_files import files


def thinner(w3, phi):
    return reduced(w3, phi, -0.3)


def semi(w3, phi):
    return dt.TransverseSemi(-0.2), reduced(w3, phi)[1]


def grid(**axes):
    return dt.Grid(**(GRID.axes | axes))


@pytest.mark.parametrize(
    ("problem", "over", "settings", "said"),
    [
        (reduced, GRID, {"rtol": 1e-9}, "rtol is 1e-08 there and 1e-09 here"),
        (reduced, GRID, {"confirm": 1e-9}, "confirm is None there and 1e-09 here"),
        (reduced, GRID, {"slow_flow": False}, "slow_flow is auto there and False here"),
        (
            reduced,
            grid(w3=np.linspace(0.0, 0.46, 12)),
            {"atol": 1e-9},
            r"atol is 0.0 there and 1e-09 here, w3\[1\] is 0.0409.* there and "
            r"0.0418.* here \(11 of 12 differ\)",
        ),
        (reduced, grid(phi=[0.1]), {}, r"shape is \[12, 18\] there and \[12, 1\] here"),
        (thinner, GRID, {}, "the program of `problem` is .{8} there and .{8} here"),
        (
            semi,
            GRID,
            {},
            r"level is reduced, order 1 \(the paper's\) there and semi-reduced here.*`verdict`",
        ),
    ],
)
def test_a_refusal_names_what_differs_with_both_values(good, problem, over, settings, said):
    before = files(good)
    with pytest.raises(dt.StoreMismatch, match=f"`store` must .* hold this very sweep, .*{said}"):
        dt.sweep(problem, over, store=good, **settings)
    assert files(good) == before


def test_a_mismatch_tells_its_path_and_reason_and_can_be_pickled(good):
    with pytest.raises(dt.StoreMismatch) as caught:
        dt.sweep(reduced, GRID, store=good, rtol=1e-9)
    for error in (caught.value, pickle.loads(pickle.dumps(caught.value))):
        assert (error.argument, error.path) == ("store", good)
        assert error.reason == f"{good} holds another sweep: rtol is 1e-08 there and 1e-09 here"
        must = "be new or hold this very sweep"
        assert str(error) == f"Argument `store` must {must}, but {error.reason}."


def test_one_edited_point_of_many_is_seen(tmp_path):
    """Between the points that a glance would look at; its value is named."""
    w3 = np.linspace(0.0, 0.4, 300)
    dt.sweep(reduced, dt.Points(w3=w3, phi=w3), store=tmp_path / "a.zarr")
    w3 = w3.copy()
    w3[101] = 0.25
    message = r"w3\[101\] is 0.135.* there and 0.25 here \(1 of 300 differ\), phi\[101\]"
    with pytest.raises(dt.StoreMismatch, match=message):
        dt.sweep(reduced, dt.Points(w3=w3, phi=w3), store=tmp_path / "a.zarr")


@pytest.mark.slow
def test_seed_and_draw_of_a_sample_are_seen(tmp_path):
    def problem(omega0):
        return dt.TransverseReduced(-0.2), omega0

    def sweep(**of):
        dt.sweep(problem, dt.Sample(n=5, **of), store=tmp_path / "s.zarr")

    sweep(amplitude=0.2, seed=1)
    sweep(amplitude=0.2, seed=1)
    with pytest.raises(dt.StoreMismatch, match=r"another sweep: seed is 1 there and 2 here"):
        sweep(amplitude=0.2, seed=2)
    with pytest.raises(dt.StoreMismatch, match=r"amplitude is 0.2 there and 0.3 here"):
        sweep(amplitude=0.3, seed=1)
    with pytest.raises(dt.StoreMismatch, match="the program of `draw` is"):
        sweep(seed=1, draw=dt.uniform_box([0, 0, 0], [1, 1, 1]))


def test_another_jax_may_be_why_a_program_differs(copy):
    """The store says that an older JAX made it."""
    rewrite(copy, attrs=header_of(copy)["attrs"] | {"version_jax": "0.0.1"})
    message = r"\(JAX 0.0.1 traced it there and JAX .* here, which alone may make a difference\)"
    with pytest.raises(dt.StoreMismatch, match=message):
        dt.sweep(thinner, GRID, store=copy)
    dt.sweep(reduced, GRID, store=copy)  # which differs by nothing else
