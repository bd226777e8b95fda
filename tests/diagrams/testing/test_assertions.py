"""Assertions on what a cell was told and what was learned in it: they hold, and they fail with numbers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.diagrams.hardware.guard import GuardSettings
from slipmap.diagrams.loops.exploration_run import DOING, ROUND
from slipmap.diagrams.station.arm import HOME
from slipmap.diagrams.station.scenario import Scenario, ScenarioError
from slipmap.diagrams.systems.diagnosis import Finding, Repair
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.diagrams.testing import (
    CommandLog,
    Fault,
    Faults,
    assert_adopts,
    assert_alarm,
    assert_better_than_uniform,
    assert_held,
    assert_limits_kept,
    assert_names,
    assert_predicts,
    assert_quiet,
    open_cell,
)
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.results import Identification
from slipmap.models.robots import SPEED_LIMITS
from tests.made_predictions import made_prediction


def log(share: float, joint: int = 6, n: int = 50) -> CommandLog:
    """A joint turns at a share of its largest speed; the last one moves the finger by little."""
    times = 0.005 * np.arange(n)
    q = np.tile(HOME, (n, 1))
    q[:, joint] += share * SPEED_LIMITS[joint] * times
    return CommandLog.of(np.column_stack([times, q]))


def test_speeds_are_told_from_stamps_whatever_is_missing():
    full = log(0.5)
    sparse = CommandLog.of(np.column_stack([full.times, full.q])[[0, 1, 5, 6, 20, 20, 30]])
    assert len(sparse.times) == 6
    np.testing.assert_allclose(sparse.joint_speeds[:, 6], 0.5 * SPEED_LIMITS[6], rtol=1e-9)


def test_limits_of_joints_and_finger():
    assert_limits_kept([log(0.99)], GuardSettings())
    with pytest.raises(AssertionError, match=r"iiwa_joint_7 was commanded to 1\.01 times"):
        assert_limits_kept([log(0.5), log(1.01)], GuardSettings())
    fast = log(0.9, joint=0)
    assert fast.tip_speeds.max() == pytest.approx(fast.tip_speeds.min(), rel=1e-3)  # on a circle
    with pytest.raises(AssertionError, match="the finger was commanded to"):
        assert_limits_kept([fast], GuardSettings(tip_speed=0.9 * fast.tip_speeds.max()))
    with pytest.raises(AssertionError, match="no commands"):
        assert_limits_kept([CommandLog.of(np.zeros((0, 8)))], GuardSettings())


def test_commands_that_contradict_others_are_told():
    full = log(0.5)
    rows = np.column_stack([full.times, full.q])
    other = rows.copy()
    other[20, 7] += 1.0
    for contradicting in (np.vstack([rows[:21], other[20:]]), rows[[*range(20), 10, *range(20, 50)]]):
        with pytest.raises(AssertionError, match=r"a command with the stamp 0\.\d+ s came after another"):
            assert_limits_kept([CommandLog.of(contradicting)], GuardSettings())


def learned(*errors: float) -> Identification:
    pushes = [
        made_prediction(f"trials/{k:03d}.json", "heldout", final_add=error, uniform_add=0.02)
        for k, error in enumerate(errors)
    ]
    return Identification(SimpleNamespace(spec=Belief), tuple(pushes), (), 0.0)  # type: ignore[arg-type]


def test_predictions_are_judged_by_the_worst_push():
    assert_predicts(learned(0.001, 0.004), within=0.005)
    with pytest.raises(AssertionError, match=r"ended 6\.0 mm .*; 5 mm are allowed[^$]*trials/001"):
        assert_predicts(learned(0.001, 0.006), within=0.005)
    with pytest.raises(AssertionError, match="no push has the role fit"):
        assert_predicts(learned(0.001), within=0.005, role="fit")


def watched(*evidence: float) -> Watch:
    usual = 0.01, 0.02, False
    judged = [Judged(k, 3.0, 0.01, value, value >= 100, *usual) for k, value in enumerate(evidence)]
    return Watch(len(judged), np.zeros(3), tuple(judged))


def test_a_quiet_monitor_must_have_had_something_to_judge():
    assert_quiet(watched(1.0, 2.0, 4.0))
    with pytest.raises(AssertionError, match="only 2 pushes were judged"):
        assert_quiet(watched(1.0, 2.0))
    with pytest.raises(AssertionError, match=r"push 002: misfit .*, evidence 150"):
        assert_quiet(watched(1.0, 20.0, 150.0))
    assert_alarm(watched(1.0, 20.0, 150.0, 50.0))
    far = Judged(3, 2.7, 0.021, 3.36, True, 17.3e-3, 10.5e-3, True, outside=True)
    by_region = Watch(4, np.zeros(3), (*watched(1.0, 1.0, 1.0).judged, far))
    with pytest.raises(AssertionError) as failed:
        assert_quiet(by_region)
    assert "push 000: misfit 3.0, evidence 1 of 100\n" in str(failed.value)
    assert (
        "push 003: misfit 2.7, evidence 3.36 of 100;"
        " ALARM: ended 17.3 mm off, 10.5 mm allowed; outside its 99 % region" in str(failed.value)
    )
    with pytest.raises(AssertionError, match=r"ALARM: ended 10\.0 mm off.*; evidence 150, at least 100"):
        assert_quiet(watched(1.0, 20.0, 150.0))
    with pytest.raises(AssertionError, match="no alarm"):
        assert_alarm(watched(1.0, 20.0, 99.0))


def test_an_effect_must_have_been_adopted_on_the_way():
    tilt, both = ("table_tilt",), ("table_tilt", "tether")
    adopted = Finding(5, "effect", "The table is tilted.", tilt, "adopts")
    assert_adopts(SimpleNamespace(repair=Repair(5, tilt, findings=(adopted,))), "table_tilt")
    for effects, findings in ((tilt, ()), (both, (replace(adopted, effects=both),))):
        run = SimpleNamespace(repair=Repair(5, effects, findings=findings, given=tilt))
        with pytest.raises(AssertionError, match="table_tilt was in the model from the start"):
            assert_adopts(run, "table_tilt")
        if findings:
            assert_adopts(run, "tether")
    with pytest.raises(AssertionError, match="table_tilt is not in the model at the end"):
        assert_adopts(SimpleNamespace(repair=Repair(5, (), findings=(adopted,))), "table_tilt")


def test_planned_faults_begin_once_when_the_robot_gets_there():
    ordered: list[Fault] = []
    faults = Faults(_way=SimpleNamespace(order=ordered.append))
    stop = Fault("status", "stop")
    faults.when("pushing", stop, push=2)
    for stage, done in (
        ("exploring: pushing", 0),
        ("exploring: looking at the object", 1),
        ("exploring: pushing", 1),
        ("exploring: pushing", 1),
    ):
        assert not ordered or stage.endswith("pushing")
        faults.look(stage, done)
    assert ordered == faults.happened == [stop]
    with pytest.raises(ValueError, match="looking, choosing"):
        faults.when("dancing", stop)
    with pytest.raises(ValueError, match="faults: push must be a whole number of at least 1, got 0"):
        faults.when("pushing", stop, push=0)
    with pytest.raises(RuntimeError, match="nothing is running"):
        Faults().now(stop)


def test_planned_faults_must_spoil_something():
    begun: list[Fault] = []
    faults = Faults(_way=SimpleNamespace(order=lambda fault: None, begun=begun))
    soon, late = Fault("status", "stop", after=0.1), Fault("pictures", "stop", after=1e4)
    for fault in (soon, late):
        faults.when("pushing", fault)
    faults.look("exploring: pushing", 0)
    begun.append(soon)
    with pytest.raises(AssertionError) as failed:
        faults.require_started()
    assert "pictures stop while pushing, push 1, 10000 s later" in str(failed.value)
    assert "status" not in str(failed.value)
    begun.append(late)
    faults.require_started()


def test_a_remark_on_the_object_does_not_hide_what_the_robot_does():
    ordered: list[Fault] = []
    faults = Faults(_way=SimpleNamespace(order=ordered.append))
    stop = Fault("status", "stop")
    faults.when("pushing", stop)
    for doing in (DOING["looking"], DOING["pushing"]):
        assert not ordered
        faults.look(f"exploring: {doing}; {ROUND}", 0)
    assert ordered == [stop]


def test_a_fault_that_never_starts_fails_the_test(tmp_path):
    with (
        pytest.raises(AssertionError, match="did not start: status stop while pushing, push 5"),
        open_cell("lockstep", tmp_path) as cell,
    ):
        cell.faults.when("pushing", Fault("status", "stop"), push=5)
    with (  # what failed before says more
        pytest.raises(ZeroDivisionError),
        open_cell("lockstep", tmp_path) as cell,
    ):
        cell.faults.when("pushing", Fault("status", "stop"))
        raise ZeroDivisionError


def test_faults_are_refused_where_nothing_can_inject_them(tmp_path, monkeypatch):
    recorder = SimpleNamespace(close=lambda: None)
    monkeypatch.setattr("slipmap.diagrams.testing.cell.CommandRecorder", lambda url, path: recorder)
    with open_cell("udpm://239.255.76.67:7667?ttl=0", tmp_path) as cell:
        for plan in (lambda fault: cell.faults.when("choosing", fault), cell.faults.now):
            with pytest.raises(RuntimeError, match="open it with faulty=True"):
                plan(Fault("status", "stop"))


def test_a_cell_opened_again_keeps_what_was_recorded(tmp_path):
    folder = str(tmp_path / "recordings")
    for number, what in enumerate(["exploration", "pregrasp", "exploration"], 1):
        with open_cell("lockstep", folder) as cell:
            assert cell._next_folder(what) == tmp_path / "recordings" / f"{number}-{what}"


def test_a_cell_that_does_not_exist_is_refused(tmp_path):
    for where in ("lockstp", "simulated"):
        with (
            pytest.raises(ValueError, match=f"must be twin, lockstep, or an LCM address .* got '{where}'"),
            open_cell(where, tmp_path),
        ):
            pass


def test_assertions_say_what_they_take():
    with pytest.raises(ValueError, match="role must be one of heldout, fit, got 'held-out'"):
        assert_predicts(learned(0.001), within=0.01, role="held-out")
    with pytest.raises(ValueError, match="within must lie between 0 and 1 m, got 10"):
        assert_predicts(learned(0.001), within=10)
    with pytest.raises(TypeError, match="watch must be a Watch"):
        assert_alarm(learned(0.001))
    with pytest.raises(TypeError, match=r"a list of logs, such as cell\.commands"):
        assert_limits_kept(log(0.5), GuardSettings())
    with pytest.raises(TypeError, match=r"guard must be a GuardSettings, such as cell\.scenario\.guard"):
        assert_limits_kept([log(0.5)], Scenario())
    with pytest.raises(AssertionError, match="no push has the role heldout"):
        assert_better_than_uniform(learned())
    with pytest.raises(ValueError, match="within must be positive and finite, got 1 mm m"):
        assert_predicts(learned(0.001), within="1 mm")
    with pytest.raises(TypeError, match=r"diagnosis must be a Diagnosis, such as slipmap\.diagnose"):
        assert_names(learned(0.001), "tether")
    with pytest.raises(TypeError, match=r"run must be an ExplorationRun, .*; got a Identification"):
        assert_adopts(learned(0.001), "tether")
    with pytest.raises(TypeError, match=r"run must be a PregraspRun, .*; got a Identification"):
        assert_held(learned(0.001))


@pytest.mark.parametrize("wrong", [0, -1, np.nan])
def test_assertions_that_would_hold_whatever_happened_are_refused(wrong):
    with pytest.raises(ValueError, match="assert_better_than_uniform: times must be positive"):
        assert_better_than_uniform(learned(0.05), times=wrong)
    with pytest.raises(ValueError, match="assert_quiet: judged must be a whole number of at least 1"):
        assert_quiet(watched(), judged=wrong)


def test_a_failed_assertion_names_what_was_asked_for():
    with pytest.raises(AssertionError, match=r"that of a uniform object 20\.0 mm; .* 6 times as large"):
        assert_better_than_uniform(learned(0.004), times=6)
    with pytest.raises(AssertionError, match=r"ended 4\.0 mm from its prediction; 0\.001 mm are allowed"):
        assert_predicts(learned(0.004), within=1e-6)


@pytest.mark.parametrize("kind", ["delay", "jump"])
def test_a_fault_without_its_amount_is_refused(kind):
    with pytest.raises(ValueError, match=f"status {kind}: changes nothing; give its amount in"):
        Fault("status", kind)


def test_a_cell_with_a_wrong_scenario_is_refused_when_it_is_opened(tmp_path):
    scenario = Scenario()
    scenario.object.nmae = "box"
    for wrong, error in ((scenario, ScenarioError), ("cell.yaml", TypeError)):
        with pytest.raises(error), open_cell("lockstep", tmp_path / "cell", wrong):
            pass
    assert not (tmp_path / "cell").exists()
