"""The next push towards a target, chosen for all hypotheses at once: Algorithm 3, lines 6 to 21.

As in the paper, a finger pushes at a cell of the contour against the surface normal; the first candidate is
the cell most in line with the way of the expected centre of mass, the others are perturbed, and the best is
the one that the hypotheses, weighed by their probabilities, expect nearest to the target. `timeout` is a
number of candidates, so that the choice does not depend on the machine.

Beyond the paper: candidates vary in length and a little in direction; the finger's control noise is imagined
together with the hypotheses; falling costs in each; there may be many targets, any of which will do; and
what is compared is the expected number of pushes to a target (`lookahead`), into which the gap enters.
Without that, the object would be pushed near to a target at once, from where turning it takes more pushes
than before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.inference.belief import Belief
from models.measurements.push_dataset import Table
from models.physics.cell_grid import FloatArray
from planners.contact_lines import ContactContour, joined, ways_of_center
from planners.exploration import NoReachablePush
from planners.foresight import Foresight, Scenarios, foresee
from planners.lookahead import Lookahead, further_pushes
from planners.pose_metric import PoseMetric, relative
from planners.pregrasp_settings import PushSettings
from planners.table_push import TablePush

TARGETS = 24
"""Targets that are looked at closely, those that seem to take the fewest pushes."""

FAR = 2.5
"""Expected pushes to the nearest target above which pairs of pushes are looked up to follow the next."""

SHORTER = 0.7
"""Of the length of a push that is not allowed, what is asked for next on the same line at most."""

STEP = 2
"""Lengths of a push from one that is looked up to the next."""

VARIED = 8
"""Best lines, around which others are tried."""

ROUNDS = 2
"""In which these are tried; the second around the best of the first, too."""

SHIFT, TILT = 0.008, np.radians(6.0)
"""Standard deviations of these from those, m along the contour and rad."""


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """A push and what is expected of it.

    Attributes:
        push: on the table.
        target: index of the target that it serves.
        gap: expected distance of the cells from where they are in the target, after the push, m.
        fall_probability: that the object falls on the way or at the end.
        predicted: (K, 3) pose after the push in each hypothesis that is not negligible, without control noise
            on average, world.
        pushes: expected number of pushes to the target, this one included.
    """

    push: TablePush
    target: int
    gap: float
    fall_probability: float
    predicted: FloatArray
    pushes: float


def plan_push(
    belief: Belief,
    pose: FloatArray,
    targets: FloatArray,
    table: Table,
    settings: PushSettings,
    rng: np.random.Generator,
    allowed: Callable[[TablePush], bool] = lambda push: True,
    costs: FloatArray | None = None,
) -> PlannedPush:
    """Choose a push that brings the object to one of the targets, or nearer to it.

    Args:
        belief: hypotheses, one or many.
        pose: (3,) where the object lies, world, m and rad.
        targets: (3,) or (G, 3) poses, any of which will do.
        table: that it must not fall from.
        settings: what pushes are like.
        rng: source of every draw.
        allowed: whether the robot can make a push; asked in order of preference until one is found. Where a
            push is not allowed, only clearly shorter ones on the same line are asked for.
        costs: (G,) what is to be added to the expected number of pushes to a target.

    Raises:
        NoReachablePush: the finger reaches the object nowhere, or no candidate is allowed.
    """
    goals = np.atleast_2d(np.asarray(targets, dtype=float))
    extra = np.zeros(len(goals)) if costs is None else np.asarray(costs, dtype=float)
    cone = float(np.radians(settings.cone))
    metric = PoseMetric(belief.grid)
    scenarios = Scenarios.of(belief, settings, rng)
    contour = ContactContour(belief.grid, belief.finger_radius, settings.approach)

    expected_center = belief.probability @ belief.centers_of_mass
    aligned = contour.nearest_to_axis(expected_center, ways_of_center(expected_center, relative(pose, goals)))
    lines = contour.spread(aligned[: settings.candidates // 2], settings.candidates, cone, rng)
    seen = [foresee(scenarios, pose, lines, table, settings)]
    ahead = Lookahead(seen[0], pose, metric, settings, rng)

    pushes = ahead.after(pose, goals, pairs=True)
    near = np.argsort(pushes + extra, kind="stable")[:TARGETS]
    far = bool(pushes[near[0]] > FAR)
    near = near[: TARGETS // 2] if far else near
    values = [_expected_pushes(seen[0], goals[near], extra[near], ahead, metric, settings, far)]

    for _ in range(ROUNDS):
        best = np.argsort(np.concatenate(values).min(axis=(1, 2)), kind="stable")[:VARIED]
        varied = contour.near(lines, best, settings.refinements // ROUNDS, SHIFT, TILT, cone, rng)
        if len(varied):
            seen.append(foresee(scenarios, pose, varied, table, settings))
            values.append(_expected_pushes(seen[-1], goals[near], extra[near], ahead, metric, settings, far))
            lines = joined(lines, varied)
    return _first_allowed(seen, values, goals, near, metric, scenarios, settings, allowed)


def _expected_pushes(
    seen: Foresight,
    goals: FloatArray,
    extra: FloatArray,
    ahead: Lookahead,
    metric: PoseMetric,
    settings: PushSettings,
    far: bool,
) -> FloatArray:
    """(C, L, G) expected number of pushes to each target if it begins with this one; a fall costs."""
    solved = np.asarray(np.isfinite(seen.poses).all(axis=(2, 3)))
    poses = np.where(solved[..., None, None], seen.poses, 0.0)
    gaps = metric.gaps(poses, goals)
    follow = np.einsum("clsg,s->clg", further_pushes(gaps, settings), seen.probability)
    # What follows is looked up for some lengths only: neighbours are alike.
    likely = np.einsum("clsx,s->clx", poses[:, ::STEP], seen.probability)
    follow[:, ::STEP] = np.minimum(follow[:, ::STEP], ahead.after(likely, goals, pairs=far))
    value = 1.0 + follow + extra + settings.fall_cost * seen.falls[..., None]
    return np.where(solved[..., None], value, np.inf)


def _first_allowed(
    seen: list[Foresight],
    values: list[FloatArray],
    goals: FloatArray,
    near: np.ndarray,
    metric: PoseMetric,
    scenarios: Scenarios,
    settings: PushSettings,
    allowed: Callable[[TablePush], bool],
) -> PlannedPush:
    """The best push that the robot can make."""
    value = np.concatenate([v.min(axis=2) for v in values])
    served = np.concatenate([v.argmin(axis=2) for v in values])
    poses = np.concatenate([s.poses for s in seen])
    falls = np.concatenate([s.falls for s in seen])
    begins = np.concatenate([s.begins for s in seen])
    directions = np.concatenate([s.directions for s in seen])
    longest = np.full(len(value), np.inf)
    for index in np.argsort(value, axis=None, kind="stable"):
        line, length = np.unravel_index(index, value.shape)
        if not np.isfinite(value[line, length]):
            break
        pushed = seen[0].lengths[length]
        if pushed > longest[line]:
            continue
        push = TablePush(
            begins[line], begins[line] + (settings.approach + pushed) * directions[line], settings.speed
        )
        if not allowed(push):
            longest[line] = SHORTER * pushed
            continue
        target = int(near[served[line, length]])
        ends = poses[line, length]
        return PlannedPush(
            push=push,
            target=target,
            gap=float(scenarios.probability @ metric.gap(ends, goals[target])),
            fall_probability=min(1.0, float(falls[line, length])),
            predicted=scenarios.of_hypotheses(ends),
            pushes=float(value[line, length]),
        )
    raise NoReachablePush(f"planning: the robot can make none of {value.size} candidate pushes")
