"""Writes down what sensors say during pushes: one trial a push, in the format of every command.

`MeasurementLogger` is for a robot's cell, where the arm hides the object while it pushes. `TrialLogger` is
for a diagram of your own, in which pose, finger and force are known all the time. `dataset_of` makes trials
a dataset.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.python_system import PythonSystem, held
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.measurements.push_dataset import Channel, Noise, Role, Table
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.models.physics.cell_grid import CellGrid

PERIOD = 0.01
"""s between two rows of tip and force."""

LOOKS = 6
"""Poses at rest whose mean begins a trial, and as many to end it."""

_RESTED = 0.15  # s before the arm lifts the finger, from when on the object certainly rests

MISPLACED, TURNED = 4e-3, 0.05
"""m and rad by which two looks at an object at rest may differ, also one past the arm from one without it."""

_MOVED = np.array([1e-3, 1e-3, 0.01])  # m, m, rad; less is what another look may show
_FELT = 0.5  # N; less is what the arm feels without a touch

Row = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Recording:
    """What is written down of the push under way, and the trials before it."""

    trials: tuple[Trial, ...] = ()  # that are complete
    looks: tuple[Row, ...] = ()  # last poses seen while the arm was at home
    # poses, tips, forces: rows (time, …) of this push; empty before it
    poses: tuple[Row, ...] = ()
    tips: tuple[Row, ...] = ()
    forces: tuple[Row, ...] = ()
    missed: tuple[int, ...] = ()  # numbers of candidates that touched nothing

    def completed(self, role: Role, poses: Sequence[Row]) -> _Recording:
        """With one trial more, of the push under way, and these poses."""
        start = self.tips[0][0]

        def channel(rows: Sequence[Row]) -> Channel:
            values = np.array(rows, dtype=float)
            return Channel(values[:, 0] - start, values[:, 1:])

        name = f"trials/{len(self.trials):03d}.json"
        forces = channel(self.forces) if self.forces else None
        trial = Trial(name, role, channel(poses), channel(self.tips), forces)
        return _Recording((*self.trials, trial), self.looks, missed=self.missed)

    def touched(self, rest: Row) -> bool:
        """Whether the finger touched the object, which rests now: it moved, or pushed back."""
        off = np.abs(np.subtract(rest, self.poses[0]))[1:]
        if (off > _MOVED).any():
            return True
        return not self.forces or bool(np.hypot(*np.array(self.forces)[:, 1:3].T).max() > _FELT)


class MeasurementLogger(PythonSystem):
    """Records pushes.

    Inputs:
    - `object_pose`: `ObservedPose`; rows without a valid pose are left out.
    - `tip_pose`: X_WT of the finger's end; `tip_force`: (3,) of the finger on the object, world, N; `tip_age`
      (1,): s since both were measured, 0 if not connected.
    - `execution`: `ExecutionStatus`; `status`: `LoopStatus`.
    Outputs:
    - `trials`: tuple of `Trial`.
    - `missed`: numbers of the candidates that touched nothing; they leave no trial.
    - `under_way`: dict of rows of the push that is made now, by channel as in a trial's file, but with the
      diagram's time; none before and after it.

    Tip and force are recorded while the finger is down: above, it may pass over the object. An object at rest
    has one pose, whenever it is looked at: a trial begins, when the finger comes down, with the mean of the
    last looks before the arm moved, and ends, when the finger has rested, with that of the first looks after
    the arm went home. Between them are the poses seen in spite of the arm. Where the loop gives a push up,
    what was written down of it is dropped.

    Args:
        fit: so many trials are to learn from, those after them to judge.
        trials: that were recorded before.

    Example:
        >>> import slipmap
        >>> logger = slipmap.MeasurementLogger(fit=3)
        >>> [logger.get_output_port(i).get_name() for i in range(logger.num_output_ports())]
        ['trials', 'missed', 'under_way']
    """

    def __init__(self, fit: int, trials: Sequence[Trial] = ()) -> None:
        super().__init__()
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
        """The recording with where the finger is, and a pose seen meanwhile, if any."""
        age = self.optional_input(context, "tip_age")
        time = context.get_time() - (0.0 if age is None else float(age[0]))
        tip = self.input(context, "tip_pose").translation()
        force = self.input(context, "tip_force")
        new = recording
        if not new.tips:
            # The finger is on its way to the object, which still rests.
            still = (_rest(new.looks, time), _rest(new.looks, time + PERIOD))
            new = replace(new, poses=still, looks=())
        if row is not None and _fresh(row, new.poses):
            new = replace(new, poses=(*new.poses, row))
        if not _fresh((time,), new.tips):
            return new
        return replace(
            new,
            tips=(*new.tips, (time, float(tip[0]), float(tip[1]))),
            forces=(*new.forces, (time, float(force[0]), float(force[1]), 0.0)),
        )

    def _completed(self, recording: _Recording, number: int) -> _Recording:
        """The recording with the push under way as a trial, once enough poses were seen after it; a push that
        touched nothing is no push to learn from."""
        if not recording.tips or len(recording.looks) < LOOKS:
            return recording
        end = recording.tips[-1][0]
        rest = _rest(recording.looks, end)
        if not recording.touched(rest):
            return replace(recording, poses=(), tips=(), forces=(), missed=(*recording.missed, number))
        rows = (*_credible([row for row in recording.poses if row[0] < end], rest), rest)
        return recording.completed("fit" if len(recording.trials) < self._fit else "heldout", rows)


class TrialLogger(PythonSystem):
    """Records pushes where pose, finger and force are known all the time.

    Inputs:
    - `object_pose`: (3,) x, y (m), θ (rad) of the object in the world, such as that of `CellGridSlider`; θ
      goes on beyond ±π.
    - `finger`: (4,) centre (m) and velocity (m/s) in the world; NaN where the finger is not down.
    - `finger_force`: (2,) of the finger on the object, world, N; without it, trials have no forces.
    Outputs:
    - `trials`: tuple of `Trial`, as `Identification` takes it.
    - `observed_pose`: `ObservedPose` of now, as `BeliefVisualizer`, `MultiverseSlider` and `ModelMonitor`
      take it.

    A trial lasts from when the finger comes down, which should be free of an object at rest, until it is
    lifted, when the object should rest again.

    Args:
        fit: so many trials are to learn from, those after them to judge; all to learn from if None.
        period: s between two rows.

    Example:
        >>> import slipmap
        >>> logger = slipmap.TrialLogger()
        >>> [logger.get_output_port(i).get_name() for i in range(logger.num_output_ports())]
        ['trials', 'observed_pose']
    """

    def __init__(self, fit: int | None = None, period: float = PERIOD) -> None:
        super().__init__()
        self._fit = fit
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
        time, center = context.get_time(), self.input(context, "finger")[:2]
        if np.isfinite(center).all():
            now = replace(
                now,
                poses=(*now.poses, (time, *self._pose.Eval(context))),
                tips=(*now.tips, (time, *center)),
            )
            force = self.optional_input(context, "finger_force")
            if force is not None:
                now = replace(now, forces=(*now.forces, (time, *force, 0.0)))
        elif now.tips:
            role: Role = "fit" if self._fit is None or len(now.trials) < self._fit else "heldout"
            now = now.completed(role, now.poses)
        return now


def _under_way(recording: _Recording) -> dict[str, tuple[Row, ...]]:
    tips = tuple((*row, 0.0) for row in recording.tips)
    return {"object_pose": recording.poses, "tip_pose": tips, "ft_wrench": recording.forces}


def _credible(poses: Sequence[Row], rest: Row) -> Sequence[Row]:
    """Poses seen during a push; those at its begin alone where the last of them is not where the object came
    to rest, though it rested already: then the arm hid too much of it."""
    begin, last = poses[:2], np.array(poses[-1])
    off = np.abs(last[1:] - rest[1:])
    at_rest = last[0] > rest[0] - _RESTED
    return begin if at_rest and (off > [MISPLACED, MISPLACED, TURNED]).any() else poses


def _rest(looks: Sequence[Row], time: float) -> Row:
    """Pose of an object at rest from several looks; their angles are continuous."""
    mean = np.mean([row[1:] for row in looks], axis=0)
    return (time, *map(float, mean))


def _lies_there(row: Row, looks: Sequence[Row]) -> bool:
    """Whether the object lies where it did; else something else moved it, and looks before say nothing."""
    off = np.abs(np.subtract(row, _rest(looks, row[0])))[1:] if looks else np.zeros(3)
    return bool((off <= [MISPLACED, MISPLACED, TURNED]).all())


def _fresh(row: Row, rows: Sequence[Row]) -> bool:
    return not rows or row[0] > rows[-1][0] + 1e-9


def dataset_of(
    trials: Sequence[Trial],
    grid: CellGrid,
    *,
    name: str,
    finger_radius: float,
    noise: Noise,
    table: Table | None = None,
    gravity: float = 9.81,
    description: str = "",
) -> PushDataset:
    """Recorded trials as a dataset, like one that was read from a folder.

    Args:
        trials: one or more.
        grid: the object as the camera made it out.
        finger_radius: m.
        gravity: m/s².

    Raises:
        DatasetError: there is no trial.
    """
    digest = hashlib.sha256(grid.centers.tobytes())
    for trial in trials:
        for channel in (trial.object_pose, trial.tip_pose, trial.ft_wrench):
            if channel is not None:
                digest.update(channel.time.tobytes() + channel.values.tobytes())
    return PushDataset(
        name=name,
        description=description,
        grid=grid,
        height=None,
        mass=None,
        finger_radius=finger_radius,
        table=table,
        gravity=gravity,
        noise=noise,
        trials=tuple(trials),
        fingerprint=digest.hexdigest(),
    )
