"""Records sensor measurements during pushes: one trial per push, in the format that every command reads.

`MeasurementLogger` is for a robot cell, where the arm hides the object while it pushes. `TrialLogger` is for
a diagram of your own in which pose, finger and force are always known.
`slipmap.models.measurements.push_dataset.dataset_of` turns trials into a dataset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from slipmap.diagrams.execution.arm_motion import TORQUE_LAG
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.python_system import PythonSystem, held
from slipmap.models.measurements import Trial
from slipmap.models.measurements.trial import Channel, Role
from slipmap.models.measurements.trial_tables import if_turning, unwrapped
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.settings import check_positive, check_whole

PERIOD = 0.01  # s between two rows of tip and force
LOOKS = 6  # number of poses at rest that are averaged for the start of a trial, and again for its end
_RESTED = 0.15  # s before the arm lifts the finger; from then on the object certainly rests

MISPLACED, TURNED = 4e-3, 0.05
"""m and rad by which two looks at an object at rest may differ, even if the arm hides part of it in one."""

_MOVED = np.array([1e-3, 1e-3, 0.01])  # m, m, rad; two looks at an object at rest may differ by less
_FELT = 0.5  # N; the arm may measure less without contact
_EXACT = 0.1  # share of both that a `TrialLogger` can tell
# m, and m/s in addition to the speed at its end: a finger that moves farther between two rows has jumped
_JUMP, _USUAL_SPEED = 0.02, 0.5

Row = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Recording:
    """The recording of the push under way, and the trials before it."""

    trials: tuple[Trial, ...] = ()  # complete trials
    looks: tuple[Row, ...] = ()  # last poses seen while the arm was at home
    # poses, tips, forces: rows (time, …) of this push, the finger's with its angle; empty before it
    poses: tuple[Row, ...] = ()
    tips: tuple[Row, ...] = ()
    forces: tuple[Row, ...] = ()
    missed: tuple[int, ...] = ()  # numbers of candidates that touched nothing

    def completed(self, role: Role, poses: Sequence[Row]) -> _Recording:
        """The recording with the push under way added as a trial with these poses."""
        start = self.tips[0][0]

        def channel(rows: Sequence[Row]) -> Channel:
            values = np.array(rows, dtype=float)
            return Channel(values[:, 0] - start, values[:, 1:])

        name = f"trials/{len(self.trials):03d}.json"
        forces = channel(self.forces) if self.forces else None
        pose, finger = channel(poses), channel(self.tips)
        angle = if_turning(Channel(finger.time, unwrapped(finger.values[:, 2])[:, None]))
        tip = Channel(finger.time, finger.values[:, :2])
        trial = Trial(name, role, pose, tip, forces, order=len(self.trials), tip_angle=angle)
        return _Recording((*self.trials, trial), self.looks, missed=self.missed)

    def touched(self, rest: Row, share: float = 1.0) -> bool:
        """Whether the finger touched the object: it moved or pushed back by more than a share of what the
        arm's sensors can tell."""
        off = np.abs(np.subtract(rest, self.poses[0]))[1:]
        if (off > share * _MOVED).any():
            return True
        felt = np.hypot(*np.array(self.forces)[:, 1:3].T).max() if self.forces else 0.0
        return bool(felt > share * _FELT)


