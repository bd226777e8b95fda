"""What several datasets miss together."""

import dataclasses
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.effects.library import AnisotropicTable, SensorLatency, TrackerScale
from slipmap.models.inference.diagnosis import joint_answer, several
from slipmap.models.inference.diagnosis.several import (
    diagnose_together,
    fit_together,
    named_by_evidence,
)
from slipmap.models.inference.together import Taught, between
from slipmap.models.measurements import DatasetError
from slipmap.models.physics.rollout import RolloutError

EFFECTS = (SensorLatency(), AnisotropicTable(), TrackerScale())
TAUGHT, DOUBTS = Taught.of, several.doubts_of_check


def late(dataset, latency, name):
    """The same pushes, reported late by a tracker; a microsecond more makes others of them."""
    trials = tuple(
        dataclasses.replace(
            t, object_pose=dataclasses.replace(t.object_pose, time=t.object_pose.time + latency)
        )
        for t in dataset.trials
    )
    return dataclasses.replace(dataset, trials=trials, name=name)


@pytest.fixture(scope="module")
def answers():
    return {}


@pytest.fixture(autouse=True)
def once_for_each_dataset(answers, monkeypatch):
    """Fit the model without effects to the same pushes, and check them, once for all tests."""

    def once(ask):
        def asked(dataset, observations=(), *rest):
            key = ask, id(dataset), tuple(one.trial for one in observations)
            if key not in answers:
                # The dataset is kept, lest another one gets its identity.
                answers[key] = dataset, ask(dataset, *([observations] if rest else []), *rest)
            return answers[key][1]

        return asked

    monkeypatch.setattr(Taught, "of", once(TAUGHT))
    monkeypatch.setattr(several, "doubts_of_check", once(DOUBTS))


@pytest.fixture(scope="module")
def pair(recorded):
    copied = "trials/001.json: holds the same as trials/002.json; is one a copy?"
    short = dataclasses.replace(recorded.dataset, trials=recorded.dataset.trials[2:], warnings=(copied,))
    return [late(recorded.dataset, 0.03, "first"), late(short, 0.030001, "second")]


@pytest.fixture(scope="module")
def diagnosed(pair):
    return diagnose_together(pair, effects=EFFECTS)


def given(monkeypatch, datasets, **options):
    """A fit of a lag and a scale together, without beliefs, and what each belief would have started from."""
    asked = []

    def learn(dataset, observations, found, **more):
        asked.append(found)
        return dataset

    monkeypatch.setattr(several, "learn", learn)
    return fit_together(datasets, ["sensor_latency", "tracker_scale"], **options), asked


def test_a_lag_that_two_datasets_share_is_named(diagnosed):
    found = diagnosed
    assert found.p_value == min(one.p_value for one in found.candidates) < 0.03
    assert found.effect == "sensor_latency" and found.shared
    (latency,) = found.parameters
    assert latency.low < 0.03 < latency.high and latency.high - latency.low < 0.02
    assert [one.name for one in found.datasets] == ["first", "second"] and found.fall > 3.0
    assert all(one.after.path.mean() < one.before.path.mean() and one.fall > 0.0 for one in found.datasets)
    assert found.doubts == {"first": (), "second": ("reading",)}
    document = found.to_json()
    assert document["effect"] == "sensor_latency" and len(document["candidates"]) == len(EFFECTS)


def test_a_fit_gives_the_numbers_of_the_diagnosis_and_a_belief_of_each_object(pair, diagnosed):
    fitted = fit_together(pair, ["sensor_latency"], hypotheses=2)
    assert fitted.verdict == "for" and fitted.parameters == diagnosed.parameters
    assert fitted.to_json()["datasets"] == diagnosed.to_json()["datasets"]
    assert fitted.fall == diagnosed.fall and fitted.evidence == diagnosed.candidates[0].evidence
    for learned, dataset in zip(fitted.learned, pair, strict=True):
        lag = learned.effect_estimates["sensor_latency"]["latency"]
        assert learned.belief.dataset == dataset.name and lag["low"] < 0.03 < lag["high"]
        errors = learned.errors("heldout")
        assert len(errors) == 4
        assert fitted.held_out_errors()[dataset.name] == errors.mean() > 0.0


def test_a_belief_expects_what_the_other_datasets_tell(pair, monkeypatch):
    fitted, asked = given(monkeypatch, pair)
    assert fitted.effects == ("sensor_latency", "tracker_scale") and len(fitted.parameters) == 2
    both = [one.alone for one in fitted.datasets]
    for k, start in enumerate(asked):
        other = both[1 - k][0]
        deviation = (other.high - other.low) / 3.29
        prior = SensorLatency().parameters[0].scale
        # The other dataset's value, and the prior of the effect.
        precision = deviation**-2 + prior**-2
        assert start.values[0] == pytest.approx(other.value * deviation**-2 / precision, rel=1e-6)
        assert start.scales[0] == pytest.approx(precision**-0.5, rel=1e-6)


