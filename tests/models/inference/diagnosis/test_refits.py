"""Refits of the model without effects from the maps of one with."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.inference.diagnosis.refits import Refits, better_base
from slipmap.models.physics.rollout import RolloutError


@pytest.mark.parametrize(
    "failure", [np.linalg.LinAlgError("not positive definite"), RolloutError("diverges")]
)
def test_maps_from_which_no_fit_gets_away_are_no_better(failure):
    """Without the effect, maps that were bent around it may predict so badly that no step can be computed."""

    def base(error, start):
        raise failure

    plain = SimpleNamespace(cost=100.0, likelihood=SimpleNamespace(error=None))
    refits = Refits(plain, {"table_tilt": SimpleNamespace(cost=10.0)}, {"table_tilt": 90.0})
    assert better_base(SimpleNamespace(base=base), refits) is None
