"""Old names work, and their warning points at the line that used them."""

import inspect
import re

import equinox as eqx
import pytest

from dipoletop._base.deprecated import deprecated, renamed_argument, renamed_attributes


@renamed_argument(old="max_steps", new="max_trajectories")
def search(first: int, *, max_trajectories: int = 3) -> int:
    return first + max_trajectories


class Old(eqx.Module):
    value: int = 3

    @deprecated(new="Old.value")
    def number(self):
        return self.value

    @property
    @deprecated(new="Old.value")
    def size(self):
        return self.value


def warned(call, old, new):
    text = f"`{old}` is deprecated and will be removed in the next release: use `{new}`."
    with pytest.warns(DeprecationWarning, match=re.escape(text)) as caught:
        result = call()
    assert [warning.filename for warning in caught] == [__file__]
    return result


def test_a_renamed_argument_keeps_its_meaning():
    assert search(1, max_trajectories=4) == 5
    old, new = "search(max_steps=...)", "search(max_trajectories=...)"
    assert warned(lambda: search(1, max_steps=4), old, new) == 5
    with pytest.raises(TypeError, match="give only `max_trajectories`"):
        search(1, max_steps=4, max_trajectories=4)
    assert list(inspect.signature(search).parameters) == ["first", "max_trajectories"]


def test_a_deprecated_method_and_property_work():
    assert warned(lambda: Old().number(), "Old.number", "Old.value") == 3
    assert warned(lambda: Old().size, "Old.size", "Old.value") == 3


def test_a_renamed_attribute_of_a_module_is_the_new_one():
    get = renamed_attributes(__name__, {"Older": "Old"})
    assert warned(lambda: get("Older"), f"{__name__}.Older", f"{__name__}.Old") is Old
    with pytest.raises(AttributeError, match="has no attribute 'Oldest'"):
        get("Oldest")
