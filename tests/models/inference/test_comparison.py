"""`compare` as a whole: the true model against its own pushes, wrong ones, and measured ones."""

import json
from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.files import plain
from slipmap.models.inference import prediction
from slipmap.models.inference.belief import Belief, BeliefError
from slipmap.models.inference.comparison import compare
from slipmap.models.inference.identification import identify
from slipmap.models.inference.observations import MEASURED_CONTACT
from slipmap.models.inference.prior import PriorSettings
from slipmap.models.measurements import Channel, Table, read_dataset
from slipmap.models.physics.rollout import Maps


@pytest.fixture(scope="module")
def truth(recorded):
    """A belief that knows the truth, and a wilder second hypothesis of little weight."""
    maps = recorded.truth
    return Belief(
        grid=recorded.dataset.grid,
        finger_radius=recorded.dataset.finger_radius,
        gravity=recorded.dataset.gravity,
        maps=Maps(
            np.vstack([maps.mass, maps.mass]),
            np.vstack([maps.mu, 1.1 * maps.mu]),
            np.repeat(maps.mu_finger, 2),
        ),
        probability=np.array([0.95, 0.05]),
        smoothing=MEASURED_CONTACT,
        dataset=recorded.dataset.name,
        fingerprint="0",
        method="truth",
        seed=0,
    )


@pytest.fixture(scope="module")
def result(recorded, truth):
    return compare(recorded.dataset, truth, seed=1)


def test_the_truth_comes_near_the_noise_floor_and_far_below_the_baselines(result):
    assert {role: totals.pushes for role, totals in result.totals.items()} == {"fit": 6, "heldout": 4}
    for totals in result.totals.values():
        assert totals.model.final_add < 4 * result.floor.add
        assert totals.model.final_add < 0.3 * totals.uniform.final_add < 0.5 * totals.resting.final_add
        assert totals.model.fit > 95
        assert totals.model.force_share < 0.1
    assert result.floor.source == "declared noise"


def test_the_truth_leaves_no_pattern(result):
    assert result.significant == ()
    assert {pattern.quantity for pattern in result.structure} == {"motion", "force", "delay"}


def test_totals_are_means_of_pushes(result):
    group = [push for push in result.pushes if push.role == "heldout"]
    expected = np.mean([push.errors.mean_add for push in group])
    assert result.totals["heldout"].model.mean_add == pytest.approx(expected)
    assert result.totals["heldout"].uniform.final_add == pytest.approx(
        np.mean([push.uniform.final_add for push in group])
    )


def test_json_holds_every_number_and_is_json(result):
    document = json.loads(json.dumps(plain(result.to_json()), allow_nan=False))
    assert {
        "label", "dataset", "learnt_from", "totals", "noise_floor", "pushes", "structure",
        "structure_testable", "correlations", "seed",
    } == set(document)  # fmt: skip
    assert [push["trial"] for push in document["pushes"]] == [push.trial for push in result.pushes]
    assert document["pushes"][0]["model"]["final_add"] == result.pushes[0].errors.final_add
    assert document["pushes"][0]["no_motion"]["force"] is None


def test_the_same_seed_gives_the_same_numbers(recorded, truth, result):
    again = compare(recorded.dataset, truth, seed=1)
    assert json.dumps(plain(again.to_json())) == json.dumps(plain(result.to_json()))


def test_predictions_come_from_one_place(recorded, truth, monkeypatch):
    """A model that adds 1 N along x to every force shows up as a drift of the force, and in nothing else."""
    predicted_motion = prediction.predicted_motion

    def stronger(belief, observations):
        return tuple(
            replace(motion, forces=motion.forces + np.array([1.0, 0.0]))
            for motion in predicted_motion(belief, observations)
        )

    monkeypatch.setattr(prediction, "predicted_motion", stronger)
    found = compare(recorded.dataset, truth)
    first = found.structure[0]
    assert (first.quantity, first.factor, first.strongest) == ("force", "table_drift", "along table x")
    assert first.size * found.force.scale[0] == pytest.approx(-1.0, rel=0.1)
    assert found.totals["fit"].model.final_add < 4 * found.floor.add


