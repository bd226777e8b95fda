"""Whether recorded finger and object fit together: depth of the finger's rim in the outline over whole
pushes, its common cause, and the angle of the force to the contact normal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from slipmap.models.geometry import angle_between, compose, rotated, seen_from
from slipmap.models.measurements.lasting_noise import NONE_LASTS, PoseNoise, noise_of_poses
from slipmap.models.measurements.motion import pose_scatter, spread_rows
from slipmap.models.measurements.push_dataset import Setup, gaps
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.physics.cell_grid import FloatArray

CALIBRATION_ERROR = 3e-3  # m; good laboratories reach 2 mm

_MOST_ROWS = 500  # of a trial
_NEAR = 1e-3  # m of air up to which a row counts as contact
_DEEPEST_SHARE = 0.05  # of those rows may be spoilt by jitter
_WINDOW = 0.1  # s over which speeds are taken
_MOVING = 0.3  # share of the 90th percentile of the object's speed
_SLOWEST = 2e-3  # m/s
_GAP_ROWS = 3.0  # usual steps without a pose, beyond which rows in the gap are skipped
_LARGEST_NOISE, _LARGEST_TURN = 3e-3, 0.05  # m and rad; larger scatter is not sensor noise
_BURST = 3.0  # times the mean speed between two poses, at most, while it moves
_LARGEST_KINK = 1e-3  # m that the object may be off a straight line between two poses, besides noise

# Common cause of all pushes.
_MOST_TRIALS, _ROWS_EACH = 40, 25  # most trials used, and rows of each
_LARGEST_GAP, _LARGEST_DEPTH = 0.01, 0.03  # m; larger values are clipped
_LARGEST_LAG = 0.15  # s
_MOST_OF_RADIUS = 0.8  # largest share of the stated radius by which a finger can be thinner
_GAIN, _GAIN_UNSIZED = 0.6, 0.75  # share of the misfit that may be left, with and without a fitted size
_LEAST_GAIN = 5e-4  # m
_MOST_LEFT = 5e-3  # m of misfit that a correction may leave
_AS_GOOD = 1.2  # times the least misfit, accepted for a simpler cause

_OFF_NORMAL = np.pi / 3.0  # beyond any friction of a finger
_FEWEST_FORCES = 10  # rows
_SOME_WRONG = 0.2  # share of rows beyond that angle, if some other frame makes
_WOULD_FIT = 0.85  # of the rows fit; beyond half of the rows it is reported anyway


@dataclass(frozen=True, eq=False)
class ContactRows:
    """A trial at times for which both finger and object are known.

    Attributes:
        trial: the push.
        time: (k,) s.
        tips: (k, 2) finger, m.
        poses: (k, 3) object.
        pressed: (k,) whether the object moves, so that the finger must touch it unless it coasts.
        gap: (k,) gap between them, m, negative inside.
        noise: of the poses.
        allowed: depth that calibration and the noise of poses and finger allow, m.
    """

    trial: Trial
    time: FloatArray
    tips: FloatArray
    poses: FloatArray
    pressed: NDArray[np.bool_]
    gap: FloatArray
    noise: PoseNoise
    allowed: float

    @property
    def deepest(self) -> float:
        """Greatest depth of the rim, m; negative if there is a gap."""
        return -float(np.min(self.gap))

    @property
    def depth(self) -> float:
        """Depth that one in twenty rows of contact exceeds, m."""
        if self.trial.ends_only:  # after its last row the finger may have moved on or back
            return max(-float(self.gap[0]), -float(self.gap[-1]) - CALIBRATION_ERROR)
        near = np.sort(self.gap[self.gap < _NEAR])
        if len(near) < 3:
            return self.deepest
        return -float(near[max(1, int(np.ceil(_DEEPEST_SHARE * len(near))))])

    def chosen(self, rows: NDArray[np.int_]) -> ContactRows:
        """Some of the rows."""
        return ContactRows(
            self.trial, self.time[rows], self.tips[rows], self.poses[rows], self.pressed[rows],
            self.gap[rows], self.noise, self.allowed,
        )  # fmt: skip


def contact_rows(setup: Setup, trials: Sequence[Trial]) -> list[ContactRows]:
    """The finger's rows with poses interpolated at their times, of each trial that has a finger.

    Where only the ends are known, these two rows.
    """
    usual = noise_of_poses(setup, trials)
    return [_contact_rows(setup, trial, usual) for trial in trials if trial.finger_near(setup.reach)]


def _contact_rows(setup: Setup, trial: Trial, usual: PoseNoise) -> ContactRows:
    pose, tip = trial.object_pose, trial.tip_pose
    begin, end = pose.time[[0, -1]]
    noise = _noise_of_track(setup, pose, usual)
    if trial.ends_only:
        time = np.array([begin, end])
    else:
        time = tip.time[(tip.time >= begin) & (tip.time <= end)]
        if len(time) < len(pose.time) / 4:
            time = pose.time
        time = np.concatenate([[begin], time[time > begin]])
        time = time[spread_rows(len(time), _MOST_ROWS)]
        after = np.clip(np.searchsorted(pose.time, time), 1, len(pose.time) - 1)
        step = pose.time[after] - pose.time[after - 1]
        kink = _LARGEST_KINK + 3.0 * noise.of_changes(1)[0]
        known = (step <= _GAP_ROWS * np.median(np.diff(pose.time))) | np.isin(time, pose.time)
        time = time[known & (_kinks(setup, pose, time, after) <= kink)]
    tips, poses = tip.at(time), pose.at(time)
    if trial.ends_only:  # the finger mostly stops where it pushed the object to
        pressed = np.array([False, not np.array_equal(pose.values[0], pose.values[-1])])
    else:
        pressed = _moving(setup, pose, time, noise)
    beside = noise.position, setup.noise.tip or 0.0, setup.noise.outline or 0.0
    allowed = CALIBRATION_ERROR + 3.0 * float(np.linalg.norm(beside))
    return ContactRows(trial, time, tips, poses, pressed, gaps(setup, tips, poses), noise, allowed)


def _noise_of_track(setup: Setup, pose: Channel, usual: PoseNoise) -> PoseNoise:
    """Noise of the poses of one push: declared, or as usual where it lasts; otherwise from the scatter of
    neighbouring rows of this push and their rounding."""
    scatter = np.zeros(3)
    if len(pose.time) > 2 and None in (setup.noise.position, setup.noise.angle):
        scatter = pose_scatter(pose.time, pose.values)
    position, angle = usual.position, usual.angle
    if setup.noise.position is None:
        lasts = usual.lasting_position != NONE_LASTS
        white = float(np.hypot(scatter[0], scatter[1])) / np.sqrt(2.0)
        position = min(position if lasts else white, _LARGEST_NOISE)
    if setup.noise.angle is None:
        lasts = usual.lasting_angle != NONE_LASTS
        angle = min(angle if lasts else float(scatter[2]), _LARGEST_TURN)
    return replace(usual, position=position, angle=angle)


def _kinks(setup: Setup, pose: Channel, time: FloatArray, after: NDArray[np.int_]) -> FloatArray:
    """(k,) how far the object may be from the straight line between two poses, m.

    An object that changes speed between two poses moves along two lines, those of the intervals before and
    after. At a share s of the interval Δt these are s Δt |v - v_before| and (1 - s) Δt |v_after - v| away. If
    it starts or stops anywhere in the interval, it is up to s Δt |v| or (1 - s) Δt |v| away, near the other
    end no farther than it gets at `_BURST` |v|. It rests before the first pose and after the last.

    Args:
        after: (k,) the row of the pose that follows each time.
    """
    velocity = np.diff(pose.values * [1.0, 1.0, setup.reach], axis=0) / np.diff(pose.time)[:, None]
    change = np.linalg.norm(np.diff(velocity, axis=0, prepend=0.0, append=0.0), axis=1)
    before, behind = change[after - 1], change[after]
    step = pose.time[after] - pose.time[after - 1]
    passed = time - pose.time[after - 1]
    speed = np.pad(np.linalg.norm(velocity, axis=1), 1)
    own, previous, following = speed[after], speed[after - 1], speed[after + 1]
    starts = np.where(previous < 0.5 * own, np.minimum(passed, _BURST * (step - passed)) * own, 0.0)
    stops = np.where(following < 0.5 * own, np.minimum(_BURST * passed, step - passed) * own, 0.0)
    bent = np.minimum(passed * before, (step - passed) * behind)
    return np.asarray(np.maximum(bent, np.maximum(starts, stops)))


def _moving(setup: Setup, pose: Channel, time: FloatArray, noise: PoseNoise) -> NDArray[np.bool_]:
    window = max(_WINDOW, 2.0 * float(np.median(np.diff(pose.time))))
    late = np.minimum(time + 0.5 * window, pose.time[-1])
    early = np.maximum(time - 0.5 * window, pose.time[0])
    step = pose.at(late) - pose.at(early)
    reach = 0.5 * setup.reach
    moved = np.hypot(step[:, 0], step[:, 1]) + reach * np.abs(step[:, 2])
    position, angle = noise.of_changes(window / float(np.median(np.diff(pose.time))))
    least = 4.0 * float(np.hypot(position, reach * angle))
    speed = moved / np.maximum(late - early, 1e-9)
    return np.asarray((speed > max(_SLOWEST, _MOVING * float(np.percentile(speed, 90)))) & (moved > least))


# The common cause of all pushes.

FRAME_WRONG = ("sign", "turn", "mirror")
"""Kinds of causes that mean a wrong object frame or outline, which no effect explains."""

_SIZED = ("lag", "radius", "tip_offset", "tracker_offset")


class Cause(NamedTuple):
    """A correction that would make the finger touch the object in all pushes."""

    text: str  # a question to the user
    kind: str  # sign, turn, mirror, lag, radius, tip_offset or tracker_offset
    applied: Callable[[Setup, ContactRows], FloatArray]  # the gaps after correction


def common_cause(setup: Setup, pushes: Sequence[ContactRows], deep: int) -> Cause | None:
    """The simplest known cause that removes most of the depth and air in all pushes, or None.

    If the finger is deep in only one push, only causes without a fitted size count; others fit anything.
    """
    places = spread_rows(len(pushes), _MOST_TRIALS)
    all_rows = [pushes[place] for place in places]
    thinned = [_thinned(rows) for rows in all_rows]
    thinned = [rows for rows in thinned if len(rows.time)]
    if not thinned:
        return None
    before = _misfit(setup, thinned, lambda setup, rows: gaps(setup, rows.tips, rows.poses))
    tried = [(cause, _misfit(setup, thinned, cause.applied)) for cause in _causes(setup, thinned)]
    least = min(misfit for _, misfit in tried)
    for cause, misfit in tried:
        if deep < 2 and cause.kind in _SIZED:
            continue
        needed = _GAIN if cause.kind in _SIZED else _GAIN_UNSIZED
        explains = misfit < min(needed * before, before - _LEAST_GAIN, _MOST_LEFT)
        if explains and misfit <= _AS_GOOD * least + 1e-4 and _touches(setup, all_rows, cause):
            return cause
    return None


def _touches(setup: Setup, pushes: Sequence[ContactRows], cause: Cause) -> bool:
    """Whether, with a correction, the finger is at the object while it moves, in most of the pushes; where
    noise hides the motion, at any time.

    A correction that takes the finger far away makes it go nowhere deep either.
    """
    apart = []
    for rows in pushes:
        gap = np.abs(cause.applied(setup, rows))
        apart.append(float(np.median(gap[rows.pressed]) if rows.pressed.any() else np.min(gap)))
    return float(np.median(apart)) < _LARGEST_GAP


def _thinned(rows: ContactRows) -> ContactRows:
    """Informative rows: contact, or motion with the finger near."""
    telling = np.flatnonzero((rows.gap < 0.0) | (rows.pressed & (rows.gap < 2.0 * _LARGEST_GAP)))
    if len(telling) > _ROWS_EACH:
        telling = telling[spread_rows(len(telling), _ROWS_EACH)]
    return rows.chosen(telling)


def _residual(rows: ContactRows, gap: FloatArray) -> FloatArray:
    return np.clip(gap, -_LARGEST_DEPTH, np.where(rows.pressed, _LARGEST_GAP, 0.0))


def _misfit(
    setup: Setup, pushes: Sequence[ContactRows], applied: Callable[[Setup, ContactRows], FloatArray]
) -> float:
    """Mean over pushes of the rms of depth and air, m, with at most 20 mm per push."""
    each = [np.sqrt(np.mean(_residual(rows, applied(setup, rows)) ** 2)) for rows in pushes]
    return float(np.mean(np.minimum(each, 0.02)))


def _causes(setup: Setup, pushes: Sequence[ContactRows]) -> Iterator[Cause]:
    """All causes, each with its best size, the simplest first."""

    def posed(change: Callable[[FloatArray], FloatArray]) -> Callable[[Setup, ContactRows], FloatArray]:
        return lambda setup, rows: gaps(setup, rows.tips, change(rows.poses))

    yield Cause("is theta's sign right?", "sign", posed(lambda poses: poses * [1.0, 1.0, -1.0]))
    for angle in (90, -90, 180):  # correction of theta
        turn = np.array([0.0, 0.0, np.radians(angle)])
        yield Cause(
            f"is theta, or the outline, rotated by {-angle if abs(angle) == 90 else 180}°?",
            "turn",
            posed(turn.__add__),
        )
    for axis, sides in (("x", (-1.0, 1.0)), ("y", (1.0, -1.0))):
        yield Cause(f"is the outline mirrored in {axis}?", "mirror", partial(_mirrored, sides=sides))
    if not all(rows.trial.ends_only for rows in pushes):
        yield _lag(setup, pushes)
        (less,) = _fitted(setup, pushes, 1, _thinner_finger)
        size = "large" if less > 0.0 else "small"
        if less < _MOST_OF_RADIUS * setup.finger_radius:
            yield Cause(
                f"is finger.radius {1e3 * (setup.finger_radius - less):.1f} mm rather than"
                f" {1e3 * setup.finger_radius:.1f} mm, or is the outline too {size}?",
                "radius",
                lambda setup, rows: _thinner_finger(setup, rows, np.array([less])),
            )
    shift = _fitted(setup, pushes, 2, _shifted_tip)
    yield Cause(
        f"tip_offset {_millimetres(shift)} mm, which the effect tracker_shift explains; was the fingertip"
        " recorded, not the flange or the tool?",
        "tip_offset",
        lambda setup, rows: _shifted_tip(setup, rows, shift),
    )
    offset = _fitted(setup, pushes, 3, _offset_frame)
    turned = round(float(np.degrees(offset[2])), 1) + 0.0
    yield Cause(
        f"the tracked frame lies at {_millimetres(offset[:2])} mm in the object frame, rotated by"
        f" {turned:.1f}°, which the effect tracker_offset explains; is the outline in the tracked frame?",
        "tracker_offset",
        lambda setup, rows: _offset_frame(setup, rows, offset),
    )


def _millimetres(lengths: FloatArray) -> str:
    return f"({', '.join(f'{round(1e3 * float(length), 1) + 0.0:g}' for length in lengths)})"


def _lag(setup: Setup, pushes: Sequence[ContactRows]) -> Cause:
    def late(lag: float) -> Callable[[Setup, ContactRows], FloatArray]:
        return lambda setup, rows: gaps(setup, rows.tips, rows.trial.object_pose.at(rows.time + lag))

    best = 0.0
    for step in (0.02, 0.005, 0.001):
        tried = best + step * np.arange(-8, 9) if step == 0.02 else best + step * np.arange(-4, 5)
        tried = tried[np.abs(tried) <= _LARGEST_LAG + 0.02]
        best = float(min(tried, key=lambda lag: _misfit(setup, pushes, late(float(lag)))))
    size = f"{1e3 * abs(best):.0f} ms"
    return Cause(
        f"are the object's poses stamped {size} late?" if best > 0 else f"is the finger stamped {size} late?",
        "lag",
        late(best),
    )


def _mirrored(setup: Setup, rows: ContactRows, sides: tuple[float, float]) -> FloatArray:
    """Gaps if x or y of the outline has the other sign."""
    return gaps(setup, seen_from(rows.tips, rows.poses) * sides, np.zeros(3))


def _thinner_finger(setup: Setup, rows: ContactRows, less: FloatArray) -> FloatArray:
    return gaps(setup, rows.tips, rows.poses) + less[0]


def _shifted_tip(setup: Setup, rows: ContactRows, shift: FloatArray) -> FloatArray:
    return gaps(setup, rows.tips - shift, rows.poses)


def _offset_frame(setup: Setup, rows: ContactRows, offset: FloatArray) -> FloatArray:
    """Gaps if the tracked frame lies at `offset` (3,) in the object frame."""
    back = np.append(rotated(-offset[:2], -offset[2]), -offset[2])
    return gaps(setup, rows.tips, compose(rows.poses, back))


def _fitted(
    setup: Setup,
    pushes: Sequence[ContactRows],
    count: int,
    applied: Callable[[Setup, ContactRows, FloatArray], FloatArray],
) -> FloatArray:
    """Parameters (count,) of least misfit, robust to single pushes and rows."""
    from scipy.optimize import least_squares

    scale = np.array([1e-3, 1e-3, 1e-2])[:count]

    def residuals(scaled: FloatArray) -> FloatArray:
        each = [_residual(rows, applied(setup, rows, scale * scaled)) for rows in pushes]
        return 1e3 * np.concatenate([part / np.sqrt(len(part)) for part in each])

    found = least_squares(residuals, np.full(count, 0.1), loss="soft_l1", f_scale=0.3, max_nfev=40)
    return np.asarray(scale * found.x)


# The force.


def force_complaint(setup: Setup, pushes: Sequence[ContactRows]) -> str | None:
    """Message if the direction of the force is wrong on most rows, otherwise None."""
    normal, force, theta = normals_and_forces(setup, pushes)
    if len(normal) < _FEWEST_FORCES:
        return None
    off = angle_between(force, normal)
    wrong = float(np.mean(np.abs(off) > _OFF_NORMAL))
    if wrong < _SOME_WRONG:
        return None
    best, fits = None, _WOULD_FIT
    for words, angle in _other_frames(force, normal, theta):
        share = float(np.mean(np.abs(angle_between(angle, normal)) < _OFF_NORMAL))
        if share > fits + (0.05 if best else 0.0):
            best, fits = words, share
    if best is None and wrong < 0.5:
        return None
    said = (
        f"the force points a median of {np.degrees(np.median(np.abs(off))):.0f}° off the contact normal, and"
        f" more than 60°, which no friction allows, on {100 * wrong:.0f} % of the rows; "
    )
    if best is None:
        return (
            f"{said}no rotation or reflection corrects it. ft_wrench must be the force of the finger on the"
            " object in the world frame; is it in the sensor's or the tool's?"
        )
    return (
        f"{said}{best} {100 * fits:.0f} % would fit; ft_wrench must be the force of the finger on the object"
        " in the world frame"
    )


def _other_frames(
    force: FloatArray, normal: FloatArray, theta: FloatArray
) -> Iterator[tuple[str, FloatArray]]:
    """Likely frame and sign errors, the likeliest first, and the directions of the force without them,
    rad."""
    yield "with its sign reversed, as if it were the force of the object on the finger,", force + np.pi
    turn = -middle_angle(angle_between(force, normal))
    degrees = 15.0 * round(float(np.degrees(angle_between(turn, 0.0))) / 15.0)
    yield f"rotated by about {degrees:.0f}°, as if from the sensor's or the tool's frame,", force + turn
    for words, sum_ in (
        ("fx negated", np.pi), ("fy negated", 0.0), ("fx and fy swapped", 0.5 * np.pi),
        ("fx and fy swapped and negated", -0.5 * np.pi),
    ):  # fmt: skip
        yield f"with {words}", sum_ - force
    yield "rotated by theta, as if from the object frame,", force + theta


def middle_angle(angles: FloatArray) -> float:
    """The dominant angle: the mean of those within 60° of the densest direction, rad."""
    centers = np.radians(np.arange(-180, 180, 5))
    near = np.abs(angle_between(angles[:, None], centers)) < _OFF_NORMAL
    center = centers[np.argmax(near.sum(axis=0))]
    apart = angle_between(angles, center)
    return float(center + np.mean(apart[np.abs(apart) < _OFF_NORMAL]))


def normals_and_forces(
    setup: Setup, pushes: Sequence[ContactRows]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions of inward normal, force and object in the world frame while the finger presses, (k,) rad
    each."""
    each = [_normals_and_forces(setup, rows) for rows in pushes]
    normal, force, theta = (np.concatenate([one[k] for one in each] or [np.zeros(0)]) for k in range(3))
    return normal, force, theta


