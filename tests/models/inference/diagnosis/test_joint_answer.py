"""The verdict on several datasets, from models that the locked pushes have judged."""

from types import SimpleNamespace

import numpy as np

from slipmap.models.effects.library import SensorLatency, TableTilt
from slipmap.models.inference.diagnosis.joint_answer import joint_answer
from slipmap.models.inference.diagnosis.locked import JudgedFit, LockedErrors


def missed(misfit):
    """Errors of two locked pushes."""
    return LockedErrors(np.array([1e-3, 2e-3]), np.array([4e-3, 6e-3]), np.array([misfit, misfit]))


TILT = (TableTilt(),)


def judged(*falls, effects=TILT, score=10.0, misfit=1.0):
    """A model that changes the cost of each dataset's locked pushes so."""
    return JudgedFit(
        SimpleNamespace(effects=effects), [missed(misfit) for _ in falls], list(falls), [], score
    )


def answer(*kept, among=(), before=(1.0, 1.0)):
    errors = [None if misfit is None else missed(misfit) for misfit in before]
    return joint_answer(kept, [*kept, *among], lambda one: f"{one.name} is objected to", errors)


def test_where_no_pushes_were_locked_away_nothing_is_adequate():
    said = answer(before=(None, None))
    assert said.verdict == "undecided" and said.effects == ()
    assert said.sentence.endswith("give each dataset three pushes or more.")
    assert answer(before=(1.0, None)).verdict == "adequate"
    assert answer(before=(5.0, None)).verdict == "undecided"


def test_a_dataset_that_an_effect_does_not_change_has_no_vote():
    assert judged(9.0, 8.8e-6, -0.4).falls_in_most
    assert not judged(9.0, 8.8e-6, -0.6).falls_in_most
    assert judged(9.0, 0.6, -0.6).falls_in_most
    # Many small drops are no vote for it, though they add up.
    assert not judged(*[0.4] * 9).falls_in_most


def test_what_would_explain_most_has_the_most_evidence():
    """The locked pushes prefer the second; the table shows the first first."""
    lag = judged(9.0, -9.0, effects=(SensorLatency(),), score=30.0)
    said = answer(among=[judged(-9.0, -9.0, score=20.0), lag])
    assert said.verdict == "undecided"
    assert said.sentence == (
        "table_tilt would explain most, but table_tilt is objected to. No effect is named."
    )
