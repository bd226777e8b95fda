"""Algorithm 1 on recorded pushes: what it learns, what its belief says, what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.inference.belief import Belief
from slipmap.models.inference.paper_method import (
    algorithm_1,
    identify_by_algorithm_1,
    observe_steps,
    soft_max,
)
from slipmap.models.inference.prediction import predict
from slipmap.models.measurements import Channel, DatasetError, read_dataset


@pytest.fixture(scope="module")
def belief(recorded) -> Belief:
    return identify_by_algorithm_1(recorded.dataset, hypotheses=4, seed=3)


def test_pushes_held_out_are_predicted_better_than_by_the_uniform_object(recorded, belief):
    pushes = [push for push in predict(belief, recorded.dataset) if push.role == "heldout"]
    assert np.mean([push.final_add for push in pushes]) < 0.7 * np.mean([push.uniform_add for push in pushes])


def test_the_loss_falls_from_pass_to_pass(recorded, belief):
    settings = belief.settings
    names = ("mass_max", "mu_max", "mu_finger", "learning_rate", "temperature")
    _, first, _ = algorithm_1(
        recorded.slider,
        [observe_steps(trial) for trial in recorded.dataset.fit_trials],
        hypotheses=4,
        **{name: settings[name] for name in names},
    )
    assert np.all(np.array(settings["loss"]) < 0.8 * first)


def test_the_belief_says_how_it_came_about_and_survives_a_file(recorded, belief, tmp_path):
    assert belief.method == "paper"
    assert belief.seed == 3
    assert belief.fingerprint == recorded.dataset.fingerprint
    assert belief.settings["fit_trials"] == [trial.name for trial in recorded.dataset.fit_trials]
    loss, temperature = np.array(belief.settings["loss"]), belief.settings["temperature"]
    np.testing.assert_allclose(soft_max(loss, temperature), belief.probability)
    assert len(belief) == 4
    assert np.all(belief.maps.mass <= belief.settings["mass_max"] * (1 + 1e-12))
    belief.save(tmp_path / "belief.npz")
    loaded = Belief.load(tmp_path / "belief.npz")
    assert json.dumps(loaded.settings) == json.dumps(belief.settings)
    np.testing.assert_array_equal(loaded.maps.mu, belief.maps.mu)


def test_the_temperature_is_a_hundredth_of_the_loss_of_an_object_that_never_moves(recorded, belief):
    loss = 0.0
    x, y = recorded.slider.grid.centers.T
    for trial in recorded.dataset.fit_trials:
        cells = np.array(
            [
                [px + np.cos(a) * x - np.sin(a) * y, py + np.sin(a) * x + np.cos(a) * y, a + 0 * x]
                for px, py, a in observe_steps(trial).poses[1:]
            ]
        )
        loss += sum(np.linalg.norm(now - cells[0]) for now in cells[1:])
    assert belief.settings["temperature"] == pytest.approx(0.01 * loss)


def test_recorded_trials_are_cut_into_equal_steps(recorded):
    trial = recorded.dataset.fit_trials[0]
    push = observe_steps(trial)
    times = trial.start + push.dt * np.arange(len(push.poses))
    assert times[-1] == pytest.approx(trial.object_pose.time[-1])
    np.testing.assert_allclose(push.poses, trial.object_pose.at(times), atol=1e-12)
    # The smoothed finger stays within a few standard deviations of its record (0.05 mm).
    np.testing.assert_allclose(push.tip, trial.tip_pose.at(times), atol=5e-4)
    few = Channel(trial.object_pose.time[::40], trial.object_pose.values[::40])
    assert len(observe_steps(replace(trial, object_pose=few)).poses) == len(few.time)


@pytest.mark.parametrize(("mass", "taken_for"), [(165.0, 165.0), (None, 1.0)])
def test_masses_scale_with_the_known_mass_or_a_kilogram_and_frictions_stay(recorded, mass, taken_for):
    few = recorded.dataset.with_fit_pushes(2)
    known = identify_by_algorithm_1(few, hypotheses=2)
    other = identify_by_algorithm_1(replace(few, mass=mass), hypotheses=2)
    assert other.settings["mass_max"] == pytest.approx(2 * taken_for / len(few.grid))
    np.testing.assert_allclose(other.maps.mu, known.maps.mu, rtol=1e-4)
    np.testing.assert_allclose(other.maps.mass, known.maps.mass * taken_for / few.mass, rtol=1e-4)


def test_trials_with_ends_only_are_left_out_and_refused_alone(recorded):
    ends = [_ends_only(trial) for trial in recorded.dataset.fit_trials]
    mixed = replace(recorded.dataset, trials=(ends[0], *recorded.dataset.fit_trials[1:3]))
    belief = identify_by_algorithm_1(mixed, hypotheses=2)
    assert belief.settings["left_out"] == [ends[0].name]
    assert belief.settings["fit_trials"] == [trial.name for trial in mixed.trials[1:]]
    with pytest.raises(DatasetError, match="three poses or more"):
        identify_by_algorithm_1(replace(recorded.dataset, trials=tuple(ends)), hypotheses=2)


def test_pushes_that_move_nothing_are_refused(recorded):
    trial = recorded.dataset.fit_trials[0]
    still = replace(trial, object_pose=Channel(trial.object_pose.time, 0 * trial.object_pose.values))
    with pytest.raises(DatasetError, match="no fit push moves the object"):
        identify_by_algorithm_1(replace(recorded.dataset, trials=(still,)), hypotheses=2)


def test_progress_counts_every_push_of_every_pass(recorded):
    calls = []
    few = recorded.dataset.with_fit_pushes(2)
    belief = identify_by_algorithm_1(few, hypotheses=2, progress=lambda *call: calls.append(call))
    total = 2 * belief.settings["epochs"]
    assert calls == [("Algorithm 1", done, total) for done in range(1, total + 1)]


def test_five_pushes_of_a_165_kg_hammer_teach_more_than_a_uniform_hammer_knows(shared_data):
    dataset = read_dataset(shared_data / "bullet" / "hammer_p0")
    belief = identify_by_algorithm_1(dataset.with_fit_pushes(5), hypotheses=4)
    pushes = [push for push in predict(belief, dataset) if push.role == "heldout"]
    assert np.mean([push.final_add for push in pushes]) < 0.4 * np.mean([push.uniform_add for push in pushes])


def _ends_only(trial):
    pose = trial.object_pose
    return replace(trial, object_pose=Channel(pose.time[[0, -1]], pose.values[[0, -1]]))
