"""One model of several datasets."""

import dataclasses

import numpy as np
import pytest

from slipmap.models.effects.effect import Effect, Parameter
from slipmap.models.effects.library import AnisotropicObject, TableTilt
from slipmap.models.inference.likelihood import Likelihood, LikelihoodSettings
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prior import MapPrior, PriorSettings, slider_for
from slipmap.models.inference.together import (
    JointLikelihood,
    JointPrior,
    Taught,
    Together,
    _eliminated,
    _fall,
    _prior,
    alone,
)

SETTINGS = PriorSettings(modes=5)
OWN, SHARED = AnisotropicObject(), TableTilt()


class Shift(Effect):
    name = "shift"
    sentence = "The tracker is shifted in the world."
    belongs_to = "tracker"
    parameters = (Parameter("x", "m", "along x", -0.1, 0.1, 3e-3, 0.0),)

    def measured(self, pose, p):
        return pose.x + p.x, pose.y, pose.theta


class Again(Shift):
    name = "again"


def shifted(dataset, x):
    """The same pushes before a tracker that reports x too much."""
    trials = []
    for trial in dataset.trials:
        values = trial.object_pose.values + np.array([x, 0.0, 0.0])
        pose = dataclasses.replace(trial.object_pose, values=values)
        trials.append(dataclasses.replace(trial, object_pose=pose))
    return dataclasses.replace(dataset, trials=tuple(trials), name=f"{dataset.name} shifted by {x}")


@pytest.fixture(scope="module")
def parts(recorded):
    d = recorded.dataset
    prior = MapPrior(slider_for(d, (OWN, SHARED)), SETTINGS, d.mass, 8.0)
    observations = observe_all(d)
    return [
        Likelihood(prior, some, d.noise, LikelihoodSettings())
        for some in (observations[:2], observations[2:5])
    ]


def test_coordinates_are_shared_as_effects_say(parts):
    priors = [part.prior for part in parts]
    plain = priors[0].plain
    joint = JointPrior(priors, (OWN, SHARED), ())
    assert joint.size == 2 * plain + 2 * 2 + 2
    first, second = (place[plain:] - 2 * plain for place in joint.places)
    assert list(first) == [0, 1, 4, 5] and list(second) == [2, 3, 4, 5]
    assert JointPrior(priors, (OWN, SHARED), ("table",)).size == 2 * plain + 2 * 2 + 2 * 2


def test_what_a_slope_brings_is_each_datasets_own_and_comes_last(recorded):
    low, high = (dataclasses.replace(recorded.dataset, finger_height=h) for h in (0.004, 0.02))
    priors = [_prior(d, (SHARED,), 8.0, slopes=True) for d in (low, recorded.dataset, high)]
    joint = JointPrior(priors, (SHARED,), ())
    plain = priors[0].plain
    assert joint.plain == 3 * plain and joint.size == 3 * plain + 2 + 2 + 2
    own = [list(place[plain:] - 3 * plain) for place in joint.places]
    assert own == [[0, 1, 2, 3], [0, 1], [0, 1, 4, 5]]
    # A finger touches a little above its lower end.
    assert joint.effect_centers == pytest.approx([0.0, 0.0, 0.009, 0.015, 0.025, 0.015])
    assert joint.effect_scales == pytest.approx([0.03, 0.03, 0.005, 0.01, 0.005, 0.01])


def test_costs_and_slopes_are_those_of_both_datasets(parts):
    joint = JointLikelihood(JointPrior([part.prior for part in parts], (OWN, SHARED), ()), parts)
    rng = np.random.default_rng(0)
    z = 0.3 * rng.standard_normal((1, joint.prior.size))
    offsets, ones = np.zeros((1, 5, 3)), np.ones((1, 5))

    def cost(z):
        return joint.linearise(z, offsets, np.ones(1), ones).cost.sum()

    equations = joint.linearise(z, offsets, np.ones(1), ones)
    alone = [
        part.linearise(z[:, place], offsets[:, own], np.ones(1), ones[:, own], by_push=True)
        for part, place, own in zip(parts, joint.prior.places, joint.pushes, strict=True)
    ]
    assert equations.cost[0] == pytest.approx(np.concatenate([one.cost[0] for one in alone]))
    gradient = np.zeros_like(equations.gradient)
    for one, place in zip(alone, joint.prior.places, strict=True):
        assert one.push_gradient.sum(axis=0) == pytest.approx(one.gradient)
        gradient[:, place] += one.gradient
    assert equations.gradient == pytest.approx(gradient)
    # With a start offset held, the slope along a direction is that of the cost.
    direction = rng.standard_normal((1, joint.prior.size))
    numeric = (cost(z + 1e-5 * direction) - cost(z - 1e-5 * direction)) / 2e-5
    held = equations.gradient[0] @ direction[0]
    start = np.einsum("bkdj,bkij,bki->d", equations.coupling, equations.start_gain, equations.start_gradient)
    assert held + start @ direction[0] == pytest.approx(numeric, rel=1e-3)


