"""One push, as measured: its channels, each on its sensor's own time stamps.

Nothing is extrapolated and no row is moved. `pose_times`, `finger_path` and `wrench_samples` only shift their
zero to the first object pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slipmap.models.measurements.motion import initial_twist, interpolated
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.settings import check_kind

Role = Literal["fit", "heldout"]

CHANNELS: Mapping[str, tuple[str, ...]] = {
    "object_pose": ("object_x", "object_y", "object_theta"),
    "tip_pose": ("tip_x", "tip_y"),
    "ft_wrench": ("force_x", "force_y", "force_tau"),
}
"""The channels of a trial and their columns besides time; force is optional."""

LAST_PLACE = 1_000_000
"""The largest `order` of a trial."""

_FAR_AWAY = 1.0  # m beyond the outline


class DatasetError(ValueError):
    """Measurements that cannot be used. The message is one paragraph: file, trial, row and what to do.

    Example:
        >>> import slipmap
        >>> from slipmap.models.measurements import DatasetError
        >>> try:
        ...     slipmap.read_dataset("nowhere")
        ... except DatasetError as error:
        ...     print(str(error).split(";")[0])
        'nowhere': there is no such file or folder
    """

    def __init__(self, text: str):
        super().__init__(" ".join(text.split()))


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor's rows, on the sensor's own time stamps.

    Raises:
        DatasetError: shapes that do not match, no rows, non-finite numbers, time that does not increase.
    """

    time: FloatArray  # (T,) strictly increasing, s
    values: FloatArray  # (T, c) finite

    def __repr__(self) -> str:
        rows, columns = self.values.shape
        return f"Channel({rows} rows of {columns}, {self.time[0]:g} to {self.time[-1]:g} s)"

    def __post_init__(self) -> None:
        time = np.ascontiguousarray(self.time, dtype=float)
        values = np.ascontiguousarray(self.values, dtype=float)
        if time.ndim != 1 or values.ndim != 2 or len(time) != len(values) or len(time) == 0:
            raise DatasetError(
                f"channel: needs T >= 1 times and T rows, got the shapes {time.shape} and {values.shape}"
            )
        bad = np.flatnonzero(~(np.isfinite(time) & np.isfinite(values).all(axis=1)))
        if len(bad):
            raise DatasetError(f"channel, row {bad[0]}: every number must be finite; leave this row out")
        late = np.flatnonzero(np.diff(time) <= 0)
        if len(late):
            raise DatasetError(f"channel, row {late[0] + 1}: time must increase from row to row")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)

    def at(self, t: float | Sequence[float] | FloatArray) -> FloatArray:
        """Values (..., c) at times `t` of any shape (...), linear between rows and constant beyond the
        ends."""
        return interpolated(t, self.time, self.values)

    def chosen(self, rows: NDArray[np.bool_]) -> Channel:
        """Some of the rows (T,)."""
        return Channel(self.time[rows], self.values[rows])


