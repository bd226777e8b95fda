"""Copies in kernels do what slice assignments do."""

import numpy as np
import pytest

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.kernel_tools import copy_into


@compiled()
def copy(target, source):
    copy_into(target, source)


def test_a_copy_is_whole_and_stays_in_its_slice():
    target = np.zeros(5)
    copy(target[1:4], np.array([1.0, 2.0, 3.0]))
    assert target.tolist() == [0.0, 1.0, 2.0, 3.0, 0.0]


def test_a_copy_of_another_length_is_refused():
    with pytest.raises(ValueError, match="lengths differ"):
        copy(np.zeros(3), np.zeros(2))