class MeasurementLogger(PythonSystem):
    """Records the pushes of a robot cell.

    Inputs:
    - `object_pose`: `ObservedPose`; rows without a valid pose are left out.
    - `tip_pose`: X_WT of the finger's end; `tip_force`: (3,) of the finger on the object, world, N; `tip_age`
      (1,): s since both were measured, 0 if not connected. The force is stamped `TORQUE_LAG` earlier.
    - `execution`: `ExecutionStatus`; `status`: `LoopStatus`.
    Outputs:
    - `trials`: tuple of `Trial`.
    - `missed`: numbers of the candidates that touched nothing; they leave no trial.
    - `under_way`: dict of the rows of the push under way, by channel as in a trial's file, but in the
      diagram's time; empty before and after it.

    Tip and force are recorded only while the finger is down, because a raised finger may pass over the
    object. An object at rest has the same pose whenever it is seen. So a trial starts, when the finger comes
    down, with the mean of the last looks before the arm moved; it ends, when the finger has come to rest,
    with the mean of the first looks after the arm went home. Between them are the poses seen in spite of the
    arm. If the loop gives up a push, its rows are dropped.

    Args:
        fit: number of trials to learn from; later ones are for judging.
        trials: recorded earlier.

    Example:
        >>> from slipmap.diagrams.systems.measurement_logger import MeasurementLogger
        >>> logger = MeasurementLogger(fit=3)
        >>> [logger.get_output_port(i).get_name() for i in range(logger.num_output_ports())]
        ['trials', 'missed', 'under_way']
    """

    def __init__(self, fit: int, trials: Sequence[Trial] = ()) -> None:
        super().__init__()
        check_whole("MeasurementLogger: fit", fit, 0)
        self._fit = fit
        self.declare_inputs("object_pose")
        self.DeclareAbstractInputPort("tip_pose", Value(RigidTransform()))
        self.DeclareVectorInputPort("tip_force", 3)
        self.DeclareVectorInputPort("tip_age", 1)
        self.declare_inputs("execution", "status")
        self._recording = self.DeclareAbstractState(held(_Recording(tuple(trials))))
        self.declare_steps(PERIOD, self._recording, self._record)
        self.declare_output_of("trials", self._recording, lambda recording: recording.trials)
        self.declare_output_of("missed", self._recording, lambda recording: recording.missed)
        self.declare_output_of("under_way", self._recording, _under_way)

    def _record(self, context: Context, now: _Recording) -> _Recording:
        status: LoopStatus = self.input(context, "status")
        execution = self.input(context, "execution")
        if now.tips and status.mode not in ("pushing", "recording"):
            now = replace(now, poses=(), tips=(), forces=())
        pose = self.input(context, "object_pose")
        row = (pose.time, *map(float, pose.pose)) if pose is not None and pose.valid else None
        if execution.mode == "home" and status.mode != "pushing":
            if row is not None and _fresh(row, now.looks or now.tips):
                before = now.looks if _lies_there(row, now.looks) else ()
                now = replace(now, looks=(*before, row)[-LOOKS:])
                if status.mode == "recording":
                    now = self._completed(now, status.number)
        elif execution.mode == "pushing":
            now = self._pushed(context, now, row)
        return now

    def _pushed(self, context: Context, recording: _Recording, row: Row | None) -> _Recording:
        """The recording with the finger's position, and the new pose if the object was seen."""
        age = self.optional_input(context, "tip_age")
        time = context.get_time() - (0.0 if age is None else float(age[0]))
        X_WT = self.input(context, "tip_pose")
        tip, R_WT = X_WT.translation(), X_WT.rotation().matrix()
        angle = float(np.arctan2(R_WT[1, 0], R_WT[0, 0]))
        force = self.input(context, "tip_force")
        new = recording
        if not new.tips:
            # The finger is still approaching the object, which rests.
            still = (_rest(new.looks, time), _rest(new.looks, time + PERIOD))
            new = replace(new, poses=still, looks=())
        if row is not None and _fresh(row, new.poses):
            new = replace(new, poses=(*new.poses, row))
        if not _fresh((time,), new.tips):
            return new
        return replace(
            new,
            tips=(*new.tips, (time, float(tip[0]), float(tip[1]), angle)),
            forces=(*new.forces, (time - TORQUE_LAG, float(force[0]), float(force[1]), 0.0)),
        )

    def _completed(self, recording: _Recording, number: int) -> _Recording:
        """The recording with the push under way as a trial, once enough poses have been seen after it; a push
        that touched nothing leaves no trial."""
        if not recording.tips or len(recording.looks) < LOOKS:
            return recording
        end = recording.tips[-1][0]
        rest = _rest(recording.looks, end)
        if not recording.touched(rest):
            return replace(recording, poses=(), tips=(), forces=(), missed=(*recording.missed, number))
        rows = (*_credible([row for row in recording.poses if row[0] < end], rest), rest)
        return recording.completed("fit" if len(recording.trials) < self._fit else "heldout", rows)


