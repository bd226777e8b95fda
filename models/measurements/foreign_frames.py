"""Object and finger recorded in different frames: which rotation or reflection would bring them together.

A finger that pushes is at the object's outline. If it is not, but would be in nearly all pushes once the
object's poses were transformed by

    p' = R(α) S p + t,    θ' = s θ + δ,    S = diag(1, ±1),    s = ±1,

the two were probably recorded in frames of which one is rotated or mirrored. α and t follow from positions of
object and finger (Procrustes), which differ by the object's size at most; δ is scanned, and all are refined
so that the finger touches the outline while the object moves.

If each has the other's place in the recording, the object sets out before the finger does.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from slipmap.models.geometry import angle_between, rotated
from slipmap.models.measurements.contact import CALIBRATION_ERROR, ContactRows
from slipmap.models.measurements.motion import spread_rows
from slipmap.models.measurements.push_dataset import Setup, gaps
from slipmap.models.measurements.trial import Channel
from slipmap.models.physics.cell_grid import FloatArray

_FEWEST_PUSHES, _MOST_PUSHES = 4, 40  # that are looked at
_ROWS_EACH = 8  # of a push that are looked at
_MOST_TOUCH = 0.8  # share of the pushes in which the finger must touch with a correction
_HALF = 0.5  # share in which it does without, from which on there is nothing to correct
_STARTS = 24  # values of δ that are tried
_REFINED = 3  # of them, the best, that are refined
_FAR = 0.05  # m at which gaps are clipped
_SMALL = np.radians(5.0)  # rotations that calibration may leave
_EXACT = np.radians(2.0)  # from a multiple of a right angle
_NO_SHIFT = 0.01  # m
_SETS_OUT, _NOISES_OUT = 5e-3, 6.0  # m, and standard deviations of noise, from its first place
_FIRST, _LONG_FIRST = 0.05, 0.15  # s by which an object sets out first in most pushes, and in some
_MIRRORED = (
    "y of the object's poses negated",
    "x and y of the object's poses swapped",
    "x of the object's poses negated",
    "x and y of the object's poses swapped and negated",
)
"""Reflections in y followed by none to three quarter turns."""
EFFECT_TURN, EFFECT_SHIFT = 0.6, 0.1
"""Angle, rad, and shift, m, up to which the effect `tracker_shift` reaches."""


class FrameChange(NamedTuple):
    """A transform of the object's poses after which the finger touches the object."""

    angle: float  # α, rad
    shift: FloatArray  # (2,) t, m
    mirrored: bool  # whether S negates y
    turn: float  # δ, rad
    reversed: bool  # whether s is -1
    touching: int  # pushes in which the finger then touches the object
    pushes: int  # that were looked at

    @property
    def explained(self) -> bool:
        """Whether the effect `tracker_shift` describes it."""
        follows = not self.reversed and abs(angle_between(self.turn, self.angle)) < _SMALL
        near = abs(self.angle) < EFFECT_TURN and np.hypot(*self.shift) < EFFECT_SHIFT
        return bool(not self.mirrored and follows and near)

    @property
    def words(self) -> str:
        """The transform as a question to the user, with its evidence."""
        if self.mirrored and abs(np.sin(2.0 * self.angle)) < np.sin(2.0 * _EXACT):
            change = _MIRRORED[round(float(self.angle) / (0.5 * np.pi)) % 4]
        else:
            degrees = round(float(np.degrees(self.angle)))
            shown = abs(degrees) if degrees == -180 else degrees
            change = f"the object's poses {'mirrored in y, then ' * self.mirrored}rotated by {shown}°"
        if np.hypot(*self.shift) > _NO_SHIFT:
            x, y = (round(1e3 * float(value)) for value in self.shift)
            change += f", then shifted by ({x}, {y}) mm"
        usual = self.reversed == self.mirrored and abs(angle_between(self.turn, self.angle)) < _SMALL
        if not self.reversed and abs(self.turn) < _SMALL:
            change += " and theta kept"
        elif not usual:
            degrees = round(float(np.degrees(self.turn)))
            change += (
                f" and theta replaced by {'-' * self.reversed}theta{f' {degrees:+d}°' if degrees else ''}"
            )
        elif self.mirrored:
            change += " and theta mirrored too"
        effect = " If not, the effect tracker_shift may describe it" if self.explained else ""
        return (
            "the finger is not at the object's outline while the object moves; the finger would touch it"
            f" in {self.touching} of {self.pushes} pushes with {change}: do object and finger share a frame?"
            f"{effect}"
        )


def frame_change(setup: Setup, pushes: Sequence[ContactRows]) -> FrameChange | None:
    """The rotation or reflection of the object's frame with which the finger touches the object while it
    moves in nearly all pushes; None if it does so as recorded in half of them, or if there is none.

    Args:
        setup: with the outline and the finger's radius.
        pushes: rows of each push, from `contact_rows`.
    """
    if not (moving := _apart(setup, pushes)):
        return None
    places = np.concatenate([rows.poses for rows in moving])
    tips = np.concatenate([rows.tips for rows in moving])
    found = [
        fitted
        for mirrored, reversed_ in product((False, True), repeat=2)
        if (fitted := _fitted(setup, moving, places, tips, mirrored, reversed_)) is not None
    ]
    best = max(found, key=lambda one: one.touching, default=None)
    if best is None or best.touching < _MOST_TOUCH * len(moving):
        return None
    return best if best.mirrored or abs(best.angle) > _SMALL else None