@dataclass(frozen=True, eq=False)
class Trial:
    """One push, or one slide without a finger. `slipmap.dataset_from_arrays` makes trials of arrays.

    Attributes:
        name: the trial's file, such as 'trials/000.json'.
        role: 'fit' for learning, 'heldout' for judging.
        object_pose: (T, 3) x, y in m and unwrapped theta in rad of the object frame in the world frame.
        tip_pose: (T, 2) centre of the finger in the world frame, m.
        ft_wrench: (T, 3) force of the finger on the object in the world frame, N, and torque about the
            finger's axis, N·m, 0 if not measured; None if force was not measured.
        kept: whether it stays in its dataset whatever the checks on reading find.
        order: its place in the experiment as recorded, 0 to 1000000, kept when other trials are left out;
            if None, a dataset gives it that in its `trials`.
        tip_angle: (T, 1) angle of the finger about its axis, unwrapped, rad; None if it does not turn.

    Raises:
        DatasetError: an unknown role, a wrong number of columns, fewer than two object poses, or an order
            that is not a whole number from 0.
        TypeError: an array where a `Channel` belongs.

    Example:
        >>> import slipmap
        >>> trial = slipmap.simulated_hammer(fit=1, heldout=0)[0].trials[0]
        >>> trial.name, trial.role, trial.object_pose.values.shape[1]
        ('trials/000.json', 'fit', 3)
    """

    name: str
    role: Role
    object_pose: Channel
    tip_pose: Channel
    ft_wrench: Channel | None = None
    kept: bool = False
    order: int | None = None
    tip_angle: Channel | None = None

    def __repr__(self) -> str:
        rows = [f"{len(channel.time)} rows of {name}" for name, channel in self.channels.items()]
        return f"Trial({self.name!r}, {self.role}: {', '.join(rows)})"

    def __post_init__(self) -> None:
        if self.role not in ("fit", "heldout"):
            raise DatasetError(f"{self.name}: role must be fit or heldout, got {self.role!r}")
        if self.order is not None and not (isinstance(self.order, int) and 0 <= self.order <= LAST_PLACE):
            raise DatasetError(
                f"{self.name}: order must be a whole number from 0 to {LAST_PLACE}, got {self.order!r}"
            )
        for what, channel in self.channels.items():
            source = "which slipmap.dataset_from_arrays makes of arrays"
            check_kind(f"{self.name}: {what}", channel, Channel, source)
        if len(self.object_pose.time) < 2:
            raise DatasetError(f"{self.name}: object_pose needs at least two rows, a first and a last pose")
        for what, channel in self.channels.items():
            columns, found = len(CHANNELS[what]), channel.values.shape[1]
            if found != columns:
                raise DatasetError(f"{self.name}: {what} needs {columns} columns besides time, has {found}")
        if self.tip_angle is not None:
            check_kind(f"{self.name}: tip_angle", self.tip_angle, Channel, "with one column, in rad")
            if self.tip_angle.values.shape[1] != 1:
                raise DatasetError(f"{self.name}: tip_angle needs one column besides time")

    @property
    def channels(self) -> dict[str, Channel]:
        """The measured channels by name."""
        return {name: channel for name in CHANNELS if (channel := getattr(self, name)) is not None}

    @property
    def start(self) -> float:
        """Time of the first object pose, s."""
        return float(self.object_pose.time[0])

    @property
    def ends_only(self) -> bool:
        """Whether only the first and last pose are known, so that poses cannot be interpolated.

        Equal first rows count once: one observation of an object at rest, written twice.
        """
        poses = self.object_pose.values
        return bool((poses[:-1] == poses[0]).all())

    def finger_near(self, reach: float = 0.0) -> bool:
        """Whether the finger ever comes within 1 m of the object; farther away it counts as absent.

        Args:
            reach: largest distance of the outline from the object frame's origin, m; the 1 m count from it.
        """
        distance = self.tip_pose.values - self.object_pose.at(self.tip_pose.time)[:, :2]
        return bool(np.min(np.hypot(*distance.T)) < reach + _FAR_AWAY)

    def initial_velocity(self) -> FloatArray:
        """(3,) world velocity (v_x, v_y, omega) at the first pose, m/s and rad/s.

        Exactly zero if `ends_only`, or if the rows do not show motion from the first row on; see
        `initial_twist` for the robust fit and the significance test.
        """
        return self._initial_velocity.copy()

    @cached_property
    def _initial_velocity(self) -> FloatArray:
        if self.ends_only:
            return np.zeros(3)
        return initial_twist(self.object_pose.time, self.object_pose.values)


def in_order(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """The trials, each with its place among them as its order, unless each has an order of its own."""
    trials = tuple(trials)
    given = {trial.order for trial in trials}
    if None not in given and len(given) == len(trials):
        return trials
    return tuple(replace(trial, order=place) for place, trial in enumerate(trials))


def pose_times(trial: Trial) -> FloatArray:
    """(T,) times of the object poses after the first one, s, at which to compare a prediction."""
    return trial.object_pose.time - trial.start


def finger_path(trial: Trial) -> tuple[FloatArray, FloatArray]:
    """The finger's track over exactly the time span of the object poses.

    The finger keeps its own time stamps inside the span. A row is added at each end of the span, linear
    between neighbouring rows. If the track begins late or ends early, the finger is held at its first or last
    position; it is never extrapolated.

    Returns:
        Times (k,) after the first pose, strictly increasing from 0 to that of the last pose, s, and positions
        (k, 2) in the world frame, m.
    """
    end = pose_times(trial)[-1]
    own = trial.tip_pose.time - trial.start
    time = np.unique(np.concatenate([[0.0], own[(own > 0.0) & (own < end)], [end]]))
    return time, trial.tip_pose.at(trial.start + time)


def wrench_samples(trial: Trial) -> tuple[FloatArray, FloatArray] | None:
    """Force rows within the time span of the object poses, on their own time stamps.

    Returns:
        Times (k,) after the first pose, s, and wrenches (k, 3) of the finger on the object, N and N·m, world
        frame; None if force was not measured. k is 0 if no row lies in the span.
    """
    if trial.ft_wrench is None:
        return None
    time = trial.ft_wrench.time - trial.start
    inside = (time >= 0.0) & (time <= pose_times(trial)[-1])
    return time[inside], trial.ft_wrench.values[inside]
