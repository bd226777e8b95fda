"""The closed-form balance margin tells what MultibodyPlant does at the rim."""

from __future__ import annotations

import numpy as np
import pytest
from pushed_object import TestBed

from slipmap.diagrams.station.table import ROUND_TABLE
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.balance import balance_margins

BESIDE = 4e-3
"""m: nearer to balance the plant's soft contacts decide."""


@pytest.mark.parametrize("name", ["hammer", "wrench"])
def test_object_falls_where_the_margin_is_negative(name: str) -> None:
    """Small cells stand on feet close to each other: at the rim their blocks have to carry them."""
    thing = benchmark_object(name)
    center = thing.center_of_mass[None, :2]
    bed = TestBed(thing, time_step=4e-3)
    rng = np.random.default_rng(4)
    for _ in range(4):
        turn, bearing = rng.uniform(-np.pi, np.pi, 2)
        out = np.array([np.cos(bearing), np.sin(bearing)])
        # Moved out along the radius until the margin is what is wanted, by bisection.
        for wanted in (BESIDE, -BESIDE):
            near, far = 0.0, 0.8
            for _ in range(40):
                r = (near + far) / 2
                margin = balance_margins(thing.grid, center, [[*(r * out), turn]], ROUND_TABLE)[0, 0]
                near, far = (r, far) if margin > wanted else (near, r)
            place = near * out
            bed.start(np.array([*place, turn]))
            bed.advance(0.6)
            fell = bed.X_WO.translation()[2] < -0.02
            assert fell == (wanted < 0), f"turn {turn:.3f}, bearing {bearing:.3f}, margin {wanted}"
            if not fell:
                # Nothing throws it off the rim.
                assert np.linalg.norm(bed.pose[:2] - place) < 3e-3
