"""Assertions for scripted tests of a cell, including some on all commands sent to the arm."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from drake import lcmt_iiwa_command

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.guard import GuardSettings
from slipmap.diagrams.hardware.network import IIWA_COMMAND, LOOK_EVERY, open_lcm
from slipmap.diagrams.loops.exploration_run import ExplorationRun
from slipmap.diagrams.loops.pregrasp_loop import PregraspRun
from slipmap.diagrams.station.arm import arm_model
from slipmap.diagrams.systems.model_monitor import LEVEL, Watch
from slipmap.models.inference.diagnosis.results import Diagnosis
from slipmap.models.inference.results import Identification
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ARM_JOINTS, SPEED_LIMITS
from slipmap.models.settings import check_choice, check_kind, check_positive, check_whole


@dataclass(frozen=True, eq=False)
class CommandLog:
    """Commands in the order of sending."""

    times: FloatArray  # (n,) stamps of the sender, s; they increase, unless senders or clocks are at fault
    q: FloatArray  # (n, 7) joint angles, rad

    @staticmethod
    def of(rows: FloatArray) -> CommandLog:
        """From rows (n, 8) of a stamp and seven angles; repeated commands are left out."""
        rows = np.asarray(rows, dtype=float).reshape(-1, 8)
        if len(rows):
            rows = rows[np.r_[True, (rows[1:] != rows[:-1]).any(axis=1)]]
        return CommandLog(rows[:, 0], rows[:, 1:])

    @cached_property
    def joint_speeds(self) -> FloatArray:
        """(n - 1, 7) joint speeds from one command to the next, rad/s."""
        return np.diff(self.q, axis=0) / np.diff(self.times)[:, None]

    @cached_property
    def tip_speeds(self) -> FloatArray:
        """(n - 1,) speeds of the finger's end, m/s."""
        kinematics = FingerKinematics(arm_model())
        tips = np.array([kinematics.pose(q).translation() for q in self.q]).reshape(-1, 3)
        return np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(self.times)


