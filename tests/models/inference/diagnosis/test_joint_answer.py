"""The verdict on several datasets, from models that the locked pushes have judged."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.effects.library import SensorLatency, TableTilt
from slipmap.models.inference.diagnosis.joint_answer import joint_answer, objection_to
from slipmap.models.inference.diagnosis.locked import JudgedFit, LockedErrors


def missed(misfit):
    """Errors of two locked pushes."""
    path, final = np.array([1e-3, 2e-3]), np.array([4e-3, 6e-3])
    return LockedErrors(path, final, np.array([misfit, misfit]), np.zeros(2))


TILT = (TableTilt(),)


def judged(*falls, effects=TILT, score=10.0, misfit=1.0, shared=True):
    """A model with which the cost of each dataset's locked pushes drops by so much."""
    return JudgedFit(
        SimpleNamespace(effects=effects), [missed(misfit) for _ in falls], list(falls), [], score,
        tuple("ABCDEFGHI"[: len(falls)]), shared,
    )  # fmt: skip


def answer(*kept, among=(), before=(1.0, 1.0), beside=()):
    errors = [None if misfit is None else missed(misfit) for misfit in before]
    return joint_answer(kept, [*kept, *among], errors, beside)


def test_where_no_pushes_were_locked_away_nothing_is_adequate():
    said = answer(before=(None, None))
    assert said.verdict == "undecided" and said.effects == ()
    assert said.sentence.endswith("give each dataset three pushes or more.")
    assert answer(before=(1.0, None)).verdict == "adequate"
    assert answer(before=(5.0, None)).verdict == "undecided"


def test_a_dataset_that_an_effect_does_not_change_has_no_vote():
    assert judged(9.0, 8.8e-6, -0.4).is_supported
    assert not judged(9.0, 8.8e-6, -0.6).is_supported
    assert judged(9.0, 0.6, -0.6).is_supported
    # Many small drops are no vote for it, though they add up.
    assert not judged(*[0.4] * 9).is_supported


def test_what_would_explain_most_has_the_most_evidence():
    """The locked pushes prefer the second; the table shows the first first."""
    lag = judged(9.0, -9.0, effects=(SensorLatency(),), score=30.0)
    said = answer(among=[judged(-9.0, -9.0, score=20.0), lag])
    assert said.verdict == "undecided"
    objection = "the locked pushes are not clearly predicted better with it"
    assert said.sentence == f"table_tilt would explain most, but {objection}. No effect is named."


def test_datasets_that_do_not_have_what_most_have_are_told_in_the_verdict():
    said = answer(judged(9.0, 9.0, -3.5, 0.1)).sentence
    assert said == (
        "The model lacks one effect in these datasets: table_tilt. But the locked pushes of C are predicted"
        " worse with it, so C does not seem to have it."
    )
    both = answer(judged(9.0, 9.0, 9.0, -1.0, -2.0, effects=(*TILT, SensorLatency()))).sentence
    assert both.endswith(
        "the locked pushes of D, E are predicted worse with them, so they do not seem to have them."
    )
    assert answer(judged(9.0, 1.0, 0.1)).sentence.endswith("in these datasets: table_tilt.")


def test_what_may_be_missing_besides_is_told_where_pushes_stay_far_off():
    near, far = (judged(9.0, 9.0, misfit=misfit) for misfit in (2.0, 10.0))
    lacks = "The model lacks one effect in these datasets: table_tilt."
    assert answer(near, beside=["skate", "tether"]).sentence == lacks
    even = f"{lacks} Even with table_tilt, the typical locked push is 10 times the sensor noise off:"
    assert answer(far, beside=["skate", "tether"]).sentence == (
        f"{even} something else is missing too, skate or tether, which gain alike beside it."
    )
    either = answer(far, judged(9.0, effects=(SensorLatency(),)))
    assert either.verdict == "ambiguous" and either.effects == ("table_tilt", "sensor_latency")
    assert "Even with table_tilt, the typical locked push is 10 times" in either.sentence
    assert answer(far).sentence.startswith(
        f"{even} something else is missing too, the outline or the recording"
    )


@pytest.mark.parametrize(
    ("falls", "supported", "objection"),
    [
        ((9.0, -1.0), True, ""),
        ((9.0, -1.0, -2.0), True, ""),
        ((9.0, -3.5, 20.0), False, "the locked pushes of B are predicted worse with it"),
        ((2.0, 2.0, 1.0), False, "of no single dataset are clearly predicted better"),
        ((2.0, 0.5), False, "are not clearly predicted better with it"),
    ],
)
def test_what_datasets_do_not_share_may_be_in_one_of_them(falls, supported, objection):
    one = judged(*falls, shared=False)
    assert one.is_supported is supported
    if not supported:
        assert objection in objection_to(one)
    # What they share must be in most of them.
    assert judged(*falls).is_supported is (sum(f > 0.0 for f in falls) > len(falls) / 2 and sum(falls) > 3.0)


def test_in_which_datasets_an_effect_is_that_they_do_not_share_is_told():
    said = answer(judged(9.0, -1.0, 2.0, shared=False)).sentence
    assert said.endswith(": table_tilt. It shows in the locked pushes of A, not in those of B, C.")
    assert answer(judged(9.0, 4.0, shared=False)).sentence.endswith(": table_tilt.")
