"""The monitor is quiet while the model holds, and loud on a table that is not level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from moving_blocks import H, Player, block, block_belief, moved, seen, table_pushes
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from slipmap.diagrams.systems.model_monitor import LEVEL, Judged, ModelMonitor
from slipmap.diagrams.systems.multiverse_slider import Universes, placed
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.error_model import ErrorModel, sensor_noise
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import predict
from slipmap.models.inference.push_misfit import pose_noise, resting_misfit, resting_region
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import Noise
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.measurements.trial import Channel
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Push

NOISE = np.array([5e-4, 5e-4, 4e-3])
SENSORS = Noise(position=5e-4, angle=4e-3, tip=None, force=None)
PERIOD = 0.1
LASTS = 4
"""Looks from the beginning of a push to that of the next; its record is complete at the last but one."""


@dataclass(frozen=True)
class Told:
    """One push: the hypotheses after it, None without a belief, and what was recorded of it."""

    universes: Universes | None
    trial: Trial

    @property
    def start(self) -> FloatArray:
        return self.trial.object_pose.values[0]

    @property
    def end(self) -> FloatArray:
        return self.trial.object_pose.values[-1]

    def ending_at(self, end: FloatArray) -> Told:
        poses = self.trial.object_pose
        return replace(self, trial=replace(self.trial, object_pose=replace(poses, values=[self.start, end])))


def recorded(push: Push, end: FloatArray) -> Trial:
    """A push as a tracker records it that sees the object only before and after."""
    time = push.h * np.arange(len(push.tip))
    return Trial(
        "trial", "fit", Channel(time[[0, -1]], [push.start_pose, end]), Channel(time, push.tip), None
    )


@lru_cache
def pushes_seen(effect: str, values: tuple[float, ...], count: int, seed: int) -> tuple[Told, ...]:
    rng = np.random.default_rng(seed)
    told = []
    belief = block_belief()
    for push in table_pushes(count, seed):
        true = moved(push, effects_named([effect]) if effect else (), values)[-1]
        start, end = (pose + NOISE * rng.normal(size=3) for pose in (push.start_pose, true))
        told.append(Told(placed(belief, H, start), recorded(replace(push, start_pose=start), end)))
    return tuple(told)


PLAYED: list[Told] = []
BEGUN = {"pushes": 0}


def look(time: float) -> tuple[int, int]:
    """Number of the push and of the look at it."""
    push, row = divmod(round(time / PERIOD), LASTS)
    return min(push, len(PLAYED) - 1), row


def universes_at(time: float) -> Any:
    """As a `MultiverseSlider` counts them; `BEGUN` pushes follow as soon as one is recorded."""
    push, row = look(time)
    now = PLAYED[push].universes
    if now is None:
        return None
    now = replace(now, order=push)
    for more in range(1, 1 + BEGUN["pushes"] * (row >= LASTS - 2)):
        now = placed(now.belief, H, PLAYED[push].end, order=push + more, before=now)
    return now


def records_at(time: float) -> tuple[Trial, ...]:
    push, row = look(time)
    return tuple(told.trial for told in PLAYED[: push + (row >= LASTS - 2)])


@pytest.fixture(scope="module")
def diagram() -> Diagram:
    builder = DiagramBuilder()
    values = {
        "universes": universes_at,
        "object_pose": lambda time: seen(PLAYED[look(time)[0]].end),
        "trials": records_at,
    }
    player = builder.AddSystem(Player({}, values))
    monitor = builder.AddNamedSystem("model_monitor", ModelMonitor(SENSORS, PERIOD))
    for port in values:
        builder.Connect(player.GetOutputPort(port), monitor.GetInputPort(port))
    return builder.Build()


@dataclass(frozen=True)
class After:
    """What the monitor says after a push."""

    evidence: float
    alarm: bool
    misfit: float
    residual: FloatArray
    judged: int
    pushes: tuple[Judged, ...] = ()


def watched(diagram: Diagram, told: tuple[Told, ...]) -> list[After]:
    PLAYED[:] = told
    simulator = Simulator(diagram)
    monitor = diagram.GetSubsystemByName("model_monitor")
    rows = []
    for b in range(len(told)):
        simulator.AdvanceTo(PERIOD * ((b + 1) * LASTS - 0.5))
        context: Context = monitor.GetMyContextFromRoot(simulator.get_context())
        names = ("evidence", "misfit", "residual", "alarm", "watch")
        evidence, misfit, residual, alarm, watch = (monitor.GetOutputPort(n).Eval(context) for n in names)
        rows.append(
            After(
                float(evidence[0]), alarm, float(misfit[0]), residual.copy(), len(watch.judged), watch.judged
            )
        )
    return rows


def test_quiet_on_pushes_as_believed(diagram: Diagram) -> None:
    rows = watched(diagram, pushes_seen("", (), 20, 7))
    assert [row.judged for row in rows] == list(range(1, 21))
    assert not any(row.alarm for row in rows)
    assert max(row.evidence for row in rows) < 0.2 / LEVEL


def test_loud_on_a_tilted_table_and_calm_again(diagram: Diagram) -> None:
    """The evidence for an alarm comes within a few pushes, the alarm stays for one push as usual, and goes in
    the end."""
    tilted = pushes_seen("table_tilt", (0.05, -0.06), 8, 7)
    rows = watched(diagram, tilted)
    first = next(b for b, row in enumerate(rows) if row.evidence >= 1.0 / LEVEL)
    assert 2 <= first <= 4
    rows = watched(diagram, tilted[: first + 1] + pushes_seen("", (), 20, 7))
    alarms = [row.alarm for row in rows]
    assert alarms[first : first + 2] == [True, True]
    assert not alarms[-1]
    released = alarms.index(False, first)
    assert all(row.evidence > 1.0 for row in rows[first:released])
    assert rows[released].evidence <= 1.0


def test_a_push_is_judged_by_its_own_hypotheses_though_the_next_has_begun(
    diagram: Diagram, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = pushes_seen("", (), 3, 7)
    expected = watched(diagram, told)[-1].pushes
    monkeypatch.setitem(BEGUN, "pushes", 1)
    assert watched(diagram, told)[-1].pushes == expected
    assert all(push.error > 1e-5 for push in expected)


def test_a_push_whose_hypotheses_are_gone_is_not_judged(
    diagram: Diagram, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(BEGUN, "pushes", 2)
    assert watched(diagram, pushes_seen("", (), 3, 7))[-1].pushes == ()


def test_an_angle_that_was_held_is_not_judged(diagram: Diagram) -> None:
    """A round object turns, and nobody sees it; where it goes still counts."""
    turned = pushes_seen("", (), 6, 7)
    held = [told.ending_at(np.append(told.end[:2], told.start[2])) for told in turned]
    assert max(abs(told.end[2] - told.start[2]) for told in turned) > 0.1
    rows = watched(diagram, tuple(held))
    assert not any(row.alarm for row in rows) and max(row.evidence for row in rows) < 0.2 / LEVEL
    shifted = [told.ending_at(told.end + np.array([0.03, 0.03, 0.0])) for told in held]
    assert any(row.alarm for row in watched(diagram, tuple(shifted)))


@lru_cache
def pushes_felt(stronger: float) -> tuple[Told, ...]:
    """Three pushes as believed, but for a force that is so many times as strong."""
    belief = block_belief()
    pushes = table_pushes(3, 7)
    dataset = record_pushes(belief.slider, belief.maps[3:], pushes, np.random.default_rng(0), mass=1.0)
    told = []
    for trial, push in zip(dataset.trials, pushes, strict=True):
        assert trial.ft_wrench is not None
        felt = Channel(trial.ft_wrench.time, stronger * trial.ft_wrench.values)
        told.append(Told(placed(belief, H, push.start_pose), replace(trial, ft_wrench=felt)))
    return tuple(told)


@pytest.mark.parametrize(("stronger", "alarm"), [(1.05, False), (1.6, True)])
def test_a_force_that_no_hypothesis_tells_counts(diagram: Diagram, stronger: float, alarm: bool) -> None:
    rows = watched(diagram, pushes_felt(stronger))
    assert rows[-1].alarm == alarm
    assert (rows[-1].evidence > 1.0 / LEVEL) == alarm


def test_outputs_are_those_of_the_last_push(diagram: Diagram) -> None:
    (told,) = pushes_seen("table_tilt", (0.05, -0.06), 1, 9)
    (row,) = watched(diagram, (told,))
    assert told.universes is not None
    assert np.allclose(row.residual, told.end - told.universes.mean_pose)
    belief, (push,) = told.universes.belief, table_pushes(1, 9)
    poses = belief.slider.rollout(belief.maps, [replace(push, start_pose=told.start)]).end[:, 0, :3]
    error = ErrorModel(pose_noise(5e-4, 4e-3), 0.03, 0.0)
    expected, _ = resting_misfit(told.start, told.end, poses, belief.probability, error, block())
    assert row.misfit == pytest.approx(expected, rel=0.02)  # the recorded track is smoothed


def test_a_push_is_judged_by_its_recording_as_predict_does(diagram: Diagram) -> None:
    """Hypotheses in motion may have been struck by a finger that they heard of late."""
    belief = block_belief()
    pushes = [replace(push, pose_times=None) for push in table_pushes(2, 7)]
    dataset = record_pushes(belief.slider, belief.maps[3:], pushes, np.random.default_rng(0), heldout=1)
    told = [
        Told(placed(belief, H, push.start_pose), trial)
        for push, trial in zip(pushes, dataset.trials, strict=True)
    ]
    judged = watched(diagram, tuple(told))[-1].pushes
    predicted = predict(belief, dataset)
    assert [push.error for push in judged] == pytest.approx([push.final_add for push in predicted], rel=1e-9)
    assert min(push.error for push in judged) > 1e-5
    astray = []
    for one in told:
        assert one.universes is not None
        states = one.universes.states + np.eye(1, one.universes.states.shape[1]) * 12.0
        astray.append(replace(one, universes=replace(one.universes, states=states)))
    assert watched(diagram, tuple(astray))[-1].pushes == judged


def test_a_push_that_no_belief_predicted_does_not_count(diagram: Diagram) -> None:
    told = pushes_seen("", (), 2, 7)
    rows = watched(diagram, (replace(told[0], universes=None), told[1]))
    assert [row.judged for row in rows] == [0, 1]
    assert rows[0].evidence == 1.0
    assert np.isnan(rows[0].misfit)
    assert np.isnan(rows[0].residual).all()


def test_one_push_far_outside_its_region_is_told_at_once(diagram: Diagram) -> None:
    """Three such pushes are what evidence takes; pushes as believed take the alarm back."""
    usual = pushes_seen("", (), 8, 7)
    off = usual[1].ending_at(usual[1].end + np.array([0.02, 0.0, 0.0]))
    rows = watched(diagram, (usual[0], off, *usual[2:]))
    assert [row.alarm for row in rows[:2]] == [False, True] and not rows[-1].alarm
    assert max(row.evidence for row in rows) < 1.0 / LEVEL
    first, wrong, *_, last = rows[-1].pushes
    assert [push.surprising for push in rows[-1].pushes[:3]] == [False, True, False]
    assert wrong.error == pytest.approx(0.02, rel=0.2) and wrong.allowed < wrong.error / 2
    assert wrong.outside and wrong.criterion == "outside its 99 % region"
    assert not any(push.outside for push in (first, last))
    assert first.error < first.allowed and last.error < last.allowed


def test_the_region_is_that_of_predictions_where_the_model_has_learnt_its_errors() -> None:
    """A model that was off by a tenth of the way is off by that again, and it is no surprise."""
    belief = block_belief()
    likeliest = belief.maps[:1]
    push = replace(table_pushes(1, 7)[0], pose_times=None)
    dataset = record_pushes(belief.slider, likeliest, [push], np.random.default_rng(0), heldout=1)
    (observation,) = observe_all(dataset)
    poses = belief.slider.rollout(belief.maps, [observation.push]).end[:, 0, :3]
    error = ErrorModel(sensor_noise(dataset), 0.03, 0.0)
    elsewhere = observation.poses[-1] + np.array([0.02, 0.0, 0.0])
    assert not resting_region(observation, poses, belief, error, error.noise).holds(elsewhere)
    learned = replace(belief, settings={**belief.settings, "end_errors": [0.3, 0.3]})
    region = resting_region(observation, poses, learned, error, error.noise)
    assert region.holds(elsewhere)
    (predicted,) = predict(learned, dataset)
    assert predicted.end_region is not None
    np.testing.assert_allclose(region.covariances, predicted.end_region.covariances, rtol=1e-9)
    np.testing.assert_allclose(region.middle, predicted.end_region.middle, atol=1e-12)
    # Also where the live hypotheses set out from another look at the start than the mean of them all.
    start = observation.push.start_pose + np.array([1e-3, -1e-3, 8e-3])
    others = belief.slider.rollout(belief.maps, [replace(observation.push, start_pose=start)]).end[:, 0, :3]
    live = resting_region(observation, others, learned, error, error.noise)
    np.testing.assert_allclose(live.middle, predicted.end_region.middle, atol=1e-12)
    # Of an unseen angle, the end alone is uncertain.
    unseen = ErrorModel(pose_noise(error.noise.position, 1.0), 0.03, 0.0)
    held = resting_region(observation, poses, learned, unseen, error.noise)
    np.testing.assert_allclose(held.middle, region.middle, atol=1e-12)
    assert held.covariances[0, 2, 2] > region.covariances[0, 2, 2] + 0.5


def test_noise_must_be_known() -> None:
    with pytest.raises(ValueError, match="position and angle must be given"):
        ModelMonitor(Noise())