def test_an_amplitude_of_the_wrong_sign_gains_nothing(recorded):
    class Rightwards(Shift):
        name = "rightwards"
        parameters = (Parameter("x", "m", "along x", 0.0, 0.1, 3e-3, 0.0),)

    def gain(x):
        dataset = shifted(recorded.dataset, x)
        taught = Taught.of(dataset, observe_all(dataset, dataset.fit_trials), lambda done, total: None)
        both = Together([taught]).first_gains(
            [Shift(), Rightwards()], lambda done, total: None, 99, np.random.default_rng(0)
        )
        return {one.effect.name: one.gain for one in both}

    left, right = gain(-2e-3), gain(2e-3)
    assert left["shift"] > 1.0 and left["rightwards"] == 0.0
    assert right["rightwards"] == pytest.approx(right["shift"], rel=0.05) and right["shift"] > 1.0


def test_two_datasets_that_share_a_shift_know_it_better_than_each(recorded):
    datasets = [shifted(recorded.dataset, 2e-3), shifted(recorded.dataset.with_fit_pushes(3), 2e-3)]
    taught = [Taught.of(d, observe_all(d, d.fit_trials), lambda done, total: None) for d in datasets]
    effect = Shift()
    together = Together(taught)
    (first,) = together.first_gains([effect], lambda done, total: None)
    assert first.p_value is None
    (again,) = together.first_gains([effect], lambda done, total: None, 199, np.random.default_rng(0))
    # Six and three pushes agree on the shift; two of 512 sign patterns gain as much.
    assert again.gain == first.gain and again.p_value < 0.03
    fitted = together.fitted([effect], [first.start])
    base = together.fitted((), ())
    assert base.cost == pytest.approx(together.base_cost, rel=1e-2)
    assert base.cost - fitted.cost > 3.0 and first.gain > 3.0
    assert fitted.values(0) == fitted.values(1) == pytest.approx(2e-3, abs=3e-4)
    each = [alone(fitted, k) for k in (0, 1)]
    assert fitted.deviations(0) < min(deviation for _, deviation in each)
    # Precisions add up, as maps are not shared; that of the prior comes on top. Not exactly: each dataset has
    # its own best fit.
    precision = sum(deviation**-2 for _, deviation in each) + effect.parameters[0].scale ** -2
    assert fitted.deviations(0) == pytest.approx(precision**-0.5, rel=0.025)


def test_gains_beside_a_fitted_model_are_those_under_its_error_and_from_its_maps(recorded):
    tilted = [shifted(recorded.dataset, x) for x in (8e-3, 8.001e-3)]
    taught = [Taught.of(d, observe_all(d, d.fit_trials), lambda done, total: None) for d in tilted]
    together, shift = Together(taught), Shift()
    (first,) = together.first_gains([shift], lambda done, total: None)
    named = together.refined(together.fitted([shift], [first.start]), lambda done, total: None)
    around = together.around(named)
    for k, (before, now) in enumerate(zip(together.taught, around.taught, strict=True)):
        # The shift explains the pushes, so that they are trusted more.
        assert now.settings == named.likelihood.parts[k].settings != before.settings
        assert now.base.z.shape == before.base.z.shape
        assert now.base.z[0] == pytest.approx(named.found.z[0, named.likelihood.prior.places[k]][:-1])
        assert now.base.offsets.shape == before.base.offsets.shape
    assert around.weight == together.weight
    # At the fitted model nothing is left to gain, and what a second shift would gain is the first one's.
    (beside,) = around.first_gains([SHARED], lambda done, total: None, beside=named)
    (twice,) = around.first_gains([Again()], lambda done, total: None, beside=named)
    (alone,) = together.first_gains([Again()], lambda done, total: None)
    assert beside.gain < 3.0 and twice.gain < 0.1 and alone.gain > 30.0
    # Nor do the pushes tell its size, as the first one's is free.
    assert twice.gain - twice.evidence < 1.0 < alone.gain - alone.evidence
    assert list(map(list, named.by_effect(0))) == [list(named.values(0))]