def _normals_and_forces(setup: Setup, rows: ContactRows) -> tuple[FloatArray, FloatArray, FloatArray]:
    trial = rows.trial
    empty = (np.zeros(0), np.zeros(0), np.zeros(0))
    if trial.ft_wrench is None or trial.ends_only:
        return empty
    force = trial.ft_wrench.at(rows.time)[:, :2]
    inside = (rows.time >= trial.ft_wrench.time[0]) & (rows.time <= trial.ft_wrench.time[-1])
    size = np.hypot(*force.T)
    enough = max(0.3 * float(size.max(initial=0.0)), 3.0 * (setup.noise.force or 0.0))
    distance = rows.gap + setup.finger_radius
    used = inside & rows.pressed & (size > enough) & (np.abs(rows.gap) < 2.0 * CALIBRATION_ERROR)
    used &= np.abs(distance) > 1e-3  # closer to the rim, its direction is uncertain
    if not used.any():
        return empty
    points = seen_from(rows.tips[used], rows.poses[used])
    lines = shapely.shortest_line(shapely.points(points), setup.grid.polygon.boundary)
    ends = shapely.get_coordinates(lines).reshape(-1, 2, 2)
    towards = np.sign(distance[used])[:, None] * (ends[:, 1] - ends[:, 0])
    direction = np.arctan2(towards[:, 1], towards[:, 0]) + rows.poses[used, 2]
    return direction, np.arctan2(force[used, 1], force[used, 0]), rows.poses[used, 2]