def test_what_datasets_do_not_share_is_not_told_by_others(pair, monkeypatch):
    fitted, asked = given(monkeypatch, pair, apart=["tracker"])
    assert fitted.parameters == ()
    for start, one in zip(asked, fitted.datasets, strict=True):
        assert start.values == pytest.approx([e.value for e in one.alone], abs=5e-3)
        assert list(start.scales) == [effect.parameters[0].scale for effect in (EFFECTS[0], EFFECTS[2])]


def test_a_whole_locked_object_takes_what_all_others_tell(pair, monkeypatch):
    four = [late(pair[0].with_fit_pushes(3), 1e-6 * k, str(k)) for k in range(4)]
    fitted, asked = given(monkeypatch, four)
    (whole,) = (k for k, one in enumerate(fitted.datasets) if one.whole)
    others = [start.scales[0] for k, start in enumerate(asked) if k != whole]
    assert fitted.datasets[whole].alone == () and asked[whole].scales[0] < min(others)
    assert asked[whole].values[0] == pytest.approx(fitted.parameters[0].value, rel=0.02)


def test_an_effect_that_is_not_there_is_not_supported(recorded, monkeypatch):
    plain = [late(recorded.dataset, 1e-6 * k, str(k)) for k in range(2)]
    fitted, _ = given(monkeypatch, plain)
    assert fitted.verdict == "undecided" and "hardly better" in fitted.sentence
    with pytest.raises(ValueError, match="at least one effect"):
        fit_together(plain, [])


def stretched(dataset, excess):
    """The same pushes, with the tracker's lengths too large by a share."""
    scales = np.array([1.0 + excess, 1.0 + excess, 1.0])
    trials = tuple(
        dataclasses.replace(
            t, object_pose=dataclasses.replace(t.object_pose, values=t.object_pose.values * scales)
        )
        for t in dataset.trials
    )
    return dataclasses.replace(dataset, trials=trials)


@pytest.fixture(scope="module")
def both(recorded):
    return stretched(late(recorded.dataset, 0.03, "late"), 0.06)


def test_one_dataset_names_what_is_clear_and_what_leads_alone(recorded, both):
    def asked(dataset):
        found = named_by_evidence(dataset, EFFECTS, 0, lambda done, total: None)
        return [effect.name for effect in found]

    assert asked(late(recorded.dataset, 0.03, "late")) == ["sensor_latency"]
    assert sorted(asked(both)) == ["sensor_latency", "tracker_scale"]
    assert asked(recorded.dataset) == []


@pytest.fixture(scope="module")
def late_and_stretched(pair):
    return [stretched(one, 0.06) for one in pair]


def test_two_effects_that_two_datasets_share_are_named_together(late_and_stretched):
    found = diagnose_together(late_and_stretched, effects=EFFECTS)
    assert found.verdict == "effect" and found.together and found.shared
    assert set(found.effects) == {"sensor_latency", "tracker_scale"}
    assert f"two effects at once in these datasets: {' and '.join(found.effects)}." in found.sentence
    sizes = {p.name: p for p in found.parameters}
    assert sizes["latency"].low < 0.03 < sizes["latency"].high
    assert sizes["excess"].low < 0.06 < sizes["excess"].high
    assert sum(one.in_set for one in found.candidates) == 2
    assert {p.effect for one in found.datasets for p in one.alone} == set(found.effects)
    assert all((one.after.misfit < 0.75 * one.before.misfit).all() for one in found.datasets)
    # A fit of both gives the same numbers, and so does the belief of each object start from them.
    fitted = fit_together(late_and_stretched, found.effects, hypotheses=2)
    assert fitted.verdict == "for" and fitted.fall == pytest.approx(found.fall, rel=1e-6)
    for own, other in zip(fitted.parameters, found.parameters, strict=True):
        assert dataclasses.astuple(own)[3:] == pytest.approx(dataclasses.astuple(other)[3:], rel=1e-6)


@pytest.mark.parametrize(
    ("changed", "objection"),
    [
        # Better than nothing, but not better than the first alone; and worse than nothing.
        (lambda judged, first: first.falls, "not clearly predicted better with both than with"),
        (lambda judged, first: [f - 1e3 * k for k, f in enumerate(judged.falls)], "not clearly predicted"),
        (lambda judged, first: [f + 50.0 - 60.0 * k for k, f in enumerate(first.falls)], "with both than"),
    ],
)
def test_a_second_effect_that_the_locked_pushes_do_not_support_is_not_named(
    late_and_stretched, monkeypatch, changed, objection
):
    own, singles = several._Inquiry._judge, {}

    def judge(self, fit, evidence, progress):
        judged = own(self, fit, evidence, progress)
        if len(fit.effects) > 1:
            first = singles[fit.effects[0].name]
            return dataclasses.replace(judged, falls=changed(judged, first))
        return singles.setdefault(judged.name, judged)

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    found = diagnose_together(late_and_stretched, effects=EFFECTS, draws=0)
    assert found.verdict == "effect" and not found.together and len(found.effects) == 1
    (second,) = {"sensor_latency", "tracker_scale"} - set(found.effects)
    (said,) = (one.objection for one in found.candidates if one.name == second)
    assert (
        said.startswith(f"gains much beside {found.effect}, but the locked pushes are") and objection in said
    )