class TrialLogger(PythonSystem):
    """Records pushes when pose, finger and force are always known.

    Inputs:
    - `object_pose`: (3,) x, y (m), θ (rad) of the object in the world, for example from `CellGridSlider`; θ
      is continuous beyond ±π. NaN while a tracker does not see it; such rows are left out.
    - `finger`: (4,) centre (m) and velocity (m/s) in the world; NaN while the finger is not down.
    - `finger_force`: (2,) of the finger on the object, world, N; without it, trials have no forces.
    Outputs:
    - `trials`: tuple of `Trial`, as `Identification` takes it.
    - `observed_pose`: the present `ObservedPose`, as `BeliefVisualizer`, `MultiverseSlider` and
      `ModelMonitor` take it.

    A trial lasts from when the finger comes down until it is lifted for at least a period. The finger should
    come down clear of the object, and the object should be at rest at both times. A push is not a trial if it
    touched nothing, so that the object neither moved by 0.1 mm or 1 mrad nor pushed back with 0.05 N, or if
    fewer than two poses were seen.

    Args:
        fit: number of trials to learn from; later ones are for judging. If None, all are to learn from.
        period: s between two rows.

    Raises:
        ValueError: the period is not positive, or `fit` no whole number; in a simulation, if the finger jumps
            while it is down: two pushes would be one trial.

    Example:
        >>> import slipmap
        >>> logger = slipmap.TrialLogger()
        >>> [logger.get_output_port(i).get_name() for i in range(logger.num_output_ports())]
        ['trials', 'observed_pose']
    """

    def __init__(self, fit: int | None = None, period: float = PERIOD) -> None:
        super().__init__()
        check_positive("TrialLogger: period", period, "s")
        if fit is not None:
            check_whole("TrialLogger: fit", fit, 0)
        self._fit, self._period = fit, period
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self.DeclareVectorInputPort("finger", 4)
        self.DeclareVectorInputPort("finger_force", 2)
        self._recording = self.DeclareAbstractState(held(_Recording()))
        self.declare_steps(period, self._recording, self._record)
        self.declare_output_of("trials", self._recording, lambda recording: recording.trials)
        self.declare_output(
            "observed_pose",
            lambda context: ObservedPose.of(self._pose.Eval(context), context.get_time()),
            {self._pose.ticket(), self.time_ticket()},
        )

    def _record(self, context: Context, now: _Recording) -> _Recording:
        time, finger = context.get_time(), self.input(context, "finger")
        center = finger[:2]
        if np.isfinite(center).all():
            self._refuse_jump(now, time, finger)
            now = replace(now, tips=(*now.tips, (time, *center, 0.0)))
            pose, force = self._pose.Eval(context), self.optional_input(context, "finger_force")
            if np.isfinite(pose).all():
                now = replace(now, poses=(*now.poses, (time, *pose)))
            if force is not None and np.isfinite(force).all():
                now = replace(now, forces=(*now.forces, (time, *force, 0.0)))
        elif now.tips:
            if len(now.poses) < 2 or not now.touched(now.poses[-1], _EXACT):
                return _Recording(now.trials)
            role: Role = "fit" if self._fit is None or len(now.trials) < self._fit else "heldout"
            now = now.completed(role, now.poses)
        return now

    def _refuse_jump(self, now: _Recording, time: float, finger: FloatArray) -> None:
        """Raise ValueError if the finger cannot have come here from where it was a row before."""
        if not now.tips:
            return
        before, *place, _ = now.tips[-1]
        moved, took = float(np.hypot(*(finger[:2] - place))), time - before
        if moved > _JUMP + (2.0 * float(np.hypot(*finger[2:])) + _USUAL_SPEED) * took:
            raise ValueError(
                f"TrialLogger: the finger jumped by {1e3 * moved:.0f} mm before {time:.3f} s without being"
                f" lifted; between two pushes, lift it (NaN) for at least {self._period:g} s, or give the"
                " logger a shorter period"
            )


def _under_way(recording: _Recording) -> dict[str, tuple[Row, ...]]:
    return {"object_pose": recording.poses, "tip_pose": recording.tips, "ft_wrench": recording.forces}


def _credible(poses: Sequence[Row], rest: Row) -> Sequence[Row]:
    """The poses seen during a push that can be trusted.

    If the last one differs from the pose at rest although the object rested already, the arm hid too much of
    it, and only the poses at the start are kept.
    """
    begin, last = poses[:2], np.array(poses[-1])
    off = np.abs(last[1:] - rest[1:])
    at_rest = last[0] > rest[0] - _RESTED
    return begin if at_rest and (off > [MISPLACED, MISPLACED, TURNED]).any() else poses


def _rest(looks: Sequence[Row], time: float) -> Row:
    """Pose of an object at rest, averaged over several looks with continuous angles."""
    mean = np.mean([row[1:] for row in looks], axis=0)
    return (time, *map(float, mean))


def _lies_there(row: Row, looks: Sequence[Row]) -> bool:
    """Whether the object lies where it did; if not, something else moved it and earlier looks are void."""
    off = np.abs(np.subtract(row, _rest(looks, row[0])))[1:] if looks else np.zeros(3)
    return bool((off <= [MISPLACED, MISPLACED, TURNED]).all())


def _fresh(row: Row, rows: Sequence[Row]) -> bool:
    return not rows or row[0] > rows[-1][0] + 1e-9
