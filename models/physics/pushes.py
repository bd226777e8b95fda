"""Drives of the object, a finger's path or a force: one push, or many joined for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.kernel_tools import JoinedPushes
from slipmap.models.settings import check_kind, check_several

_FARTHEST = 20.0  # m between finger and object; no finger is as far, but lengths in mm are


@dataclass(frozen=True, eq=False)
class Push:
    """The drive of N steps of length h, and the times at which results are wanted.

    Attributes:
        h: step, s.
        tip: (N + 1, 2) finger centre at the ends of the steps, world, m; NaN where there is no finger.
        tip_angle: (N + 1,) angle of the finger about its axis, rad, if it turns: it rolls along the object.
        start_pose: (3,) x, y, θ in the world.
        start_twist: (3,) v_x, v_y, omega in the object frame.
        pose_times: (S,) ascending times from the start at which poses are wanted, s; by default the ends of
            the steps.
        force_times: (T,) the same for the contact force, which is a mean over `force_span` around that time.
        wrench: (N, 5) applied force (world, N), its point (object frame, m) and a torque (N m), or None.
        order: index of the push in the experiment, from 0, for effects that change from push to push.
        force_span: s; a force is the mean over the steps whose middles lie within it, at least over the step
            around its time.

    Raises:
        ValueError: shapes do not match, the step is not positive, the span of forces is negative, times lie
            outside the push or do not ascend, or the finger stays more than 20 m away.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> way = np.linspace([-0.06, 0.02], [0.04, 0.02], 101)
        >>> push = slipmap.Push(0.01, way, start_pose=np.zeros(3))
        >>> push.tip.shape
        (101, 2)
    """

    h: float
    tip: FloatArray
    start_pose: FloatArray
    start_twist: FloatArray = field(default_factory=lambda: np.zeros(3))
    pose_times: FloatArray | None = None
    force_times: FloatArray = field(default_factory=lambda: np.zeros(0))
    wrench: FloatArray | None = None
    order: float = 0.0
    force_span: float = 0.0
    tip_angle: FloatArray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.h) and self.h > 0):
            raise ValueError(f"push: the step h must be positive, got {self.h} s")
        if not (np.isfinite(self.force_span) and self.force_span >= 0):
            raise ValueError(f"push: force_span must not be negative, got {self.force_span} s")
        tip = np.ascontiguousarray(self.tip, dtype=float)
        if tip.ndim != 2 or tip.shape[1] != 2 or len(tip) < 2:
            raise ValueError(f"push: tip must have shape (N + 1, 2) with at least one step, got {tip.shape}")
        absent = np.isnan(tip).all(axis=1)
        if not np.isfinite(tip[~absent]).all():
            row = int(np.flatnonzero(~absent & ~np.isfinite(tip).all(axis=1))[0])
            raise ValueError(
                f"push: tip must be finite, or NaN in both columns; row {row} is {tip[row].tolist()}"
            )
        object.__setattr__(self, "tip", tip)
        steps = len(tip) - 1
        for name in ("start_pose", "start_twist"):
            value = np.ascontiguousarray(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ValueError(f"push: {name} must be three finite numbers, got {value}")
            object.__setattr__(self, name, value)
        away = np.hypot(*(tip[~absent] - self.start_pose[:2]).T)
        if len(away) and away.min() > _FARTHEST:
            raise ValueError(
                f"push: the finger stays {away.min():.3g} m from start_pose; are tip and start_pose in m?"
                " A finger that is absent has NaN in both columns"
            )
        if self.pose_times is None:
            object.__setattr__(self, "pose_times", self.h * np.arange(1, steps + 1))
        for name in ("pose_times", "force_times"):
            value = np.ascontiguousarray(getattr(self, name), dtype=float)
            end = steps * self.h * (1 + 1e-9)
            ascending = value.ndim == 1 and bool(np.all(np.diff(value) >= 0))
            if not ascending or (len(value) and not (value[0] >= 0 and value[-1] <= end)):
                raise ValueError(
                    f"push: {name} must be a 1-D array of ascending times between 0 and {end:.6g} s"
                )
            object.__setattr__(self, name, value)
        if self.tip_angle is not None:
            angle = np.ascontiguousarray(self.tip_angle, dtype=float)
            if angle.shape != (steps + 1,) or not np.isfinite(angle).all():
                raise ValueError(
                    f"push: tip_angle must be {steps + 1} finite numbers, one for each row of tip"
                )
            object.__setattr__(self, "tip_angle", angle)
        if self.wrench is not None:
            wrench = np.ascontiguousarray(self.wrench, dtype=float)
            if wrench.shape != (steps, 5):
                raise ValueError(f"push: wrench must have shape ({steps}, 5), got {wrench.shape}")
            if not np.isfinite(wrench).all():
                row = int(np.flatnonzero(~np.isfinite(wrench).all(axis=1))[0])
                raise ValueError(f"push: wrench must be finite; row {row} is {wrench[row].tolist()}")
            object.__setattr__(self, "wrench", wrench)

    @cached_property
    def pose_samples(self) -> tuple[NDArray[np.int64], FloatArray]:
        """(S,) step in which each pose time falls, and (S,) the fraction of that step, 0 to 1."""
        return _sample_steps(self.h, len(self.tip) - 1, self.pose_times)

    @cached_property
    def force_steps(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(T,) first and (T,) last step over which each force is a mean."""
        steps = len(self.tip) - 1
        around = _sample_steps(self.h, steps, self.force_times)[0]
        half = 0.5 * self.force_span * (1 + 1e-9)
        first = np.ceil((self.force_times - half) / self.h - 0.5).astype(np.int64)
        last = np.floor((self.force_times + half) / self.h - 0.5).astype(np.int64)
        within = first <= last
        first, last = np.where(within, first, around), np.where(within, last, around)
        return np.clip(first, 0, steps - 1), np.clip(last, 0, steps - 1)

    @classmethod
    def by_force(
        cls,
        force: ArrayLike,
        point: ArrayLike,
        *,
        duration: float,
        steps: int,
        h: float,
        start_pose: ArrayLike = (0.0, 0.0, 0.0),
        start_twist: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Push:
        """A constant world force (2,) N on an object-frame point (2,) m for `duration` s, then none.

        In the step in which the duration ends, the force is smaller, so that its impulse is exact.

        Raises:
            ValueError: force or point is not a pair, or the duration exceeds the push.
        """
        if not (np.isfinite(h) and h > 0):
            raise ValueError(f"push: the step h must be positive, got {h} s")
        if not 0 <= duration <= steps * h * (1 + 1e-9):
            raise ValueError(f"push: duration must lie between 0 and {steps * h:.6g} s, got {duration}")
        for name, pair in (("force", force), ("point", point)):
            if np.shape(pair) != (2,):
                raise ValueError(f"push: {name} must be a pair (x, y), got {pair!r}")
        wrench = np.zeros((steps, 5))
        share = np.clip(np.round(duration / h - np.arange(steps), 9), 0.0, 1.0)
        wrench[:, :2] = share[:, None] * np.asarray(force)
        wrench[share > 0, 2:4] = np.asarray(point)
        nowhere = np.full((steps + 1, 2), np.nan)
        return cls(h, nowhere, np.asarray(start_pose), np.asarray(start_twist), wrench=wrench)


def join_pushes(
    pushes: Sequence[Push],
    models: int,
    start_poses: FloatArray | None = None,
    start_twists: FloatArray | None = None,
) -> JoinedPushes:
    """Join pushes end to end, as the kernels take them.

    Args:
        pushes: B pushes.
        models: K, for the starts.
        start_poses: (K, B, 3) instead of the pushes' own starts.
        start_twists: (K, B, 3) instead of the pushes' own starts, object frame.

    Raises:
        TypeError: something else than a list of pushes.
        ValueError: there is no push, or starts have the wrong shape.
    """
    check_several("rollout: pushes", pushes, "such as [push]")
    if not pushes:
        raise ValueError("rollout: needs at least one push")
    for index, push in enumerate(pushes):
        check_kind(f"rollout: push {index}", push, Push, "such as a Candidate's push(pose)")
    wrenches = [_NO_WRENCH if push.wrench is None else push.wrench for push in pushes]
    samples, forces = [push.pose_samples for push in pushes], [push.force_steps for push in pushes]
    return JoinedPushes(
        np.array([push.h for push in pushes]),
        np.concatenate([_with_angle(push) for push in pushes]),
        _offsets([len(push.tip) for push in pushes]),
        np.concatenate(wrenches),
        _offsets([len(wrench) for wrench in wrenches]),
        _starts("start_poses", start_poses, [push.start_pose for push in pushes], models),
        _starts("start_twists", start_twists, [push.start_twist for push in pushes], models),
        np.concatenate([step for step, _ in samples]),
        np.concatenate([fraction for _, fraction in samples]),
        np.concatenate([np.asarray(push.pose_times) for push in pushes]),
        _offsets([len(step) for step, _ in samples]),
        np.concatenate([first for first, _ in forces]),
        np.concatenate([last for _, last in forces]),
        _offsets([len(first) for first, _ in forces]),
    )


def _with_angle(push: Push) -> FloatArray:
    """(N + 1, 3) the finger's centre and angle, 0 if it does not turn."""
    return np.column_stack([push.tip, np.zeros(len(push.tip)) if push.tip_angle is None else push.tip_angle])


def _starts(name: str, given: FloatArray | None, own: Sequence[FloatArray], models: int) -> FloatArray:
    """(K, B, 3) the given starts, checked, or the pushes' own for all models."""
    if given is None:
        starts = np.array([own])
        return starts if models == 1 else np.repeat(starts, models, axis=0)
    shape = (models, len(own), 3)
    if np.shape(given) != shape or not np.isfinite(given).all():
        got = np.shape(given) if np.shape(given) != shape else "numbers that are not finite"
        raise ValueError(f"rollout: {name} must be finite and of shape {shape}, got {got}")
    # Read-only arrays are another type to Numba and would have the kernels compiled again.
    return np.require(given, float, ("C", "W"))


def _sample_steps(h: float, steps: int, times: FloatArray | None) -> tuple[NDArray[np.int64], FloatArray]:
    """Step in which each time falls, and the fraction of that step (0 to 1)."""
    assert times is not None
    index = np.clip(np.ceil(times / h - 1e-9).astype(np.int64) - 1, 0, steps - 1)
    return index, np.clip(times / h - index, 0.0, 1.0)


def _offsets(lengths: Sequence[int]) -> NDArray[np.int64]:
    return np.array([0, *accumulate(lengths)], dtype=np.int64)


_NO_WRENCH = np.zeros((0, 5))