def test_second_effects_that_cannot_be_told_apart_are_told_but_not_named(late_and_stretched, monkeypatch):
    """Two copies of the second effect gain as much beside the first."""
    monkeypatch.setattr(joint_answer, "far_above_noise", lambda misfits: 7.0)

    class Twin(SensorLatency):
        name = "twin"

    found = diagnose_together(late_and_stretched, effects=[SensorLatency(), TrackerScale(), Twin()], draws=0)
    assert found.effects == ("tracker_scale",) and not found.together
    said = {one.name: one.objection for one in found.candidates}
    assert "7 times the sensor noise off" in found.sentence
    assert found.sentence.endswith(", which gain alike beside it.")
    assert "sensor_latency or twin" in found.sentence or "twin or sensor_latency" in found.sentence
    assert said["twin"] == "gains much beside tracker_scale, but so would sensor_latency"
    assert said["sensor_latency"] == "gains much beside tracker_scale, but so would twin"


@pytest.mark.parametrize("far", [False, True])
def test_a_first_effect_that_is_right_only_with_a_second_is_named_with_it(
    late_and_stretched, monkeypatch, far
):
    """The locked pushes object to every effect alone. Both are named unless pushes then are still far off."""
    own = several._Inquiry._judge

    def judge(self, fit, evidence, progress):
        judged = own(self, fit, evidence, progress)
        if len(fit.effects) == 1:
            return dataclasses.replace(judged, falls=[-5.0, 2.0])
        after = [dataclasses.replace(one, misfit=one.misfit * (1.0 + 2.0 * far)) for one in judged.after]
        return dataclasses.replace(judged, after=after)

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    monkeypatch.setattr(several.JudgedFit, "is_better_than", lambda self, other, least: True)
    found = diagnose_together(late_and_stretched, effects=EFFECTS, draws=0)
    both = {"sensor_latency", "tracker_scale"}
    said = [one.objection or "" for one in found.candidates if one.name in both]
    if far:
        assert found.verdict == "undecided" and not found.effects
        assert any(text.endswith("but the locked pushes are far off with both") for text in said)
    else:
        assert found.together and set(found.effects) == both and said == ["", ""]


@pytest.mark.parametrize("together", [True, False])
def test_one_effect_has_to_be_far_ahead_of_the_next_and_two_need_not(recorded, monkeypatch, together):
    """Beside a soft finger, a lag explains nearly as much, until the second effect is in the model."""
    candidates = [
        SimpleNamespace(name=effect.name, evidence=evidence)
        for effect, evidence in zip(EFFECTS, (300.0, 40.0, 290.0), strict=True)
    ]
    names = ("sensor_latency", "anisotropic_table")[: 1 + together]
    found = SimpleNamespace(candidates=candidates, together=together, effect=names[0], effects=names)
    monkeypatch.setattr(several._Inquiry, "run", lambda self, draws: found)
    named = named_by_evidence(recorded.dataset, EFFECTS, 0, lambda done, total: None)
    assert tuple(effect.name for effect in named) == (names if together else ())


def test_a_second_effect_needs_the_locked_pushes_too(both, monkeypatch):
    own = several._Inquiry._judge

    def judge(self, fit, evidence, progress):
        judged = own(self, fit, evidence, progress)
        return dataclasses.replace(judged, falls=[20.0]) if len(fit.effects) > 1 else judged

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    assert len(named_by_evidence(both, EFFECTS, 0, lambda done, total: None)) == 1


def test_nothing_is_named_where_nothing_is_hidden_and_one_object_in_four_is_locked(recorded):
    few = recorded.dataset.with_fit_pushes(4)
    found = diagnose_together(
        [late(few, 1e-6 * k, str(k)) for k in range(4)], effects=EFFECTS[:2], apart=["table"]
    )
    assert found.verdict == "adequate" and found.effects == () and found.parameters == ()
    assert found.doubts == {}
    assert [one.whole for one in found.datasets].count(True) == 1
    assert all(one.after is None and one.fall is None for one in found.datasets)


