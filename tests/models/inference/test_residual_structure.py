"""Patterns that residuals hang together with: none where there is none, and the right one where there is."""

import numpy as np
import pytest

from slipmap.models.inference.residual_structure import NEGLIGIBLE, corrected, factor_patterns, push_weights
from slipmap.models.inference.residuals import Conditions, Residuals

PUSHES, PIECES = 20, 10


def pushes_with_residuals(rng, size=0.05, effect=None):
    """Pushes at random places, speeds and headings whose residuals wander; `effect` adds to them.

    Args:
        rng: source.
        size: typical residual velocity as a share of the speed.
        effect: function of Conditions that gives world velocities (N, 3) as a share of the speed.
    """
    push = np.repeat(np.arange(PUSHES), PIECES)
    heading = rng.uniform(-np.pi, np.pi, PUSHES)[push] + 0.3 * rng.normal(size=len(push))
    speed = np.exp(rng.uniform(np.log(0.01), np.log(0.15), PUSHES))
    turn = rng.normal(size=PUSHES)[push]
    velocity = np.column_stack([np.cos(heading), np.sin(heading), turn]) * speed[push, None]
    at = Conditions(
        push=push,
        time=np.tile(np.linspace(0.1, 1.9, PIECES), PUSHES),
        share=np.tile(np.linspace(0.05, 0.95, PIECES), PUSHES),
        place=rng.uniform(-0.3, 0.3, (PUSHES, 2))[push] + 0.02 * rng.normal(size=(len(push), 2)),
        angle=rng.uniform(-3, 3, PUSHES)[push],
        velocity=velocity,
        contact=rng.uniform(-0.05, 0.05, (PUSHES, 2))[push],
        phase=np.tile([0] + [1] * 5 + [2] * 4, PUSHES),
    )
    common = rng.normal(size=(PUSHES, 3))[push]
    wander = rng.normal(size=(PUSHES, PIECES, 3)).cumsum(axis=1).reshape(-1, 3) / np.sqrt(PIECES)
    relative = size * np.exp(0.7 * rng.normal(size=PUSHES))[push, None] * (common + wander)
    if effect is not None:
        relative = relative + effect(at)
    return Residuals(at, relative * speed[push, None], np.full(len(push), 0.2), speed)


def test_without_an_effect_false_alarms_stay_at_the_nominal_rate():
    rng = np.random.default_rng(3)
    runs, families, single, tests = 60, 0, 0, 0
    for _ in range(runs):
        patterns = corrected(factor_patterns(pushes_with_residuals(rng), "motion", rng))
        families += any(pattern.significant for pattern in patterns)
        single += sum(pattern.p < 0.05 for pattern in patterns)
        tests += len(patterns)
    assert tests == runs * 11
    assert families <= 8  # 3 are expected; 9 or more have a chance of 0.3 %
    assert 0.01 < single / tests < 0.07  # below 5 %, since negligible patterns are subtracted


def drift(at):
    return np.tile([0.0, -0.06, 0.0], (len(at), 1))


def veer(at):
    """To the left of the motion along the table's x axis, to the right along y."""
    direction = at.table_direction
    left = np.column_stack([-np.sin(direction), np.cos(direction), np.zeros(len(at))])
    return 0.08 * np.cos(2 * direction)[:, None] * left * at.translating[:, None]


def faster(at):
    unit = at.velocity / at.speed[:, None]
    return 0.06 * (np.log(at.speed) - np.log(at.speed).mean())[:, None] * unit


def wear(at):
    unit = at.velocity / at.speed[:, None]
    return 0.1 * (at.push / PUSHES - 0.5)[:, None] * unit * [1, 1, 0]


@pytest.mark.parametrize(
    ("effect", "factor", "strongest", "size"),
    [
        (drift, "table_drift", "along table y", -0.06),
        (
            veer,
            "table_direction",
            "to the left of the motion; more when moving along table x rather than y",
            None,
        ),
        (faster, "speed", None, None),
        (wear, "order", "along the motion; grows from push to push", None),
    ],
)
def test_an_effect_is_found_under_its_name(effect, factor, strongest, size):
    rng = np.random.default_rng(4)
    residuals = pushes_with_residuals(rng, size=0.01, effect=effect)
    first = corrected(factor_patterns(residuals, "motion", rng))[0]
    assert first.factor == factor
    assert first.significant
    if strongest is not None:
        assert first.strongest == strongest
    if size is not None:
        assert first.low < size < first.high
        assert first.high - first.low < 0.6 * abs(size)


def test_a_negligible_pattern_is_not_reported_however_sure():
    rng = np.random.default_rng(5)
    small = 0.8 * NEGLIGIBLE["motion"]
    residuals = pushes_with_residuals(rng, size=1e-4, effect=lambda at: np.tile([small, 0, 0], (len(at), 1)))
    patterns = corrected(factor_patterns(residuals, "motion", rng))
    (pattern,) = [p for p in patterns if p.factor == "table_drift"]
    assert not pattern.significant
    assert pattern.size == pytest.approx(small, rel=0.05)


def test_a_push_that_no_model_explains_weighs_no_more_than_others():
    rng = np.random.default_rng(6)
    residuals = pushes_with_residuals(rng)
    residuals.values[residuals.at.push == 7] *= 200
    weights = push_weights(residuals)
    assert weights[7] < 0.05
    assert weights.max() == 1.0


def test_pushes_known_by_their_ends_are_not_asked_for_their_course():
    rng = np.random.default_rng(7)
    patterns = factor_patterns(pushes_with_residuals(rng), "motion", rng, whole_pushes=True)
    assert {"phase", "time"}.isdisjoint(pattern.factor for pattern in patterns)


def test_the_same_seed_gives_the_same_p_values():
    residuals = pushes_with_residuals(np.random.default_rng(8))
    first, second = (factor_patterns(residuals, "motion", np.random.default_rng(seed)) for seed in (1, 1))
    assert [p.p for p in first] == [p.p for p in second]
