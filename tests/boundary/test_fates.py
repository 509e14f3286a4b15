"""The numbers of the fates, from outcome, sense of rotation and kind of stop."""

import numpy as np

from dipoletop import Basin, Fate, Stop, boundary
from dipoletop._base.types import PREDICTED_FATES


def test_every_outcome_and_kind_of_stop_has_a_member():
    for kind in Stop:
        assert (kind.name if kind else "STOP") in Fate.__members__
    assert [fate.name for fate in PREDICTED_FATES] == [fate.name for fate in map(Fate, range(8))]


def test_fates_tell_sense_of_rotation_and_kind_of_stop():
    outcome = np.array([-1, 0, 1, 1, 1, 2, 2, 2, 2])
    value = np.array([np.nan, np.nan, 0.1, -0.1, np.nan, 0.0, 0.0, 0.0, 0.0])
    stop = np.array([0, 0, 0, 0, 0, 1, 2, 4, 0])
    seen = {"outcome": outcome, "omega_inf": value, "stop": stop}
    basin = Basin(("point",), (9,), {}, seen, {})
    names = ["FAILED", "UNDECIDED", "POSITIVE", "NEGATIVE", "RESIDUAL"]
    names += ["AXIS", "ROTATING", "TUMBLING", "STOP"]
    assert [Fate(number).name for number in boundary.fate(basin)] == names