def test_a_single_dataset_and_two_of_one_name_are_refused(recorded):
    words = "two or more datasets with different names, got"
    with pytest.raises(DatasetError, match=f"{words} {recorded.dataset.name}$"):
        diagnose_together([recorded.dataset])
    with pytest.raises(DatasetError, match=f"{words} .*; change `name` in the dataset.yaml of one of those"):
        diagnose_together([recorded.dataset, recorded.dataset])


def test_a_second_effect_that_cannot_be_judged_leaves_the_first(both, monkeypatch):
    own = several._Inquiry._judge

    def judge(self, fit, evidence, progress):
        if len(fit.effects) > 1:
            raise RolloutError("broken")
        return own(self, fit, evidence, progress)

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    assert len(named_by_evidence(both, EFFECTS, 0, lambda done, total: None)) == 1


def test_an_answer_that_no_push_judges_says_so(recorded):
    short = recorded.dataset.with_fit_pushes(2)
    short = dataclasses.replace(short, trials=short.fit_trials)
    pair = [late(short, 0.05, "first"), late(short, 0.050001, "second")]
    found = diagnose_together(pair, effects=EFFECTS[:1], draws=0)
    assert found.p_value is None and found.effects == ()
    assert all(one.locked == () for one in found.datasets)
    assert "no pushes were locked away that could judge it" in found.sentence


@pytest.mark.parametrize("broken", [False, True])
def test_what_is_in_no_answer_gets_bounds_unless_they_cannot_be_computed(pair, monkeypatch, broken):
    """Of two rivals neither is bounded beside the other."""
    own, rivals = several._Inquiry._judge, ("sensor_latency", "tracker_scale")

    def judge(self, fit, evidence, progress):
        score = 100.0 if fit.effects[0].name in rivals else 0.0
        return dataclasses.replace(own(self, fit, evidence, progress), falls=[9.0, 9.0], score=score)

    def remaining(self, effects, starts, answer):
        raise RolloutError("broken")

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    monkeypatch.setattr(several._Inquiry, "_there", lambda self, one: True)
    monkeypatch.setattr(several, "EVIDENCE", -np.inf)
    if broken:
        monkeypatch.setattr(several.Together, "remaining", remaining)
    found = diagnose_together(pair, effects=EFFECTS, draws=3)
    assert found.verdict == "ambiguous" and sorted(found.effects) == list(rivals)
    bounds = {one.name: [bound.name for bound in one.bounds] for one in found.candidates}
    beside = [] if broken else ["along_x", "along_xy"]
    assert bounds == {"sensor_latency": [], "tracker_scale": [], "anisotropic_table": beside}


def test_draws_that_are_no_number_of_draws_are_refused(recorded):
    pair = [late(recorded.dataset, 1e-6 * k, str(k)) for k in range(2)]
    for draws in (-1, 1.5):
        with pytest.raises(ValueError, match="draws must be a whole number of at least 0"):
            diagnose_together(pair, draws=draws)


def test_pushes_that_two_datasets_contain_are_refused(recorded):
    again = dataclasses.replace(recorded.dataset, name="again")
    for ask in (diagnose_together, partial(fit_together, effects=EFFECTS)):
        with pytest.raises(DatasetError, match="simulated and again contain the same push"):
            ask([recorded.dataset, again])


def test_an_unknown_owner_is_refused(recorded):
    with pytest.raises(ValueError, match="unknown owner 'force_sensor'; choose from object, table, tracker"):
        diagnose_together([recorded.dataset], apart=["force_sensor"])


def test_variance_between_datasets_is_what_their_own_does_not_explain():
    deviations = np.array([0.1, 0.1, 0.1])
    assert between(np.array([1.0, 1.05, 0.95]), deviations) == 0.0
    assert between(np.array([0.0, 1.0, 2.0]), deviations) == pytest.approx(1.0 - 0.01)


def test_nothing_is_named_behind_an_effect_that_fails_in_one_dataset_but_explains_far_more(
    recorded, monkeypatch
):
    falls = {"sensor_latency": [175.0, -9.0], "tracker_scale": [67.0, 2.0]}
    own = several._Inquiry._judge

    def judge(self, fit, evidence, progress):
        judged = own(self, fit, evidence, progress)
        fallen = falls[judged.name]
        return dataclasses.replace(judged, falls=fallen, score=100.0 + sum(fallen))

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    monkeypatch.setattr(several._Inquiry, "_there", lambda self, one: True)
    monkeypatch.setattr(several, "EVIDENCE", -np.inf)
    pair = [late(recorded.dataset, 0.03, "first"), late(recorded.dataset, 0.030001, "second")]

    undecided = diagnose_together(pair, effects=[SensorLatency(), TrackerScale()])
    assert undecided.verdict == "undecided" and undecided.effects == ()
    objection = "the locked pushes of second are predicted worse with it"
    assert f"sensor_latency would explain most, but {objection}" in undecided.sentence
    assert {c.name: c.objection for c in undecided.candidates}["sensor_latency"] == objection
