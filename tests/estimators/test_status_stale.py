"""`valid` in silence: it may last for the hold time of the signals, and must not begin."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.status import none_begins

V, C = Status.VALID, Status.CONVERGING


@pytest.mark.parametrize("was_valid", [False, True])
def test_no_stale_sample_is_the_first_valid_one(was_valid):
    status = np.array([V, V, C, C, V, V, C, V], np.uint8)
    stale = np.array([1, 0, 0, 1, 1, 0, 1, 1], bool)
    got, last = none_begins(status, stale, was_valid)
    assert got.tolist() == [V if was_valid else C, V, C, C, C, V, C, V]
    assert last
    cut = [none_begins(status[:4], stale[:4], was_valid)]
    cut.append(none_begins(status[4:], stale[4:], cut[0][1]))
    assert np.concatenate([part for part, _ in cut]).tolist() == got.tolist()