def test_pushes_known_by_their_ends_are_compared_there(recorded, truth):
    dataset = recorded.dataset
    ends = replace(
        dataset,
        trials=tuple(
            replace(
                trial,
                object_pose=Channel(trial.object_pose.time[[0, -1]], trial.object_pose.values[[0, -1]]),
                ft_wrench=None,
            )
            for trial in dataset.trials
        ),
    )
    found = compare(ends, truth)
    assert all(push.ends_only for push in found.pushes)
    assert found.correlations is None and found.force is None
    assert np.isnan(found.totals["fit"].model.fit)
    assert found.totals["fit"].model.final_add < 5 * found.floor.add
    assert {"phase", "time", "delay"}.isdisjoint(pattern.factor for pattern in found.structure)
    assert len(found.motion.at) == len(found.pushes)


def test_one_push_is_compared_without_tests_that_need_more(recorded, truth):
    single = replace(recorded.dataset, trials=recorded.dataset.trials[:1])
    found = compare(single, truth)
    assert len(found.pushes) == 1 and not found.testable and found.significant == ()


def test_pushes_that_the_belief_did_not_learn_from_are_told(result):
    assert not result.mostly_unseen
    heldout = tuple(push for push in result.pushes if push.role == "heldout")
    assert replace(result, pushes=heldout).mostly_unseen
    assert replace(result, learnt_from="another").mostly_unseen


@pytest.fixture(scope="module")
def learned(recorded):
    return identify(recorded.dataset, hypotheses=2, friction_laws=False)


def test_predictions_that_come_with_a_belief_are_used_for_their_own_pushes_alone(recorded, learned):
    dataset = recorded.dataset
    assert compare(dataset, learned).pushes is learned.pushes
    others = replace(dataset, trials=dataset.trials[1:], fingerprint="another")
    again = compare(others, learned)
    assert [push.trial for push in again.pushes] == [trial.name for trial in others.trials]
    one, other = (json.dumps(plain(found.to_json())) for found in (again, compare(others, learned.belief)))
    assert one == other


@pytest.mark.parametrize("changed", ["poses", "forces", "noise", "table"])
def test_predictions_that_come_with_a_belief_are_not_used_for_changed_pushes(recorded, learned, changed):
    dataset = recorded.dataset
    same = replace(dataset, trials=tuple(map(replace, dataset.trials)))
    assert compare(same, learned).pushes is learned.pushes
    if changed in ("poses", "forces"):
        name = {"poses": "object_pose", "forces": "ft_wrench"}[changed]
        seen = getattr(dataset.trials[0], name)
        moved = Channel(seen.time, seen.values + np.linspace(0.0, 0.02, len(seen.time))[:, None])
        other = replace(dataset, trials=(replace(dataset.trials[0], **{name: moved}), *dataset.trials[1:]))
    elif changed == "noise":
        other = replace(dataset, noise=replace(dataset.noise, position=2e-3))
    else:
        other = replace(dataset, table=Table("round", (0.0, 0.0), radius=5.0))
    one, two = (json.dumps(plain(compare(other, what).to_json())) for what in (learned, learned.belief))
    assert one == two
    assert compare(other, learned).pushes is not learned.pushes


def test_another_object_is_refused(recorded, truth):
    with pytest.raises(BeliefError, match="finger"):
        compare(replace(recorded.dataset, finger_radius=0.02), truth)


@pytest.mark.parametrize(
    ("name", "quantity", "factors"),
    [
        ("public-none", None, ()),
        ("public-tilt", "force", ("table_drift",)),
        ("public-viscous", "force", ("speed",)),
        ("public-latency", "delay", ("delay",)),
    ],
)
def test_hidden_effects_show_where_they_should(shared_data, name, quantity, factors):
    dataset = read_dataset(shared_data / "effects" / name)
    learned = identify(dataset, hypotheses=4, prior_settings=PriorSettings(), friction_laws=False)
    found = compare(dataset, learned.belief)
    named = [(pattern.quantity, pattern.factor) for pattern in found.significant]
    if quantity is None:
        assert named == []
    else:
        assert named[0] in [(quantity, factor) for factor in factors]