class CommandRecorder(Child):
    """A process that receives commands and writes them to a file; `close` ends it.

    Args:
        url: LCM address of the commands.
        path: of the file.
    """

    def __init__(self, url: str, path: Path) -> None:
        self._path = path
        super().__init__("the process that records commands", _record, url, str(path))

    def log(self) -> CommandLog:
        """All commands so far, except perhaps the very last."""
        data = self._path.read_bytes()
        return CommandLog.of(np.frombuffer(data[: len(data) // 64 * 64], "<f8"))


def row_of(data: bytes) -> list[float]:
    """Stamp, s, and angles of an encoded command."""
    command = lcmt_iiwa_command.decode(data)
    return [1e-6 * command.utime, *command.joint_position]


def _record(url: str, path: str) -> None:
    source = sys.stdin.fileno()
    with open(path, "wb", buffering=0) as file:

        def hear(data: bytes) -> None:
            file.write(np.array(row_of(data), "<f8").tobytes())

        lcm = open_lcm(url)
        lcm.Subscribe(IIWA_COMMAND, hear)
        be_ready()
        while True:
            if select.select([source], [], [], LOOK_EVERY)[0] and not os.read(source, 1):
                return
            lcm.HandleSubscriptions(0)


_ROUNDING = 1e-3  # stamps are in whole microseconds, and 5 ms are 5000 of them


def assert_predicts(run: ExplorationRun | Identification, within: float, role: str = "heldout") -> None:
    """Assert that held-out pushes end where they were predicted.

    Args:
        within: largest mean distance of the cells at the end of each push, m.
        role: `heldout`, or `fit` for the pushes that were learned from.

    Raises:
        TypeError, ValueError: an argument of another kind, another role, or a distance of a metre or more.
    """
    check_choice("assert_predicts: role", role, ("heldout", "fit"))
    check_positive("assert_predicts: within", within, "m")
    if within >= 1:
        raise ValueError(f"assert_predicts: within must lie between 0 and 1 m, got {within}")
    learned = _learned(run)
    errors = _errors(learned, role)
    assert errors.max() <= within, (
        f"a push ended {1e3 * errors.max():.1f} mm from its prediction; {1e3 * within:.3g} mm are"
        f" allowed\n{_pushes(learned)}"
    )


def assert_better_than_uniform(run: ExplorationRun | Identification, times: float = 1.0) -> None:
    """Assert that held-out pushes are predicted better, on average, than by the uniform object.

    Args:
        times: factor by which the error must be smaller.

    Raises:
        TypeError, ValueError: an argument of another kind, or a factor that is not positive.
    """
    check_positive("assert_better_than_uniform: times", times, "times")
    learned = _learned(run)
    own, uniform = _errors(learned, "heldout").mean(), learned.errors("heldout", "uniform_add").mean()
    assert times * own < uniform, (
        f"the mean error is {1e3 * own:.1f} mm, that of a uniform object {1e3 * uniform:.1f} mm; it must be"
        f" {'larger' if times == 1 else f'more than {times:g} times as large'}\n"
        f"{_pushes(learned)}"
    )


def assert_alarm(watch: Watch) -> None:
    """Assert that the monitor gave an alarm: the object does not move as the model predicts."""
    _check_watch(watch)
    assert any(push.alarm for push in watch.judged), f"no alarm\n{_judged(watch)}"


def assert_quiet(watch: Watch, judged: int = 3) -> None:
    """Assert that the monitor gave no alarm on at least `judged` pushes; by default as many as one takes.

    Raises:
        TypeError, ValueError: no watch, or no whole number of at least 1.
    """
    check_whole("assert_quiet: judged", judged, 1)
    _check_watch(watch)
    assert len(watch.judged) >= judged, (
        f"only {len(watch.judged)} pushes were judged, {judged} are required; make more\n{_judged(watch)}"
    )
    assert not any(push.alarm for push in watch.judged), f"the monitor gave an alarm\n{_judged(watch)}"


def assert_names(diagnosis: Diagnosis, effect: str) -> None:
    """Assert that the diagnosis names an effect, alone or among those that the pushes cannot tell apart."""
    check_kind("diagnosis", diagnosis, Diagnosis, "such as slipmap.diagnose(dataset) returns")
    named = diagnosis.verdict in ("effect", "ambiguous") and effect in diagnosis.effects
    assert named, f"{effect} is not named; verdict {diagnosis.verdict}: {diagnosis.sentence}"


def assert_adopts(run: ExplorationRun, effect: str) -> None:
    """Assert that the robot added an effect to its model on the way and kept it to the end."""
    _check_run(run, "repair", "an ExplorationRun, such as cell.explore(adapt=True) returns")
    assert run.repair is not None, "the run did not adapt; set adapt=True"
    said = "\n".join(f"push {found.pushes}: {found.verdict}, {found.action}" for found in run.repair.findings)
    rival = " (only as a rival)" if effect == run.repair.rival else ""
    assert effect in run.repair.effects, (
        f"{effect} is not in the model at the end{rival}\n{said or 'no diagnosis'}"
    )
    assert effect not in run.repair.given, (
        f"{effect} was in the model from the start, no diagnosis added it\n{said or 'no diagnosis'}"
    )


def assert_held(run: PregraspRun) -> None:
    """Assert that the gripper holds the object in the end."""
    _check_run(run, "held", "a PregraspRun, such as cell.pregrasp() returns")
    count = len(run.pushes)
    pushes = f"{count} push{'es' * (count != 1)}"
    assert run.held, f"the object is not held after {pushes} to the edge: {run.reason}"


def assert_limits_kept(commands: Sequence[CommandLog], guard: GuardSettings) -> None:
    """Assert that no command exceeded the speed limit of a joint or of the finger, and that stamps increase.

    Args:
        commands: of a `Cell`.
        guard: of the scenario; `tip_speed` is used.
    """
    if isinstance(commands, CommandLog):
        raise TypeError("commands must be a list of logs, such as cell.commands; got one log")
    check_kind("guard", guard, GuardSettings, "such as cell.scenario.guard")
    assert any(len(log.times) > 1 for log in commands), "no commands were received"
    for log in commands:
        if len(log.times) < 2:
            continue
        back = np.diff(log.times).argmin()
        assert log.times[back + 1] > log.times[back], (
            f"a command with the stamp {log.times[back + 1]:.3f} s came after another with"
            f" {log.times[back]:.3f} s; check whether two programs drive the arm, and the sender's clock"
        )
        share = np.abs(log.joint_speeds) / SPEED_LIMITS
        row, joint = np.unravel_index(share.argmax(), share.shape)
        assert share[row, joint] <= 1.0 + _ROUNDING, (
            f"{ARM_JOINTS[joint]} was commanded to {share[row, joint]:.2f} times its largest speed at"
            f" {log.times[row]:.3f} s of the sender's clock"
        )
        fastest = log.tip_speeds.argmax()
        assert log.tip_speeds[fastest] <= guard.tip_speed * (1.0 + _ROUNDING), (
            f"the finger was commanded to {log.tip_speeds[fastest]:.2f} m/s at {log.times[fastest]:.3f} s of"
            f" the sender's clock; {guard.tip_speed:g} m/s are allowed"
        )


def _check_run(run: object, part: str, kind: str) -> None:
    if not hasattr(run, part):
        raise TypeError(f"run must be {kind}; got a {type(run).__name__}")


def _learned(run: ExplorationRun | Identification) -> Identification:
    learned = run.identification if isinstance(run, ExplorationRun) else run
    check_kind("run", learned, Identification, "such as cell.explore() or slipmap.identify() returns")
    return learned


def _errors(learned: Identification, role: str) -> FloatArray:
    """(B,) errors of the pushes with a role, at least one, m."""
    errors = learned.errors(role)
    missing = "ask for checks" if role == "heldout" else "ask for pushes"
    assert len(errors), f"no push has the role {role}, so nothing was predicted; {missing}"
    return errors


def _check_watch(watch: Watch) -> None:
    check_kind("watch", watch, Watch, "such as that of an exploration, run.watch")


def _pushes(learned: Identification) -> str:
    return "\n".join(
        f"{push.trial} ({push.role}): {1e3 * push.final_add:.1f} mm; uniform {1e3 * push.uniform_add:.1f} mm,"
        f" hypotheses spread by {1e3 * push.spread:.1f} mm"
        for push in learned.pushes
    )


def _judged(watch: Watch) -> str:
    rows = [
        f"push {push.trial:03d}: misfit {push.misfit:.1f}, evidence {push.evidence:.3g} of {1 / LEVEL:.0f}"
        f"{f'; ALARM: {push.cause}' if push.alarm else ''}"
        for push in watch.judged
    ]
    return "\n".join(rows) or "no push was judged"
