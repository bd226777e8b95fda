"""The next push towards a target, chosen for all hypotheses at once: Algorithm 3, lines 6 to 21.

As in the paper, a finger pushes at a contour cell against the surface normal. The first candidate is the cell
most in line with the required motion of the expected centre of mass, and the others are perturbed. The best
one has the smallest expected distance from the target, over the hypotheses with their probabilities.
`timeout` is a number of candidates, so that the choice does not depend on the computer's speed.

Extensions of the paper: candidates vary in length and slightly in direction; control noise of the finger and
learned model errors are simulated together with the hypotheses; a fall has a cost in each; there may be many
targets, any of which is acceptable; and candidates are compared by the expected number of pushes to a target,
which depends on the gap. The gap alone would favour moving the object close to a target at once, from where
turning it takes more pushes than before.

All lines of push are rolled out for all scenarios in one parallel call, up to the longest push. A slow push
leaves the object where the finger stops, so the poses on the way are the ends of all shorter pushes.

A push that moves the object by δ in its own frame from one pose does so from any other pose at which the
table carries all of it. So the pushes simulated from one pose also predict pushes from every other pose, and
pairs of them predict two pushes (`Lookahead`); the best next push is then found by a nearest-neighbour
search. Where part of the object overhangs, or effects depend on the place, this holds only approximately,
which suffices for looking ahead; the next push itself is simulated from the object's actual pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from slipmap.models.blas import one_blas_thread
from slipmap.models.geometry import compose, relative, turn
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.results import Identification, belief_of
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import balance_margins, own_balance_margins
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import Push, RolloutError, Slider
from slipmap.models.settings import check_kind, finite_array
from slipmap.planners.contact_lines import ContactContour, ContactLines, ways_of_center
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.settings import NEGLIGIBLE, PushSettings
from slipmap.planners.table_push import TablePush
from slipmap.planners.waypoints import PoseMetric

STRIDE = 2.5e-3
"""Distance that the finger travels per time step, m. Compared with steps of 0.5 mm, pushes of the hammer over
0.1 m end within 0.2 mm (95 %), over 0.25 m within 0.4 mm."""

_DRIFTS = 20240607  # seed of the model errors


@dataclass(frozen=True, eq=False)
class Scenarios:
    """S pairs of a hypothesis and a control error of the finger."""

    slider: Slider  # the model
    maps: Maps  # S hypotheses
    probability: FloatArray  # (S,) sums to one
    hypothesis: np.ndarray  # (S,) index in the belief
    centers_of_mass: FloatArray  # (S, 2) object frame, m
    least_margins: FloatArray  # (S,) balance margin below which the object counts as falling, m
    noise: FloatArray  # (S, 3) error of the finger's path: x, y in m, angle about its start in rad
    # (S, 3) model error: x, y (shares of the cells' path) and angle (rad per metre of path), each drawn with
    # one of `Belief.end_errors`; zero if the belief has not learned those
    drift: FloatArray

    @classmethod
    def of(cls, belief: Belief, settings: PushSettings, rng: np.random.Generator) -> Scenarios:
        """Every non-negligible hypothesis, repeated as set; noise and drift have zero mean."""
        kept = np.flatnonzero(belief.probability > NEGLIGIBLE)
        copies = -(-settings.scenarios // len(kept))
        hypothesis = np.tile(kept, copies)
        probability = belief.probability[hypothesis] / belief.probability[hypothesis].sum()
        noise = rng.standard_normal((len(hypothesis), 3))
        noise -= probability @ noise
        noise *= [settings.position_noise, settings.position_noise, np.radians(settings.angle_noise)]
        drift = np.zeros((len(hypothesis), 3))
        if belief.end_errors.any():
            # A separate generator, so that later draws from `rng` are the same with and without drift.
            draws = np.random.default_rng(_DRIFTS)
            drift = draws.standard_normal(drift.shape)
            drift -= probability @ drift
            drift /= np.maximum(np.sqrt(probability @ drift**2), 1e-9)
            size = belief.end_errors[draws.permutation(len(drift)) % len(belief.end_errors)]
            drift = size * (drift - (probability @ (size * drift)) / np.maximum(probability @ size, 1e-12))
        return cls(
            belief.slider,
            belief.maps[hypothesis],
            probability,
            hypothesis,
            belief.centers_of_mass[hypothesis],
            least_margins(belief, settings)[hypothesis],
            noise,
            drift,
        )

    def __len__(self) -> int:
        return len(self.probability)

    def drifted(self, pose: FloatArray, poses: FloatArray) -> FloatArray:
        """(…, S, 3) predicted `poses`, reached from `pose` (3,), displaced by each scenario's drift over the
        path."""
        if not self.drift.any():
            return poses
        way = PoseMetric(self.slider.grid).gap(poses, pose)
        return poses + way[..., None] * self.drift

    def of_hypotheses(self, poses: FloatArray) -> FloatArray:
        """(K', 3) poses (S, 3) averaged over the noise for each simulated hypothesis."""
        numbers = np.unique(self.hypothesis)
        return np.array([poses[self.hypothesis == k].mean(axis=0) for k in numbers])

    def ends(self, poses: FloatArray, falls: NDArray[np.bool_], table: Table) -> PushEnds:
        """The ends of a push at poses (S, 3), world; `falls` (S,) tells where the object falls by then."""
        margins = own_balance_margins(self.slider.grid, self.centers_of_mass, poses, table)
        on_the_way = falls & (margins >= self.least_margins)
        return PushEnds(poses, falls, np.where(on_the_way, 0.0, margins), self.probability)


@dataclass(frozen=True, eq=False)
class Foresight:
    """The predicted results of C lines of push with L lengths in S scenarios."""

    begins: FloatArray  # (C, 2) finger centre before it moves, world, m
    directions: FloatArray  # (C, 2) unit vectors of the finger's motion, world
    lengths: FloatArray  # (L,) distance that the finger travels after first touch, m
    poses: FloatArray  # (C, L, S, 3) of the object at the end, world; NaN where the model has no solution
    fallen: NDArray[np.bool_]  # (C, L, S) whether the balance margin drops below the settings' on the way
    falls: FloatArray  # (C, L) probability of that
    probability: FloatArray  # (S,) of the scenarios
    # (C, L, S, 3) final poses relative to the initial one on a table without a rim; as in `poses` if the rim
    # is not near or `onward` was not set
    moves: FloatArray


def foresee(
    scenarios: Scenarios,
    pose: FloatArray,
    lines: ContactLines,
    table: Table,
    settings: PushSettings,
    *,
    onward: bool = True,
) -> Foresight:
    """Simulate pushing an object at `pose` (3,) along every line.

    Args:
        scenarios: S of them; their model is put on the table.
        pose: of the object, world.
        onward: whether `Foresight.moves` are needed for looking ahead.

    Raises:
        ValueError: a pose that is not finite.
    """
    C, S, L = len(lines), len(scenarios), settings.lengths
    way = settings.approach + settings.longest
    steps = int(np.ceil(way / STRIDE))
    h = way / steps / settings.speed
    lengths = settings.longest * np.arange(1, L + 1) / L
    looks = (settings.approach + lengths) / settings.speed
    looks[-1] = steps * h
    path = np.linspace(0.0, way, steps + 1)
    ahead = compose(pose, np.pad(lines.touches - settings.approach * lines.directions, ((0, 0), (0, 1))))
    begins = ahead[:, :2]
    directions = lines.directions @ turn(pose[2]).T
    pushes = [
        Push(h, begin + np.outer(path, direction), pose, pose_times=looks)
        for begin, direction in zip(begins, directions, strict=True)
    ]
    # A finger displaced by a rigid motion pushes like an undisplaced one on an object and a table moved the
    # other way.
    errors = _control_errors(begins, scenarios.noise)
    starts = relative(errors, pose)
    imagined, tipped_at, reached = _rolled_out(
        scenarios, scenarios.slider.on(table), pushes, starts, L, relative(errors, np.zeros(3))
    )  # fmt: skip
    poses = scenarios.drifted(pose, compose(errors[:, :, None], imagined).transpose(1, 2, 0, 3))
    moves = relative(pose, poses)
    near = np.flatnonzero(reached.any(axis=0))
    if onward and len(near):
        anywhere = [pushes[c] for c in near], starts[:, near], L
        far_off = _rolled_out(scenarios, scenarios.slider.on(None), *anywhere)[0]
        ends = compose(errors[:, near, None], far_off).transpose(1, 2, 0, 3)
        moves[near] = relative(pose, scenarios.drifted(pose, ends))
    tips = tipped_at.T[:, None] <= looks[:, None]
    beyond = np.isfinite(poses).all(axis=-1) & ~_surely_on(poses, scenarios.slider.grid, table)
    centers = np.broadcast_to(scenarios.centers_of_mass, (C, L, S, 2))[beyond]
    margins = own_balance_margins(scenarios.slider.grid, centers, poses[beyond], table)
    tips[beyond] |= margins < np.broadcast_to(scenarios.least_margins, (C, L, S))[beyond]
    fallen = np.logical_or.accumulate(tips, axis=1)
    p = scenarios.probability
    return Foresight(begins, directions, lengths, poses, fallen, fallen @ p, p, moves)


def _surely_on(poses: FloatArray, grid: CellGrid, table: Table) -> np.ndarray:
    """(…) whether a disc around the object at poses (…, 3) lies entirely on the table."""
    size = np.linalg.norm(grid.exterior, axis=1).max()
    return table.margin(poses[..., :2]) >= size


def least_margins(belief: Belief, settings: PushSettings) -> FloatArray:
    """(K,) balance margin below which the object counts as falling, m.

    The margin of the settings, or, for a slender object, which has little margin anywhere, half of the margin
    that the hypothesis has far from any edge if that is smaller.
    """
    everywhere = Table("round", (0.0, 0.0), radius=100.0)
    free = balance_margins(belief.grid, belief.centers_of_mass, np.zeros((1, 3)), everywhere)[0]
    return np.minimum(settings.margin, free / 2)


def _control_errors(begins: FloatArray, noise: FloatArray) -> FloatArray:
    """(S, C, 3) rigid motions of the finger's paths: rotated about their starts (C, 2), then shifted."""
    angle = np.broadcast_to(noise[:, None, 2], (len(noise), len(begins)))
    shift = begins + noise[:, None, :2]
    turned = compose(np.stack([0 * angle, 0 * angle, angle], axis=-1), np.pad(begins, ((0, 0), (0, 1))))
    return np.concatenate([shift - turned[..., :2], angle[..., None]], axis=-1)


def _rolled_out(
    scenarios: Scenarios,
    slider: Slider,
    pushes: list[Push],
    starts: FloatArray,
    looks: int,
    table_poses: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """(S, C, L, 3) poses, NaN for a push that cannot be solved in some scenario; (S, C) time of tipping, s,
    and whether the object comes near the rim. `table_poses` (S, C, 3) as for `Slider.rollout`."""
    shape = len(scenarios), len(pushes)
    try:
        out = slider.rollout(scenarios.maps, pushes, start_poses=starts, table_poses=table_poses)
    except RolloutError:
        if len(pushes) == 1:
            nothing = np.full((*shape, looks, 3), np.nan)
            return nothing, np.full(shape, np.inf), np.zeros(shape, dtype=bool)
        half = len(pushes) // 2
        parts = [
            _rolled_out(
                scenarios, slider, pushes[part], starts[:, part], looks,
                None if table_poses is None else table_poses[:, part],
            )
            for part in (slice(half), slice(half, None))
        ]  # fmt: skip
        poses, tips, reached = (np.concatenate(both, axis=1) for both in zip(*parts, strict=True))
        return poses, tips, reached
    return out.poses.reshape(*shape, looks, 3), out.tips, out.reached


PAIRS = 100_000  # number of pairs of pushes in the look-up


class Lookahead:
    """Expected number of pushes from a pose to a target, looked up among simulated pushes.

    Args:
        foresight: pushes simulated from one pose, of which `moves` is used.
        rng: draws the pairs.
    """

    def __init__(
        self, foresight: Foresight, metric: PoseMetric, settings: PushSettings, rng: np.random.Generator
    ) -> None:
        self._metric = metric
        self._settings = settings
        p = foresight.probability
        moves = foresight.moves.reshape(-1, len(p), 3)
        moves = moves[np.isfinite(moves).all(axis=(1, 2))]
        points = metric.embedding(moves)
        mean = np.einsum("s,msc->mc", p, points)
        spread = np.sqrt(np.einsum("s,msc->m", p, (points - mean[:, None]) ** 2))
        self._one = cKDTree(np.column_stack([mean, spread]))
        likely = np.einsum("s,msc->mc", p, moves)
        first, second = rng.integers(len(moves), size=(2, PAIRS))
        pairs = metric.embedding(compose(likely[first], likely[second]))
        self._two = cKDTree(np.column_stack([pairs, spread[second]]))

    def after(self, poses: FloatArray, targets: FloatArray, *, pairs: bool) -> FloatArray:
        """(…, G) expected pushes from poses (…, 3) to targets (G, 3), via one push or also a pair."""
        seen = self._metric.embedding(relative(poses[..., None, :], targets))
        wanted = np.concatenate([seen, np.zeros((*seen.shape[:-1], 1))], axis=-1)
        left = 1.0 + further_pushes(self._one.query(wanted, workers=2)[0], self._settings)
        if pairs:
            two = 2.0 + further_pushes(self._two.query(wanted, eps=0.2, workers=2)[0], self._settings)
            left = np.minimum(left, two)
        return left


def further_pushes(gap: FloatArray, settings: PushSettings) -> FloatArray:
    """Expected pushes to close remaining gaps (m): none well within the tolerance, one or more beyond it.

    The gap is measured over all cells, the tolerance in position and angle; a gap as large as the tolerance
    is assumed to miss half of the time.
    """
    misses = gap**4 / (gap**4 + settings.tolerance**4)
    return misses * (1.0 + gap / settings.longest)


_TARGETS = 24  # targets examined closely, those that seem to take the fewest pushes
_FAR = 2.5  # expected pushes to the nearest target above which pairs after the next push are looked up
_SHORTER = 0.7  # longest push tried next on a line, as a share of one that was not allowed
_STEP = 2  # every how many lengths the look-up is made
_VARIED = 8  # best lines, around which others are tried
_ROUNDS = 2  # rounds of trying them; the second also varies the best of the first
_SHIFT, _TILT = 0.008, np.radians(6.0)  # standard deviations of the variation, m along the contour and rad


@dataclass(frozen=True, eq=False)
class PushEnds:
    """Where the object may lie after a push, in S scenarios."""

    poses: FloatArray  # (S, 3) world
    falls: NDArray[np.bool_]  # (S,) whether it falls, on the way or at the end
    margins: FloatArray  # (S,) balance margin at the end, m; 0 if it falls only on the way
    probability: FloatArray  # (S,) of the scenarios, sums to one


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """A push and its expected result."""

    push: TablePush  # on the table
    target: int  # index of the target that it serves
    gap: float  # expected distance of the cells from their places in the target after the push, m
    fall_probability: float  # that the object falls on the way or at the end
    # (K, 3) pose after the push in each non-negligible hypothesis, averaged over control noise, world
    predicted: FloatArray
    ends: PushEnds  # the same with control noise
    pushes: float  # expected number of pushes to the target, this one included


@one_blas_thread()
def plan_push(
    belief: Belief | Identification,
    pose: ArrayLike,
    targets: ArrayLike,
    table: Table,
    settings: PushSettings,
    rng: np.random.Generator,
    allowed: Callable[[TablePush], bool] = lambda push: True,
    costs: ArrayLike | None = None,
) -> PlannedPush:
    """Choose a push that brings the object to one of the targets, or nearer to it.

    Args:
        belief: hypotheses, one or many, or what `identify` returned.
        pose: (3,) of the object as the tracker reports it, world, m and rad.
        targets: (3,) or (G, 3) true poses, any of which is acceptable; the predicted poses are true ones too.
        allowed: whether the robot can make a push; called in order of preference until one is found. After a
            refusal, only clearly shorter pushes on the same line are tried.
        costs: (G,) added to the expected number of pushes to each target.

    Returns:
        The push; where each hypothesis expects the object after it, `predicted` (K, 3); the same with control
        noise, `ends`; and the probability that it falls, `fall_probability`.

    Raises:
        NoReachablePush: the finger reaches the object nowhere, no candidate is allowed, or none is predicted.
        TypeError: something other than a belief, a table, settings and a generator; names it.
        ValueError: no target, or an argument of another shape or that is not finite; names it.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> from slipmap.models.measurements import Table
        >>> from slipmap.planners.robust_push import plan_push
        >>> from slipmap.planners.settings import PushSettings
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=0)
        >>> belief = slipmap.identify(dataset, hypotheses=4, friction_laws=False).belief
        >>> table = Table("round", (0.0, 0.0), radius=0.5)
        >>> rng = np.random.default_rng(0)
        >>> planned = plan_push(belief, [0, 0, 0], [0.1, 0.05, 0.3], table, PushSettings(), rng)
        >>> planned.fall_probability, planned.predicted.shape
        (0.0, (4, 3))
    """
    belief = belief_of(belief)
    check_kind("plan_push: table", table, Table, "such as Table('round', (0.0, 0.0), radius=0.5)")
    check_kind("plan_push: settings", settings, PushSettings, "such as PushSettings()")
    check_kind("plan_push: rng", rng, np.random.Generator, "such as np.random.default_rng(0)")
    pose, belief = belief.true_pose(finite_array("plan_push: pose", pose, (3,))), belief.in_world()
    goals = np.atleast_2d(np.asarray(targets, dtype=float))
    if not goals.size or goals.ndim != 2 or goals.shape[1] != 3:
        raise ValueError(f"plan_push: targets must be of shape (3,) or (G, 3), got {np.shape(targets)}")
    finite_array("plan_push: targets", goals, goals.shape)
    extra = np.zeros(len(goals))
    if costs is not None:
        extra = finite_array("plan_push: costs", costs, (len(goals),))
    cone = float(np.radians(settings.cone))
    metric = PoseMetric(belief.grid)
    scenarios = Scenarios.of(belief.on(table), settings, rng)
    contour = ContactContour(belief.grid, belief.finger_radius, settings.approach)

    expected_center = belief.probability @ belief.centers_of_mass
    aligned = contour.nearest_to_axis(expected_center, ways_of_center(expected_center, relative(pose, goals)))
    lines = contour.spread(aligned[: settings.candidates // 2], settings.candidates, cone, rng)
    seen = [foresee(scenarios, pose, lines, table, settings)]
    if not np.isfinite(seen[0].moves).all(axis=(2, 3)).any():
        raise NoReachablePush(f"planning: the model can predict none of {len(lines)} lines of push")
    ahead = Lookahead(seen[0], metric, settings, rng)

    pushes = ahead.after(pose, goals, pairs=True)
    near = np.argsort(pushes + extra, kind="stable")[:_TARGETS]
    far = bool(pushes[near[0]] > _FAR)
    near = near[: _TARGETS // 2] if far else near

    def expected(imagined: Foresight) -> FloatArray:
        return _expected_pushes(imagined, goals[near], extra[near], ahead, metric, settings, far)

    values = [expected(seen[0])]
    for _ in range(_ROUNDS):
        best = np.argsort(np.concatenate(values).min(axis=(1, 2)), kind="stable")[:_VARIED]
        varied = contour.near(lines, best, settings.refinements // _ROUNDS, _SHIFT, _TILT, cone, rng)
        if len(varied):
            seen.append(foresee(scenarios, pose, varied, table, settings, onward=False))
            values.append(expected(seen[-1]))
            lines = lines.joined(varied)
    return _first_allowed(seen, values, goals, near, metric, scenarios, table, settings, allowed)


def _expected_pushes(
    seen: Foresight,
    goals: FloatArray,
    extra: FloatArray,
    ahead: Lookahead,
    metric: PoseMetric,
    settings: PushSettings,
    far: bool,
) -> FloatArray:
    """(C, L, G) expected number of pushes to each target, starting with each push, plus the cost of falls."""
    solved = np.asarray(np.isfinite(seen.poses).all(axis=(2, 3)))
    poses = np.where(solved[..., None, None], seen.poses, 0.0)
    gaps = metric.gaps(poses, goals)
    follow = np.einsum("clsg,s->clg", further_pushes(gaps, settings), seen.probability)
    # Later pushes are looked up for some lengths only, because neighbouring lengths differ little.
    likely = np.einsum("clsx,s->clx", poses[:, ::_STEP], seen.probability)
    follow[:, ::_STEP] = np.minimum(follow[:, ::_STEP], ahead.after(likely, goals, pairs=far))
    value = 1.0 + follow + extra + settings.fall_cost * seen.falls[..., None]
    return np.where(solved[..., None], value, np.inf)


def _first_allowed(
    seen: list[Foresight],
    values: list[FloatArray],
    goals: FloatArray,
    near: np.ndarray,
    metric: PoseMetric,
    scenarios: Scenarios,
    table: Table,
    settings: PushSettings,
    allowed: Callable[[TablePush], bool],
) -> PlannedPush:
    """The best push that the robot can make."""
    value = np.concatenate([v.min(axis=2) for v in values])
    served = np.concatenate([v.argmin(axis=2) for v in values])
    poses = np.concatenate([s.poses for s in seen])
    falls = np.concatenate([s.falls for s in seen])
    fallen = np.concatenate([s.fallen for s in seen])
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
            longest[line] = _SHORTER * pushed
            continue
        target = int(near[served[line, length]])
        ends = poses[line, length]
        return PlannedPush(
            push=push,
            target=target,
            gap=float(scenarios.probability @ metric.gap(ends, goals[target])),
            fall_probability=min(1.0, float(falls[line, length])),
            predicted=scenarios.of_hypotheses(ends),
            ends=scenarios.ends(ends, fallen[line, length], table),
            pushes=float(value[line, length]),
        )
    raise NoReachablePush(f"planning: the robot can make none of {value.size} candidate pushes")
