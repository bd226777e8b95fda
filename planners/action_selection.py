"""Choice of the next push on an unknown object: Algorithm 2 of Song and Boularias (IROS 2020).

`choose_push` takes one of the candidates of `slipmap.planners.exploration`.

In the paper a force is a vector of 3n numbers, so two pushes on different cells always differ by the same
amount. Here `most-different` measures the intended distance: between contact points and directions in the
object frame, where shifting the contact point by the object's radius of gyration counts as much as turning
the direction by 60°.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slipmap.models.blas import one_blas_thread
from slipmap.models.geometry import placed, radius_of_gyration, rotated, turn
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.observations import LONGEST_STEP, LONGEST_STRIDE
from slipmap.models.inference.results import Identification, belief_of
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import own_balance_margins
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Maps, Push, RolloutError, Rollouts, Slider
from slipmap.models.settings import check_kind, check_several, finite_array
from slipmap.planners.exploration import Candidate, NoReachablePush, candidate_pushes
from slipmap.planners.rehearsal import AFTERWARDS, RAMP, sampled_push
from slipmap.planners.settings import NEGLIGIBLE, STRATEGIES, PokeSettings
from slipmap.planners.table_push import TablePush

if TYPE_CHECKING:
    from slipmap.planners.telling_push import Question

_SAFE = 0.02  # m; least balance margin after a push, which may end some millimetres off
_FARTHEST = 2.0  # times the finger's way and the object's own after that; no point of it goes farther
_RESTING = 1e-3  # m/s; no point of an object at rest moves faster in a simulation
_COASTING, _COASTS = 2.0, 10  # s for which it slides on at a time, and how often, until it counts as lost
_TOUCH_WAY = 0.004  # m that a tap continues slowly past the expected touch, which may be wrong
# Where a finger touches so far elsewhere, m, a robust push ends no more than so many times farther away. Most
# amplify it by less than 2, and those on which the finger may slip off a corner by 3 to 50.
_ELSEWHERE, _MAGNIFIED = 1e-3, 3.0


@dataclass(frozen=True, eq=False)
class Choice:
    """A chosen push, and where it meets the object."""

    push: TablePush  # on the table
    contact: FloatArray  # (2,) point of first touch, object frame, m
    direction: FloatArray  # (2,) of the finger's motion, object frame
    why: str = ""  # reason for the choice if the push is to tell models apart; else empty

    def __deepcopy__(self, memo: object) -> Choice:
        return self


@one_blas_thread()
def choose_push(
    grid: CellGrid,
    pose: ArrayLike,
    finger_radius: float,
    *,
    strategy: str = "most-distinctive",
    belief: Belief | Identification | None = None,
    past: Sequence[Choice] = (),
    settings: PokeSettings | None = None,
    tap: bool | None = None,
    question: Question | None = None,
    table: Table | None = None,
    allowed: Callable[[TablePush], bool] = lambda push: True,
    rng: np.random.Generator,
) -> Choice:
    """Choose the next push (Algorithm 2).

    Without past pushes, or without a belief if the strategy needs one, the choice is random. A push after
    which the object could fall from the table is not chosen: all hypotheses that are not negligible must keep
    it balanced by 20 mm, or by no less than before. Without a belief, its whole outline must stay on the
    table, or no less of it.
    A push that ends elsewhere if the finger touches 1 mm to the side is the last choice: hypotheses disagree
    on it, but its end depends on the outline more than on the maps.

    Args:
        pose: (3,) of the object as the tracker reports it, world, m and rad; the push is made where the
            object is expected to be (`Belief.true_pose`).
        finger_radius: m.
        strategy: one of `STRATEGIES`.
        belief: hypotheses that `most-distinctive` compares, or what `identify` returned.
        past: pushes made so far, as `choose_push` returned them.
        settings: constraints on the pushes to learn from.
        tap: whether to make a tap; by default as the settings say for the number of past pushes. If the robot
            can make none of the taps, a slow push is chosen instead.
        question: models that the push should tell apart; overrides the strategy. Such a push is slow, because
            the finger must stay in contact.
        table: its top; that of the belief if None. If neither is known, nothing is known to fall.
        allowed: whether the robot can make a push; called in order of preference until one is found.

    Raises:
        NoReachablePush: no candidate is allowed.
        TypeError: a cell grid, belief, table, generator or past push of another kind; names it.
        ValueError: an unknown strategy, or a pose that is not three finite numbers.
    """
    if strategy not in STRATEGIES:
        raise ValueError(f"unknown strategy {strategy!r}; choose one of {', '.join(STRATEGIES)}")
    check_kind("choose_push: grid", grid, CellGrid, "such as belief.grid")
    check_several("choose_push: past", past, "such as [choice]")
    for choice in past:
        check_kind("choose_push: a past push", choice, Choice, "such as choose_push returns")
    if table is not None:
        check_kind("choose_push: table", table, Table, "such as Table('round', (0.0, 0.0), radius=0.5)")
    habits = settings or PokeSettings()
    pose = reported = finite_array("choose_push: pose", pose, (3,))
    if belief is not None:
        belief = _likely(belief_of(belief))
        pose, belief = belief.true_pose(reported), belief.in_world()
    contacts = candidate_pushes(
        grid, finger_radius, rng, habits.candidates, length=(habits.shortest, habits.longest),
        speed=(habits.slowest, habits.fastest), cone=float(np.radians(habits.cone)), approach=habits.approach,
    )  # fmt: skip
    tapping = habits.is_tap(len(past)) if tap is None else tap
    tapping = tapping and question is None
    choices = [_choice(contact, pose, habits.tap_speed if tapping else None) for contact in contacts]
    choices = [choice for choice in choices if _stays(choice, grid, pose, habits)]
    table = table if table is not None or belief is None else belief.table
    if table is not None:
        safe = _balanced(choices, pose, grid, finger_radius, belief, table)
        choices = [choice for choice, stays in zip(choices, safe, strict=True) if stays]
    if not choices:
        worth = np.zeros(0)
    elif question is not None:
        order = question.habits.pushes
        worth = question.told_by([_imagined(choice.push, reported, order) for choice in choices])
    elif strategy == "most-different" and past:
        worth = _differences(choices, past, grid)
    elif strategy == "most-distinctive" and belief is not None and past:
        worth = _disagreements(choices, pose, belief)
    else:
        worth = rng.random(len(choices))
    robust = _robust(choices, pose, grid, finger_radius, belief)
    for index in np.lexsort((-worth, ~robust)):
        if allowed(choices[index].push):
            if question is None:
                return choices[index]
            why = f"to tell {question.words}: {worth[index]:.1f} standard deviations"
            return replace(choices[index], why=why)
    if tapping:
        return choose_push(
            grid, pose, finger_radius, strategy=strategy, belief=belief, past=past, settings=settings,
            tap=False, table=table, allowed=allowed, rng=rng,
        )  # fmt: skip
    raise NoReachablePush(
        f"exploration: {len(choices)} of {len(contacts)} candidate pushes keep the object in its region"
        " and safe on the table, and the robot can make none of them"
    )


def _choice(candidate: Candidate, pose: FloatArray, tap_speed: float | None) -> Choice:
    """The candidate as a push on the table; a tap if `tap_speed` is given."""
    begin, end = candidate.way_at(pose, candidate.length)
    creep = 0.0 if tap_speed is None else candidate.approach + min(_TOUCH_WAY, candidate.length / 2)
    push = TablePush(begin, end, tap_speed or candidate.speed, creep)
    return Choice(push, candidate.contact, candidate.direction)


def _stays(choice: Choice, grid: CellGrid, pose: FloatArray, settings: PokeSettings) -> bool:
    """Whether the object's centroid ends in the region, or nearer to it than before."""
    middle = pose[:2] + turn(pose[2]) @ grid.centers.mean(axis=0) - np.asarray(settings.center)
    after = middle + choice.push.direction * (choice.push.length - settings.approach)
    return bool(np.hypot(*after) < max(settings.region, np.hypot(*middle)))


