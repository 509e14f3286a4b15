"""The checks of `dipoletop validate`: they pass here, and each would notice a fault."""

import math

import jax.numpy as jnp
import pytest

from dipoletop import classify, validation
from dipoletop.equations.rigid import Reduced
from dipoletop.equations.transverse import TransverseFull, TransverseReduced, TransverseSemi
from dipoletop.validation import Check

QUICK = ("float64", "sphere", "closed_forms", "energy_balance")


def test_quick_checks_pass_and_their_names_fit_the_table(monkeypatch):
    """Those that compile little; `.ci/run` runs them all."""
    chosen = [check for check in validation.CHECKS if check.__name__ in QUICK]
    monkeypatch.setattr(validation, "CHECKS", chosen)
    checks = list(validation.run())
    assert [check.name for check in checks if not check.passed] == []
    names = [check.name for check in checks]
    assert len(set(names)) == len(names) >= len(QUICK)
    assert max(len(name) for name in names) <= 46
    assert max(check.tolerance for check in checks) <= 1e-8


def test_a_check_measures_against_its_scale():
    check = Check("", 1e-3, 3e-3, 10.0, 2.1e-4)
    assert check.error == pytest.approx(2e-4)
    assert check.passed
    assert not check._replace(tolerance=1.9e-4).passed
    assert not check._replace(found=math.nan).passed


def test_the_worst_component_is_the_one_reported():
    found = validation._worst("", [1.0, 2.0, 3.0], [1.0, 2.5, 3.1], scale=1.0, tolerance=0.0)
    assert (found.expected, found.found) == (2.0, 2.5)
    broken = validation._worst("", [1.0, 2.0], [5.0, math.nan], scale=1.0, tolerance=9.0)
    assert not broken.passed


def _failed(check):
    return [result.name for result in check() if not result.passed]


def test_a_wrong_shape_is_noticed(monkeypatch):
    def wrong(delta, order=1):
        return TransverseReduced(delta + 1e-6, order)

    monkeypatch.setattr(validation, "TransverseReduced", wrong)
    assert len(_failed(validation.figure_2)) == 7
    assert len(_failed(validation.residual_rotation)) == 1


@pytest.mark.slow
def test_wrong_values_are_noticed(monkeypatch):
    def one_run(equation, start):  # half a turn about axis 3: the same outcome, ω∞ reversed
        return classify(equation, start * jnp.array([-1.0, -1.0, 1.0]))

    monkeypatch.setattr(validation, "classify", one_run)
    assert _failed(validation.engine) == ["maps' engine = diffrax, ω∞ of the same"]


def test_a_wrong_share_is_noticed(monkeypatch):
    monkeypatch.setattr(validation, "TransverseReduced", lambda _: TransverseReduced(-0.23))
    assert len(_failed(validation.residual_share)) == 1


def test_a_wrong_torque_is_noticed(monkeypatch):
    class Wrong(TransverseFull):
        def __call__(self, t, y, args=None):
            return TransverseFull.__call__(self, t, y, args) * (1 + 1e-9)

    monkeypatch.setattr(validation, "TransverseFull", Wrong)
    assert len(_failed(validation.energy_balance)) == 1


def test_a_wrong_closed_form_is_noticed(monkeypatch):
    monkeypatch.setattr(validation, "CLOSED_FORMS", (("swapped", TransverseSemi, Reduced),))
    assert _failed(validation.closed_forms) == ["closed form = general body, swapped"]


def test_a_check_that_breaks_down_is_a_failed_one(monkeypatch):
    def broken():
        raise FileNotFoundError("nothing there\nat all")

    monkeypatch.setattr(validation, "CHECKS", (broken, validation.float64))
    first, second = validation.run()
    assert first.name == "broken: nothing there"
    assert not first.passed
    assert second.passed
