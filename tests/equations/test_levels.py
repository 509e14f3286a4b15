"""Levels by name, and the equations that they name."""

import dipoletop as dt
from dipoletop.equations.levels import level_of


def test_every_level_names_its_equation():
    labels = {level: dt.equation_at(level.value, -0.2).level for level in dt.Level}
    assert labels == {level: level.label for level in dt.Level}
    assert len(set(labels.values())) == 6
    orders = [dt.equation_at(dt.Level.of_order(m), -0.2).order for m in (1, 2, 3, 4)]
    assert orders == [1, 2, 3, 4] == [level.order for level in dt.Level][:4]


def test_only_order_1_has_a_caveat():
    assert [level for level in dt.Level if level.caveat] == [dt.Level.ORDER_1]
    assert [level for level in dt.Level if not level.consistent] == [dt.Level.ORDER_1]


def test_an_equation_without_a_level_is_labelled_by_its_class():
    class Unnamed:
        pass

    assert level_of(Unnamed()) == "Unnamed"
    assert level_of(dt.RotatorReduced()) == "reduced, order 1 (the paper's)"
