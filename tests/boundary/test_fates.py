"""The numbers of the fates, from outcome, sense of rotation and kind of stop."""

import numpy as np

from dipoletop import Basin, Outcome, Stop, boundary
from dipoletop.boundary import Fate


def test_every_outcome_and_kind_of_stop_has_a_member():
    for kind in Stop:
        assert Fate[f"STOP_{kind.name}" if kind else "STOP"] == 3 + kind
    assert Fate.FAILED == Outcome.FAILED
    assert Fate.UNDECIDED == Outcome.UNDECIDED
    assert (Fate.POSITIVE, Fate.NEGATIVE) == (1, 2)


def test_fates_tell_sense_of_rotation_and_kind_of_stop():
    outcome = np.array([-1, 0, 1, 1, 1, 2, 2, 2])
    value = np.array([np.nan, np.nan, 0.1, -0.1, np.nan, 0.0, 0.0, 0.0])
    stop = np.array([0, 0, 0, 0, 0, 1, 2, 4])
    seen = {"outcome": outcome, "omega_inf": value, "stop": stop}
    basin = Basin(("point",), (8,), {}, seen, {})
    np.testing.assert_array_equal(boundary.fate(basin), [-1, 0, 1, 2, 0, 4, 5, 7])