def test_what_is_not_named_is_bounded_beside_the_answer(recorded):
    datasets = [shifted(recorded.dataset, 2e-3), shifted(recorded.dataset.with_fit_pushes(3), 2e-3)]
    taught = [Taught.of(d, observe_all(d, d.fit_trials), lambda done, total: None) for d in datasets]
    effects = (Shift(), SHARED, OWN)
    together = Together(taught)
    starts = {one.effect: one.start for one in together.first_gains(effects, lambda done, total: None)}
    every = [starts[effect] for effect in effects]
    without = together.remaining(effects, every, together.fitted((), ()))
    slopes = [("table_tilt", "down_x"), ("table_tilt", "down_y")]
    assert set(without) == {("shift", "x"), *slopes}  # each object would have a grain of its own
    value, low, high = without["shift", "x"]
    assert 0.0 < low < 2e-3 < high and low < value < high
    beside = together.remaining(effects, every, together.fitted([effects[0]], [starts[effects[0]]]))
    assert set(beside) == set(slopes)
    for name in slopes:
        # The table is level, and the pushes bound its slope to less than half of what is usual.
        _, low, high = beside[name]
        assert low < 0.0 < high and high - low < 0.03


def test_datasets_that_disagree_bound_an_effect_less(recorded):
    bounds = []
    for other in (2e-3, 1e-3, -2e-3):
        datasets = [shifted(recorded.dataset, 2e-3), shifted(recorded.dataset.with_fit_pushes(3), other)]
        taught = [Taught.of(d, observe_all(d, d.fit_trials), lambda done, total: None) for d in datasets]
        together, effect = Together(taught), Shift()
        found = together.remaining([effect], [effect.nulls], together.fitted((), ()))
        bounds.append(found.get(("shift", "x")))
    (_, low, high), (_, apart_low, apart_high), opposed = bounds
    assert apart_high - apart_low > 1.5 * (high - low)
    assert opposed is None


def test_signs_of_whole_pushes_turn_their_slopes_and_leave_the_prior_aside(parts):
    part, plain = parts[1], parts[1].prior.plain
    z = np.full((1, part.prior.size), 0.1)
    equations = part.linearise(z, np.zeros((1, 3, 3)), np.ones(1), np.ones((1, 3)), by_push=True)
    own, maps, pull = np.array([plain]), np.arange(plain), z[0, :plain]
    signs = np.array([[1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])
    normal, slopes = _eliminated(equations, maps, pull, own, signs)
    _, alone = _eliminated(equations, maps, np.zeros(plain), own)
    assert slopes.shape == (1, 4) and slopes[0, 1] == pytest.approx(alone[0, 0])
    assert slopes[0, 0] != pytest.approx(alone[0, 0]) and slopes[0, 2] == pytest.approx(-alone[0, 0])
    assert abs(slopes[0, 3]) != pytest.approx(abs(alone[0, 0]), rel=1e-3)
    assert _fall(normal, slopes, np.zeros(1))[1] == pytest.approx(
        0.5 * alone[0, 0] ** 2 / (normal[0, 0] + 1.0)
    )


def test_a_push_near_balance_counts_for_what_it_can_tell(recorded):
    d = recorded.dataset
    taught = Taught.of(d, observe_all(d, d.fit_trials), lambda done, total: None)
    observations = observe_all(d, d.heldout_trials)
    held = taught.likelihood((), 1.0).linearise(
        taught.base.z, np.zeros((1, len(d.fit_trials), 3)), np.ones(1), np.ones((1, len(d.fit_trials)))
    )
    free = taught.costs(taught.observations, taught.prior, taught.base.z[0])
    assert (free <= held.cost[0] + 1e-9).all() and free.sum() < held.cost.sum()
    assert free == pytest.approx(taught.base.push_cost[0], rel=0.05, abs=0.02)
    assert len(taught.costs(observations, taught.prior, taught.base.z[0])) == len(observations)
