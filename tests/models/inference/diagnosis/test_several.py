"""What several datasets miss together."""

import dataclasses

import numpy as np
import pytest

from slipmap.models.effects.library import AnisotropicTable, SensorLatency, TrackerScale
from slipmap.models.inference.diagnosis import several
from slipmap.models.inference.diagnosis.several import _between, diagnose_together, named_by_evidence
from slipmap.models.measurements import DatasetError

EFFECTS = (SensorLatency(), AnisotropicTable(), TrackerScale())


def late(dataset, latency, name):
    """The same pushes, reported late by a tracker."""
    trials = tuple(
        dataclasses.replace(
            t, object_pose=dataclasses.replace(t.object_pose, time=t.object_pose.time + latency)
        )
        for t in dataset.trials
    )
    return dataclasses.replace(dataset, trials=trials, name=name)


def test_a_lag_that_two_datasets_share_is_named(recorded):
    short = dataclasses.replace(recorded.dataset, trials=recorded.dataset.trials[2:])
    found = diagnose_together(
        [late(recorded.dataset, 0.03, "first"), late(short, 0.03, "second")], effects=EFFECTS
    )
    assert found.effect == "sensor_latency" and found.shared
    (latency,) = found.parameters
    assert latency.low < 0.03 < latency.high and latency.high - latency.low < 0.02
    assert [one.name for one in found.datasets] == ["first", "second"] and found.fall > 3.0
    assert all(one.after.path.mean() < one.before.path.mean() and one.fall > 0.0 for one in found.datasets)
    document = found.to_json()
    assert document["effect"] == "sensor_latency" and len(document["candidates"]) == len(EFFECTS)


def test_one_dataset_names_what_is_clear_and_what_leads_alone(recorded):
    def asked(dataset, effects):
        found = named_by_evidence(dataset, effects, 0, lambda done, total: None)
        return None if found is None else found.name

    assert asked(late(recorded.dataset, 0.03, "late"), EFFECTS) == "sensor_latency"
    assert asked(recorded.dataset, EFFECTS) is None


def test_nothing_is_named_where_nothing_is_hidden_and_one_object_in_four_is_locked(recorded):
    few = recorded.dataset.with_fit_pushes(4)
    found = diagnose_together(
        [dataclasses.replace(few, name=str(k)) for k in range(4)], effects=EFFECTS[:2], apart=["table"]
    )
    assert found.verdict == "adequate" and found.effects == () and found.parameters == ()
    assert [one.whole for one in found.datasets].count(True) == 1
    assert all(one.after is None and one.fall is None for one in found.datasets)


def test_a_single_dataset_and_two_of_one_name_are_refused(recorded):
    for datasets in ([recorded.dataset], [recorded.dataset, recorded.dataset]):
        with pytest.raises(DatasetError, match="needs two or more datasets with different names"):
            diagnose_together(datasets)


def test_an_unknown_owner_is_refused(recorded):
    with pytest.raises(ValueError, match="unknown owner 'force_sensor'; choose from object, table, tracker"):
        diagnose_together([recorded.dataset], apart=["force_sensor"])


def test_variance_between_datasets_is_what_their_own_does_not_explain():
    deviations = np.array([0.1, 0.1, 0.1])
    assert _between(np.array([1.0, 1.05, 0.95]), deviations) == 0.0
    assert _between(np.array([0.0, 1.0, 2.0]), deviations) == pytest.approx(1.0 - 0.01)


def test_nothing_is_named_behind_an_effect_that_fails_in_one_dataset_but_explains_far_more(
    recorded, monkeypatch
):
    falls = {"sensor_latency": [175.0, -9.0], "tracker_scale": [67.0, 2.0]}
    own = several._Inquiry._judge

    def judge(self, fit, evidence, progress):
        judged = own(self, fit, evidence, progress)
        fallen = falls[judged.effect.name]
        return dataclasses.replace(judged, falls=fallen, score=100.0 + sum(fallen))

    monkeypatch.setattr(several._Inquiry, "_judge", judge)
    monkeypatch.setattr(several._Inquiry, "_there", lambda self, one: True)
    monkeypatch.setattr(several, "EVIDENCE", -np.inf)
    pair = [late(recorded.dataset, 0.03, "first"), late(recorded.dataset, 0.03, "second")]

    undecided = diagnose_together(pair, effects=[SensorLatency(), TrackerScale()])
    assert undecided.verdict == "undecided" and undecided.effects == ()
    objection = "the locked pushes of second are predicted worse with it"
    assert f"sensor_latency would explain most, but {objection}" in undecided.sentence
    assert {c.name: c.objection for c in undecided.candidates}["sensor_latency"] == objection