def _balanced(
    choices: Sequence[Choice],
    pose: FloatArray,
    grid: CellGrid,
    finger_radius: float,
    belief: Belief | None,
    table: Table,
) -> NDArray[np.bool_]:
    """(S,) whether the object stays safe on the table after each push, see `choose_push`."""
    if not choices:
        return np.zeros(0, dtype=bool)
    if belief is None:
        slider, maps = _uniform(grid, finger_radius, table)
    else:
        slider, maps = belief.on(table).slider, belief.maps
    farthest = _FARTHEST * max(_way(choice.push, slider, maps) for choice in choices)
    if table.margin(placed(grid.exterior, pose)).min() > farthest:
        return np.ones(len(choices), dtype=bool)
    try:
        ends, falls = _at_rest(choices, pose, slider, maps)
    except RolloutError:
        return np.zeros(len(choices), dtype=bool)
    places = np.concatenate([ends, np.broadcast_to(pose, (len(maps), 1, 3))], axis=1)
    if belief is None:
        margins = table.margin(placed(grid.exterior, places[..., None, :])).min(axis=-1)
    else:
        margins = own_balance_margins(grid, belief.centers_of_mass[:, None], places, table)
    after, before = margins[:, :-1], margins[:, -1:]
    wanted = np.minimum(0.0 if belief is None else _SAFE, before)
    return np.asarray(((after >= wanted) & ~falls).all(axis=0))


