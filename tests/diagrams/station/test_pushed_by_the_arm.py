"""The arm pushes light and low objects, and they slide as the cell-grid model says."""

from __future__ import annotations

import numpy as np
import pytest
from arm_pushes import ArmCell


@pytest.mark.parametrize(
    ("name", "angle", "begin", "end"),
    [
        ("wrench", 2.690, [0.1536, -0.0379], [0.1236, 0.0183]),
        ("spray_gun", -0.294, [-0.1826, 0.0492], [-0.1226, 0.0094]),
    ],
)
def test_it_neither_rocks_nor_ends_elsewhere_than_the_model(name, angle, begin, end):
    """On walls as hard as blocks both rocked for a third of these pushes and ended 21 and 38 mm off."""
    outcome = ArmCell(name).push(np.array(begin), np.array(end), angle)
    assert outcome is not None and outcome.moved > 0.01
    assert outcome.rocking < 0.02
    assert 1e3 * outcome.off < 2.0
    assert np.degrees(outcome.turned_off) < 0.5
