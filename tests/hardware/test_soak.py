"""What a soak draws, and that it sees a push that was lost."""

from __future__ import annotations

import numpy as np
from soak import PASSING, STOPPING, Account, checked, drawn_faults
from soak_session import Task

from slipmap.models.measurements import write_dataset
from tests.diagrams.hidden_effects import tilted_pushes


def test_faults_are_drawn_by_the_seed_and_none_comes_after_one_that_stops():
    plans = [drawn_faults(np.random.default_rng(seed), 3, 12) for seed in range(50)]
    assert plans[7] == drawn_faults(np.random.default_rng(7), 3, 12)
    stopping = {str(fault) for fault in STOPPING}
    drawn = set()
    for plan in plans:
        assert all(3 <= push <= 12 for _, push, _ in plan)
        stops = [str(fault) in stopping for _, _, fault in plan]
        assert not any(stops[:-1])
        drawn |= {str(fault) for _, _, fault in plan}
    assert drawn == stopping | {str(fault) for fault in PASSING}


def test_a_robot_that_repairs_its_model_is_stopped_while_it_diagnoses_too():
    plans = [drawn_faults(np.random.default_rng(seed), 3, 12, adapt=True) for seed in range(50)]
    stopping = {str(fault) for fault in STOPPING}
    stages = {(stage, fault is None) for plan in plans for stage, _, fault in plan if str(fault) in stopping}
    assert stages == {("pushing", False), ("diagnosing", False), ("pushing", True)}


def test_a_task_reaches_the_session_as_it_was():
    task = Task("hammer", 3, 9, 5, True, drawn_faults(np.random.default_rng(1), 1, 12))
    assert task.faults and Task.of(task.to_json()) == task


def test_pushes_that_vanish_or_change_are_counted_as_lost(tmp_path):
    dataset = tilted_pushes()
    write_dataset(dataset, tmp_path / "pushes")
    account, count = Account(), len(dataset.trials)
    kept = checked(account, tmp_path, [{"recorded": count}], {})
    assert (len(kept), account.pushes, account.lost) == (count, count, 0)
    checked(account, tmp_path, [{"recorded": count + 1}], kept)
    assert account.lost == 1  # the robot had one more
    changed = tmp_path / "pushes" / dataset.trials[0].name
    changed.write_text(changed.read_text() + "\n")
    checked(account, tmp_path, [{"recorded": count}], kept)
    assert account.lost == 2
