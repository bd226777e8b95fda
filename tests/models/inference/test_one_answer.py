"""One dataset, one division of its pushes, one seed: one number for the model without effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import slipmap
from slipmap.models.inference.comparison import compare_with_effects
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.push_errors import Paired, errors


@pytest.fixture(scope="module")
def dataset():
    return slipmap.simulated_hammer(seed=3, fit=4, heldout=3)[0]


@pytest.fixture(scope="module")
def learned(dataset):
    return slipmap.identify(dataset, seed=5)


@pytest.fixture(scope="module")
def fitted(dataset):
    return slipmap.fit(dataset, ["table_tilt"], seed=5)


def test_every_door_says_the_same_without_effects(dataset, learned, fitted):
    ends = learned.errors("heldout")
    paths = np.array([push.errors.mean_add for push in learned.pushes if push.role == "heldout"])
    assert ends.min() > 0
    assert fitted.without_effects.errors("heldout").tolist() == ends.tolist()
    compared = slipmap.compare(dataset, seed=5).totals["heldout"].model
    assert (compared.final_add, compared.mean_add) == (ends.mean(), paths.mean())
    predicted = slipmap.predict(learned.belief, dataset)
    assert [push.final_add for push in predicted if push.role == "heldout"] == ends.tolist()
    before, _ = compare_with_effects(dataset, ["table_tilt"], seed=5)
    assert before.totals["heldout"].model.final_add == ends.mean()
    diagnosed = diagnose(dataset, quick=True, seed=5)
    assert diagnosed.before.final.tolist() == ends.tolist()
    assert diagnosed.before.path.tolist() == paths.tolist()
    assert diagnosed.to_json()["heldout_final_error_before"] == ends.mean()


def test_an_effect_that_is_not_there_is_not_spoken_for(fitted):
    """The table is level; fits of it do not help pushes that were held out."""
    assert fitted.with_and_without.verdict != "for"
    tilt = fitted.effect_estimates["table_tilt"]
    assert all(axis["low"] < 0.0 < axis["high"] for axis in tilt.values())


def test_the_ratio_of_misfits_is_paired_over_pushes():
    """All pushes halved: the pushes speak, though they differ a hundredfold among each other."""
    first = np.array([1.0, 10.0, 100.0, 30.0])
    halved = Paired.of(first, first * [0.5, 0.48, 0.52, 0.5])
    assert halved.ratio == pytest.approx(0.5, rel=0.01) and halved.verdict == "for"
    assert Paired.of(first, first * [0.5, 2.1, 0.4, 2.2]).verdict == "undecided"
    assert Paired.of(first * [0.5, 0.48, 0.52, 0.5], first).verdict == "against"
    alone = Paired.of(first[:1], 0.1 * first[:1])
    assert alone.verdict == "undecided" and alone.to_json()["high"] is None


def test_a_push_without_any_error_does_not_outweigh_the_others():
    """Such as one that touches nothing before an exact tracker."""
    before, after = np.array([11.0, 30.0, 45.0, 6.2, 0.0]), np.array([1.1, 1.0, 1.0, 1.0, 0.007])
    assert Paired.of(before, after).verdict == "for"
    assert Paired.of(np.array([5.0, 5.0, 5.0, 1e-3]), np.array([5.2, 5.2, 5.2, 1e-6])).ratio > 1.0
    assert Paired.of(np.zeros(3), np.zeros(3)).ratio == 1.0


def test_the_spread_of_hypotheses_is_a_misfit_like_any_other(learned):
    """Each hypothesis, taken for the measured push, is missed by as much on average over squares."""
    noise = sensor_noise(learned.dataset)
    for push in learned.pushes[:2]:
        motion = push.motion
        observation = replace(push.observation, pose_rows=np.ones(len(push.measured)))
        squares = []
        for poses, forces in zip(motion.poses, motion.forces, strict=True):
            measured = replace(observation, poses=poses, forces=forces)
            error = errors(measured, push.predicted, motion.mean_forces, learned.belief.grid, noise)
            squares.append(error.misfit**2)
        expected = np.sqrt(motion.probability @ squares)
        assert push.spread_misfit == pytest.approx(expected, rel=1e-9) and push.spread_misfit > 0.0


def test_ends_and_their_intervals_are_told(learned):
    for push, told in zip(learned.pushes, learned.to_json()["trials"], strict=True):
        low, high = np.array(told["predicted_end_low"]), np.array(told["predicted_end_high"])
        assert told["measured_end"] == push.measured[-1].tolist()
        assert told["predicted_end"] == push.predicted[-1].tolist()
        assert (low < told["predicted_end"]).all() and (told["predicted_end"] < high).all()


def test_intervals_of_ends_hold_what_the_model_was_off_by(shared_data):
    """Recorded pushes: hypotheses alone, which say what pushes leave open, hold few of the ends."""
    dataset = slipmap.read_dataset(shared_data / "real_mit" / "abs_tri2")
    result = slipmap.identify(dataset, hypotheses=8, friction_laws=False)
    held = [push for push in result.pushes if push.role == "heldout"]
    ends = np.array([push.measured[-1] for push in held])
    low, high = np.array([push.end_interval for push in held]).transpose(1, 0, 2)
    assert 0.8 < ((low < ends) & (ends < high)).mean() < 0.99