def _way(push: TablePush, slider: Slider, maps: Maps) -> float:
    """The finger's way, and the longest, v² / (2 µ g), on which the object then slides on by itself, m."""
    mu = (maps.mass * maps.mu).sum(axis=1) / maps.mass.sum(axis=1)
    return push.length + push.speed**2 / (2.0 * slider.gravity * max(float(mu.min()), 1e-6))


def _at_rest(
    choices: Sequence[Choice], pose: FloatArray, slider: Slider, maps: Maps
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(K, S, 3) where each push leaves the object once that rests, world; (K, S) whether it falls on the way,
    or never rests."""
    rollouts = slider.rollout(maps, [_imagined(choice.push, pose) for choice in choices])
    ends, falls, tipped = rollouts.end.copy(), _tips_on_the_way(rollouts), rollouts.tipped
    steps = round(_COASTING / LONGEST_STEP)
    for _ in range(_COASTS):
        moving = np.flatnonzero((_slides(ends, slider.grid) & ~tipped).any(axis=0))
        if not len(moving):
            return ends[..., :3], falls
        resting = [np.tile(choices[int(k)].push.end, (steps + 1, 1)) for k in moving]
        more = slider.rollout(
            maps, [Push(LONGEST_STEP, tip, pose) for tip in resting],
            start_poses=ends[:, moving, :3], start_twists=ends[:, moving, 3:],
        )  # fmt: skip
        ends[:, moving] = more.end
        falls[:, moving] |= _tips_on_the_way(more)
        tipped[:, moving] |= more.tipped
    return ends[..., :3], falls | (_slides(ends, slider.grid) & ~tipped)


def _slides(states: FloatArray, grid: CellGrid) -> NDArray[np.bool_]:
    """(…) whether a point of the object may move, by its poses and twists (…, 6)."""
    speed = np.hypot(states[..., 3], states[..., 4]) + grid.reach * np.abs(states[..., 5])
    return np.asarray(speed > _RESTING)


def _likely(belief: Belief) -> Belief:
    """The belief without its negligible hypotheses, which could forbid every push."""
    p = belief.probability
    kept = np.flatnonzero(p > NEGLIGIBLE)
    if len(kept) == len(belief):
        return belief
    return replace(belief, maps=belief.maps[kept], probability=p[kept] / p[kept].sum())


def _tips_on_the_way(rollouts: Rollouts) -> NDArray[np.bool_]:
    """(K, S) whether the object tips over the rim during each push; a hypothesis by which it did so before
    the push must be wrong."""
    return rollouts.tipped & (rollouts.tips > 0)


def _robust(
    choices: Sequence[Choice], pose: FloatArray, grid: CellGrid, finger_radius: float, belief: Belief | None
) -> NDArray[np.bool_]:
    """(S,) whether each push ends about where it should if the finger touches a little elsewhere."""
    if not choices:
        return np.zeros(0, dtype=bool)
    if belief is None:
        slider, maps = _uniform(grid, finger_radius, None)
    else:
        best = int(np.argmax(belief.probability))
        slider, maps = belief.slider, belief.maps[best : best + 1]
    ways = _ELSEWHERE * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    pushes = [_imagined(choice.push, pose) for choice in choices]
    beside = [replace(push, tip=push.tip + rotated(way, pose[2])) for push in pushes for way in ways]
    try:
        ends = slider.rollout(maps, beside).end[0, :, :3].reshape(len(choices), len(ways), 3)
    except RolloutError:
        return np.zeros(len(choices), dtype=bool)
    off = add(ends[:, 1:], ends[:, :1], grid.centers).max(axis=1)
    return np.asarray(off <= _MAGNIFIED * _ELSEWHERE)


def _uniform(grid: CellGrid, finger_radius: float, table: Table | None) -> tuple[Slider, Maps]:
    """A uniform object of the grid's outline, for pushes before anything is learned."""
    n = len(grid)
    maps = Maps(np.full((1, n), 1.0 / n), np.full((1, n), 0.3), np.array([0.3]))
    return Slider(grid, finger_radius, table=table), maps


def _differences(choices: Sequence[Choice], past: Sequence[Choice], grid: CellGrid) -> FloatArray:
    """(S,) distance of each candidate from the nearest past push (Algorithm 2, line 6)."""
    gyration = radius_of_gyration(grid)

    def features(many: Sequence[Choice]) -> FloatArray:
        return np.array([np.concatenate([p.contact / gyration, p.direction]) for p in many])

    between = features(choices)[:, None] - features(past)[None]
    return np.linalg.norm(between, axis=-1).min(axis=1)


def _disagreements(choices: Sequence[Choice], pose: FloatArray, belief: Belief) -> FloatArray:
    """(S,) mean distance (ADD) between the poses that pairs of hypotheses predict for each push, lines 9 to
    19.

    Pairs are weighted by their probabilities, so that unlikely hypotheses do not decide.
    """
    pushes = [_imagined(choice.push, pose) for choice in choices]
    try:
        rollouts = belief.slider.rollout(belief.maps, pushes)
    except RolloutError:
        return np.zeros(len(choices))
    ends = rollouts.end[..., :3].transpose(1, 0, 2)
    pairs = add(ends[:, :, None], ends[:, None, :], belief.grid.centers)
    weights = np.outer(belief.probability, belief.probability)
    # A push that tips the object over the table's rim teaches nothing.
    return np.where(_tips_on_the_way(rollouts).any(axis=0), 0.0, (pairs * weights).sum(axis=(1, 2)))


def _imagined(push: TablePush, pose: FloatArray, order: float = 0.0) -> Push:
    """A push to simulate, sampled as in a fit; `order` is its place in the experiment."""
    pace = push.pace(push.speed / RAMP, push.speed / RAMP)
    h = min(LONGEST_STEP, LONGEST_STRIDE / push.speed)
    times = h * np.arange(np.ceil((pace.duration + AFTERWARDS) / h) + 1)
    return sampled_push(h, times, push.begin + np.outer(pace.at(times), push.direction), pose, order)