def exchanged(setup: Setup, pushes: Sequence[ContactRows]) -> str | None:
    """Evidence, as a clause, that object and finger are exchanged or that the finger's clock is late: in most
    pushes the object sets out first, and the finger is not at its outline; else None.

    Args:
        setup, pushes: as for `frame_change`.
    """
    if not _apart(setup, pushes):
        return None
    leads = []
    for rows in pushes:
        far = max(_SETS_OUT, _NOISES_OUT * rows.noise.position)
        tip, pose = (_sets_out(track, far) for track in (rows.trial.tip_pose, rows.trial.object_pose))
        if tip is not None and pose is not None and not rows.trial.ends_only:
            leads.append(tip - pose)
    first = sum(lead > _FIRST for lead in leads)
    if len(leads) < _FEWEST_PUSHES or first < _MOST_TOUCH * len(leads) or max(leads) < _LONG_FIRST:
        return None
    return (
        f"the object moves before the finger does in {first} of {len(leads)} pushes, by up to"
        f" {max(leads):.2g} s; are the columns of object and finger exchanged, or is the finger's clock late?"
    )


def _sets_out(track: Channel, far: float) -> float | None:
    """When a track first is `far` m from its first place, s; None if it never is."""
    away = np.flatnonzero(np.hypot(*(track.values[:, :2] - track.values[0, :2]).T) > far)
    return float(track.time[away[0]]) if len(away) else None


def _apart(setup: Setup, pushes: Sequence[ContactRows]) -> list[ContactRows]:
    """Some rows of the pushes on which the object moves; empty if the finger is at the outline in half of
    them, or if they are too few."""
    moving = [_moving(rows) for rows in pushes if rows.pressed.any()]
    if len(moving) < _FEWEST_PUSHES:
        return []
    moving = [moving[k] for k in spread_rows(len(moving), _MOST_PUSHES)]
    touching = _touching(setup, moving, [rows.poses for rows in moving])
    return [] if touching >= _HALF * len(moving) else moving


def _moving(rows: ContactRows) -> ContactRows:
    pressed = np.flatnonzero(rows.pressed)
    return rows.chosen(pressed[spread_rows(len(pressed), _ROWS_EACH)])


def _touching(setup: Setup, pushes: Sequence[ContactRows], poses: Sequence[FloatArray]) -> int:
    """Number of pushes in which the finger is at the outline on most rows."""
    each = [np.median(np.abs(gaps(setup, rows.tips, own))) for rows, own in zip(pushes, poses, strict=True)]
    allowed = [max(rows.allowed, CALIBRATION_ERROR) for rows in pushes]
    return int(sum(gap <= least for gap, least in zip(each, allowed, strict=True)))


def _changed(poses: FloatArray, values: FloatArray, mirrored: bool, reversed_: bool) -> FloatArray:
    """Poses (k, 3) transformed with α, t and δ in `values` (4,)."""
    places = poses[:, :2] * [1.0, -1.0 if mirrored else 1.0]
    theta = (-poses[:, 2] if reversed_ else poses[:, 2]) + values[3]
    return np.column_stack([rotated(places, values[0]) + values[1:3], theta])


def _fitted(
    setup: Setup,
    pushes: Sequence[ContactRows],
    poses: FloatArray,
    tips: FloatArray,
    mirrored: bool,
    reversed_: bool,
) -> FrameChange | None:
    """The best transform of one kind; None if positions are too close together to show a rotation."""
    from scipy.optimize import least_squares

    places = poses[:, :2] * [1.0, -1.0 if mirrored else 1.0]
    middle, aim = places.mean(axis=0), tips.mean(axis=0)
    one, other = places - middle, tips - aim
    along = float(np.sum(one * other))
    across = float(np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]))
    if np.hypot(along, across) < len(places) * setup.reach**2:
        return None
    angle = float(np.arctan2(across, along))
    shift = aim - rotated(middle, angle)

    def residuals(values: FloatArray) -> FloatArray:
        gap = gaps(setup, tips, _changed(poses, values, mirrored, reversed_))
        return 1e3 * np.clip(gap, -_FAR, _FAR)

    starts = [np.array([angle, *shift, delta]) for delta in 2 * np.pi * np.arange(_STARTS) / _STARTS]
    starts.sort(key=lambda start: float(np.abs(residuals(start)).mean()))
    scale = np.array([0.01, 1e-3, 1e-3, 0.01])
    refined = [
        least_squares(residuals, start, x_scale=scale, loss="soft_l1", max_nfev=40).x
        for start in starts[:_REFINED]
    ]
    results = []
    for values in refined:
        changed = [_changed(rows.poses, values, mirrored, reversed_) for rows in pushes]
        touching = _touching(setup, pushes, changed)
        angles = angle_between(values[[0, 3]], 0.0)
        results.append(
            FrameChange(
                float(angles[0]), values[1:3], mirrored, float(angles[1]), reversed_, touching, len(pushes)
            )
        )
    return max(results, key=lambda one: one.touching)
