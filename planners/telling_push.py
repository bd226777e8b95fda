"""The most informative push: which push a person should make next after a diagnosis, and how.

It depends on the verdict:

- Several effects left: the push that maximises the smallest difference between the predictions of two of
  them.
- One effect: the push that shows its least certain parameter best, with everything else refitted to that
  parameter.
- Undecided: the push that best shows the effects that the recorded pushes show least.
- Unknown: the push with the largest residual, repeated with a change in the quantity that the residual
  depends on.
- Adequate: none.

Proposed pushes are like the recorded ones in place, length and speed (`Habits`). A robot cannot put the
object elsewhere, so it ranks the pushes that it can make by a `Question` (`robots_question`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import shapely

from slipmap.models.blas import one_blas_thread
from slipmap.models.effects import LIBRARY, Scene
from slipmap.models.effects.effect import Effect, bounds, scales
from slipmap.models.geometry import angle_between, placed, turn
from slipmap.models.inference.diagnosis import procedure
from slipmap.models.inference.diagnosis.results import Diagnosis, parameter_estimates
from slipmap.models.inference.error_model import ErrorModel
from slipmap.models.inference.identification import with_fewer_cells
from slipmap.models.inference.observations import SAMPLES, Observation
from slipmap.models.inference.prior import slider_for
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import Push
from slipmap.models.progress import Progress, silent
from slipmap.planners.exploration import Candidate, NoReachablePush, candidate_pushes
from slipmap.planners.rehearsal import (
    Habits,
    Predictions,
    Rival,
    habits_of,
    keeps_touch,
    predict,
    separations,
    straight_push,
)

OF_FORCE = frozenset(effect.name for effect in LIBRARY if effect.belongs_to == "force sensor")
"""Effects that move nothing, so a robot that wants to move objects need not settle them."""

MISPLACED = np.array([[2e-3, 0, 0.03], [-2e-3, 0, -0.03], [0, 2e-3, -0.03], [0, -2e-3, 0.03]])
"""m, rad by which a person may misplace the object; a push must tell the rivals apart even then."""

_CANDIDATES, _FINALISTS = 300, 12
_CONTACTS = 60
_HARDLY_SEEN = 5  # most effects to compare
_LEADING = 2  # effects that a robot tells apart if the verdict is undecided
_LEADS = 2.0  # nats that such an effect must gain
_DWELL = 0.5  # s for which the finger stops half-way
_TOLD = 1.0  # standard deviations of the error below which models are predicted alike
_SHARES = (1.0, 0.5, -0.5)  # of the way to another place, tried in turn
_APPROACH = 0.01  # m between finger and object at the start


@one_blas_thread()
def diagnose(
    dataset: PushDataset,
    *,
    effects: Sequence[Effect | str] = LIBRARY,
    draws: int = 199,
    quick: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose a dataset and plan the next push: everything that `slipmap diagnose` computes.

    Args:
        dataset, effects, draws, quick, seed, progress: as for `slipmap.models.inference.diagnosis.diagnose`.

    Raises:
        DatasetError, EffectError, ValueError: as for that function.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=3, heldout=1)
        >>> slipmap.diagnose(dataset, quick=True, draws=99).verdict
        'undecided'
    """
    result = procedure.diagnose(
        dataset, effects=effects, draws=draws, quick=quick, seed=seed, progress=progress
    )
    report = progress or silent
    report("planning the next push", 0, 1)
    push, hopeless = next_push(result, dataset, seed)
    report("planning the next push", 1, 1)
    return replace(result, next_push=push, hopeless=hopeless)


def next_push(
    diagnosis: Diagnosis, dataset: PushDataset, seed: int
) -> tuple[dict[str, Any] | None, str | None]:
    """The push that a person should make next, and the models that no push would tell apart.

    Args:
        seed: of the candidate pushes.

    Returns:
        The push: None if there is nothing to find out, or if no push can be made or would tell; else plain
        numbers, world frame, m and s:
        `pose` (x, y, theta) at which to put the object, `contact` (x, y) on its outline in the object frame,
        `tip_start` and `tip_end` (x, y) of the finger's centre, `direction_deg` of its motion, `speed`,
        `length` from first touch to stop, `dwell` half-way (0 for none), `separates` (names), `separation` in
        standard deviations of the error model, and a `sentence` with all of this.
        The models that no push like the recorded ones would tell apart, in words; else None.
    """
    if diagnosis.verdict == "adequate" or diagnosis.fault is not None:
        return None, None
    observations = diagnosis.base.likelihood.observations
    habits = habits_of(observations, dataset)
    rng = np.random.default_rng(seed)
    if diagnosis.verdict == "unknown":
        return _worst_repeated(diagnosis, dataset, habits), None
    question = _question(diagnosis, dataset, habits)
    rivals = question.rivals
    if not question.pairs:  # no effect could be refitted beside the model without
        return None, None
    try:
        # Fewer candidates if there are many models, to limit the time.
        count = _CANDIDATES // 3 if diagnosis.quick or len(rivals) > 4 else _CANDIDATES
        mu_finger = float(Rival.of(diagnosis.base).maps.mu_finger[0])
        chosen = _instructions(dataset, habits, mu_finger, count, rng)
    except NoReachablePush:
        return None, None
    # Ends of an interval may be close: a push that narrows it is worth making.
    least = 0.0 if diagnosis.verdict == "effect" else _TOLD
    found = _most_telling(question, chosen, diagnosis.coarseness, least)
    if found is None:
        return None, question.words
    best, separation, told = found
    predictions = [predict(rival, [best.push(float(habits.pushes))]) for rival in told.rivals]
    named = told.rivals[1:] if diagnosis.verdict == "undecided" else told.rivals
    names = [rival.name for rival in named]
    asked = best.to_json() | {"separates": names, "separation": separation}
    good_for = question.good_for
    separated = {rival.name for rival in told.rivals}
    if alike := [rival.name for rival in rivals if rival.name not in separated]:
        *more, last = alike
        good_for += f", but not {', '.join(more)}{' or ' * bool(more)}{last}"
    return asked | {"sentence": _sentence(asked, dataset.grid, told.rivals, predictions, good_for)}, None


def rivals_of(diagnosis: Diagnosis, dataset: PushDataset) -> list[Rival]:
    """The models whose predictions for the next push are worth comparing; none for an adequate model."""
    if diagnosis.verdict == "adequate":
        return []
    if diagnosis.verdict == "unknown":
        return [Rival.of(diagnosis.base)]
    habits = habits_of(diagnosis.base.likelihood.observations, dataset)
    return list(_question(diagnosis, dataset, habits).rivals)


@dataclass(frozen=True, eq=False)
class Question:
    """Models that a push should tell apart, and a measure of how well a push does so."""

    rivals: tuple[Rival, ...]  # the models
    pairs: tuple[tuple[int, int], ...]  # of them that count
    good_for: str  # purpose of the push, such as `best tells the models apart`
    error: ErrorModel  # of observed trajectories
    grid: CellGrid  # the object
    habits: Habits  # statistics of the recorded pushes

    @property
    def words(self) -> str:
        """The models to tell apart, such as `table_tilt from tether`."""
        *names, last = [rival.name for rival in self.rivals]
        return f"{names[0]} from {last}" if len(names) == 1 else f"{', '.join(names)} and {last} apart"

    def told_by(self, pushes: Sequence[Push]) -> FloatArray:
        """(B,) separation of the pair that differs least, in standard deviations of the error model; 0 for
        pushes in which the finger slides off, unless it does so in all."""
        return np.asarray(self.apart(pushes).min(axis=0))

    def apart(self, pushes: Sequence[Push]) -> FloatArray:
        """(pairs, B) the same for each of the pairs that count."""
        predicted = [predict(rival, pushes) for rival in self.rivals]
        apart = separations(predicted, pushes, self.error, self.grid, self.habits)
        place = {pair: k for k, pair in enumerate(combinations(range(len(self.rivals)), 2))}
        apart = apart[[place[pair] for pair in self.pairs]]
        kept = [all(keeps_touch(push, p.forces[b]) for p in predicted) for b, push in enumerate(pushes)]
        return np.where(kept, apart, 0.0) if any(kept) else apart

    def only(self, pairs: Sequence[tuple[int, int]]) -> Question:
        """The question for some of the pairs, without models that are in none of them."""
        left = sorted({k for pair in pairs for k in pair})
        renamed = tuple((left.index(one), left.index(other)) for one, other in pairs)
        return replace(self, rivals=tuple(self.rivals[k] for k in left), pairs=renamed)


def robots_question(diagnosis: Diagnosis, dataset: PushDataset) -> Question | None:
    """The models that a robot's next pushes should tell apart.

    With several effects left, these effects. With one, the models with and without it, because the robot must
    be sure that the effect is present. If the verdict is `undecided`, the `_LEADING` effects that gain most,
    in ordinary size, and the model without any; effects of the force sensor move nothing and do not count.

    Returns:
        None if there is nothing to tell apart: `adequate` and `unknown`.
    """
    if diagnosis.verdict in ("adequate", "unknown"):
        return None
    habits = habits_of(diagnosis.base.likelihood.observations, dataset)
    base = Rival.of(diagnosis.base)
    if diagnosis.verdict == "effect":
        best = diagnosis.best
        return Question(
            (Rival.of(best), base), ((0, 1),), "best shows it", best.likelihood.error, dataset.grid, habits
        )
    gains = [
        (c.gain if c.fitted_gain is None else c.fitted_gain, c.name)
        for c in diagnosis.candidates
        if c.name not in OF_FORCE
    ]
    leading = [name for gain, name in sorted(gains, reverse=True)[:_LEADING] if gain > _LEADS]
    if diagnosis.verdict == "undecided" and leading:
        rivals = (*_of_ordinary_size(diagnosis, dataset, habits, leading), base)
        pairs = tuple(combinations(range(len(rivals)), 2))
        error = diagnosis.best.likelihood.error
        return Question(rivals, pairs, "best tells the models apart", error, dataset.grid, habits)
    return _question(diagnosis, dataset, habits)


def push_of(asked: dict[str, Any], order: float = 0.0) -> Push:
    """The push that `next_push` returned, to simulate; `order` is its place in the experiment."""
    begin, end = np.array(asked["tip_start"]), np.array(asked["tip_end"])
    return straight_push(
        np.array(asked["pose"]), begin, end, asked["speed"], dwell=asked["dwell"], order=order
    )


@dataclass(frozen=True, eq=False)
class Instruction:
    """A push that a person is asked to make, and where to put the object for it."""

    pose: FloatArray  # (3,) at which to put the object, world, m and rad
    contact: FloatArray  # (2,) first point of its outline to be touched, object frame, m
    # begin, end: (2,) finger centre at the start and at the end, world, m
    begin: FloatArray
    end: FloatArray
    speed: float  # of the finger, m/s
    length: float  # distance that the finger travels from first touch to its stop, m
    dwell: float  # duration of the stop half-way, s

    @classmethod
    def of(cls, push: Candidate, pose: FloatArray, speed: float, length: float, dwell: float) -> Instruction:
        """A candidate on an object that lies at a pose (3,)."""
        begin, end = push.way_at(pose, length)
        return cls(pose, push.contact, begin, end, speed, length, dwell)

    def push(self, order: float, misplaced: FloatArray | None = None, *, coarseness: float = 1.0) -> Push:
        """The push to simulate, optionally with the object misplaced (3,) or in longer time steps."""
        pose = self.pose if misplaced is None else self.pose + misplaced
        return straight_push(
            pose, self.begin, self.end, self.speed, dwell=self.dwell, order=order, coarseness=coarseness
        )

    def to_json(self) -> dict[str, Any]:
        """As plain numbers, the first part of what `next_push` returns."""
        way = self.end - self.begin
        return {
            "pose": self.pose.tolist(),
            "contact": self.contact.tolist(),
            "direction_deg": float(np.degrees(np.arctan2(way[1], way[0]))),
            "speed": float(self.speed),
            "length": float(self.length),
            "dwell": float(self.dwell),
            "tip_start": self.begin.tolist(),
            "tip_end": self.end.tolist(),
        }


def _instructions(
    dataset: PushDataset, habits: Habits, mu_finger: float, count: int, rng: np.random.Generator
) -> list[Instruction]:
    """Random pushes that stay in the region of the recorded ones and on the table.

    Half of them come in pairs that differ only by half a turn, because many effects differ on a reversed
    push.
    """
    cone = float(np.clip(0.9 * np.arctan(mu_finger), 0.05, np.pi / 4))
    contacts = candidate_pushes(
        dataset.grid, dataset.finger_radius, rng, _CONTACTS, cone=cone, approach=_APPROACH
    )
    found: list[Instruction] = []
    for _ in range(20 * count):
        if len(found) >= count:
            break
        contact = contacts[int(rng.integers(len(contacts)))]
        yaw = float(rng.uniform(-np.pi, np.pi))
        length = float(rng.uniform(*habits.lengths))
        speed = habits.speeds[int(rng.integers(3))]
        dwell = _DWELL if rng.random() < 0.25 else 0.0
        for turned in (0.0, np.pi) if rng.random() < 1 / 3 else (0.0,):
            angle = float(angle_between(yaw, -turned))
            place = _place(habits, length * turn(angle) @ contact.direction, rng)
            proposal = Instruction.of(contact, np.array([*place, angle]), speed, length, dwell)
            if _on_table(proposal, dataset):
                found.append(proposal)
    if not found:
        raise NoReachablePush("planning: none of the random pushes stays on the table")
    return found[:count]


def _place(habits: Habits, move: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A start from which a move ends in the region too; if it does not fit, the move is centred there."""
    low, high = habits.low - np.minimum(move, 0.0), habits.high - np.maximum(move, 0.0)
    middle = 0.5 * (habits.low + habits.high) - 0.5 * move
    return np.where(low < high, rng.uniform(np.minimum(low, high), np.maximum(low, high)), middle)


def _on_table(proposal: Instruction, dataset: PushDataset) -> bool:
    if dataset.table is None:
        return True
    corners = placed(dataset.grid.exterior, proposal.pose)
    points = np.vstack([corners, corners + proposal.end - proposal.begin])
    return bool((dataset.table.margin(points) > 0.0).all())


def _question(diagnosis: Diagnosis, dataset: PushDataset, habits: Habits) -> Question:
    """The models to tell apart, the pairs of them that count, and the purpose."""

    def of(rivals: Sequence[Rival], pairs: Sequence[tuple[int, int]], good_for: str) -> Question:
        error = diagnosis.best.likelihood.error
        return Question(tuple(rivals), tuple(pairs), good_for, error, dataset.grid, habits)

    if diagnosis.verdict == "undecided":
        rivals = _hardly_seen(diagnosis, dataset, habits)
        pairs = [(0, k) for k in range(1, len(rivals))]
        return of(rivals, pairs, "best shows what the pushes so far show least")
    if len(diagnosis.rivals) > 1:
        rivals = [Rival.of(fitted) for fitted in diagnosis.rivals]
        return of(rivals, list(combinations(range(len(rivals)), 2)), "best tells the models apart")
    rivals, parameter = _sharpened(diagnosis)
    return of(rivals, [(0, 1)], f"best separates the ends of the 90 % interval of {parameter}")


def _sharpened(diagnosis: Diagnosis) -> tuple[list[Rival], str]:
    """The best model with its least certain parameter at either end of its 90 % interval, the rest refitted;
    and the name of that parameter."""
    best = diagnosis.best
    prior = best.likelihood.prior
    covariance = np.linalg.inv(best.hessian + np.eye(prior.size))
    amplitudes = np.concatenate([effect.amplitudes for effect in best.effects])
    spread = np.diagonal(covariance)[prior.plain :]
    chosen = int(np.argmax(np.where(amplitudes, spread, -1.0)))
    column = prior.plain + chosen
    slope = covariance[:, column] / covariance[column, column]
    fitted = parameter_estimates(best)[chosen]
    known = {(p.effect, p.name): p for candidate in diagnosis.candidates for p in candidate.parameters}
    estimate = known.get((fitted.effect, fitted.name), fitted)
    name = f"{estimate.effect} {estimate.name}"
    rivals = []
    for end in (estimate.low, estimate.high):
        values = best.values.copy()
        values[chosen] = end
        step = prior.effect_coordinates(values)[chosen] - best.z[column]
        unit = "" if estimate.unit == "1" else f" {estimate.unit}"
        rivals.append(Rival.of(best, f"{name} = {end:.3g}{unit}", best.z + step * slope))
    return rivals, name


def _of_ordinary_size(
    diagnosis: Diagnosis, dataset: PushDataset, habits: Habits, names: Sequence[str]
) -> list[Rival]:
    """Copies of the model without effects, each with one effect of ordinary size added."""
    plain = Rival.of(diagnosis.base)
    weight = float(plain.maps.mass.sum()) * dataset.gravity
    center = 0.5 * (habits.low + habits.high)
    scene = Scene(
        (float(center[0]), float(center[1])),
        float(np.abs(habits.high - center).max()),
        float(np.linalg.norm(dataset.grid.exterior, axis=1).max()),
        habits.speeds[1],
        habits.pushes,
        weight,
    )
    known = {effect.name: effect for effect in LIBRARY}
    rivals = []
    for effect in (known[name] for name in names if name in known):
        start = effect.start_values(scene)[0]
        values = np.clip(
            np.where(effect.amplitudes, effect.nulls + scales([effect], weight), start), *bounds([effect])
        )
        slider = slider_for(with_fewer_cells(dataset), [effect])
        maps = Maps(plain.maps.mass, plain.maps.mu, plain.maps.mu_finger, values[None])
        rivals.append(Rival(effect.name, slider, maps))
    return rivals


def _hardly_seen(diagnosis: Diagnosis, dataset: PushDataset, habits: Habits) -> list[Rival]:
    """The model without effects, and copies of it with one effect of ordinary size each: of the effects that
    show in the recorded pushes, the third that shows least, but at least two and at most five."""
    base = diagnosis.base
    plain = Rival.of(base)
    tried = {c.name for c in diagnosis.candidates}
    names = [effect.name for effect in LIBRARY if not tried or effect.name in tried]
    rivals = _of_ordinary_size(diagnosis, dataset, habits, names)
    recorded = [_as_imagined(o) for o in base.likelihood.observations if np.isfinite(o.push.tip).all()]
    if not recorded:
        return [plain, *rivals[:_HARDLY_SEEN]]
    reference = predict(plain, recorded)
    seen = []
    for rival in rivals:
        predictions = [reference, predict(rival, recorded)]
        apart = separations(predictions, recorded, base.likelihood.error, dataset.grid, habits)
        seen.append(float(np.linalg.norm(apart)))
    visible = [k for k in np.argsort(seen) if seen[k] > 1e-3 or len(recorded) < 2]
    return [plain, *(rivals[k] for k in visible[: min(max(2, len(visible) // 3), _HARDLY_SEEN)])]


def _as_imagined(observation: Observation) -> Push:
    """A recorded push, sampled like simulated ones."""
    push = observation.push
    steps = len(push.tip) - 1
    looks = push.h * steps * np.arange(1, SAMPLES + 1) / SAMPLES
    middles = push.h * (np.arange(steps, dtype=float) + 0.5)
    return replace(push, pose_times=looks, force_times=middles, force_span=0.0)


def _most_telling(
    question: Question, proposals: Sequence[Instruction], coarseness: float, least: float
) -> tuple[Instruction, float, Question] | None:
    """The best proposal, its separation, and the part of the question that it answers, whose models differ by
    more than `least`; None if it would answer nothing.

    Among the best few, the winner still separates the models best when the object is slightly misplaced. If
    no push tells all pairs apart, only those count that a single push can tell apart.
    """
    order = float(question.habits.pushes)
    apart = question.apart([proposal.push(order, coarseness=coarseness) for proposal in proposals])
    told = apart > least
    if not told.all(axis=0).any():
        shown = told[:, int(told.sum(axis=0).argmax())]
        if not shown.any():
            return None
        question = question.only([pair for pair, one in zip(question.pairs, shown, strict=True) if one])
        apart = apart[shown]
    score = apart.min(axis=0)
    finalists = np.argsort(-score, kind="stable")[:_FINALISTS]
    pushes = [
        proposals[i].push(order, shift, coarseness=coarseness) for i in finalists for shift in MISPLACED
    ]
    worst = question.told_by(pushes).reshape(len(finalists), -1).min(axis=1)
    winner = int(finalists[int(np.argmax(np.minimum(worst, score[finalists])))])
    return proposals[winner], float(score[winner]), question


def _worst_repeated(diagnosis: Diagnosis, dataset: PushDataset, habits: Habits) -> dict[str, Any] | None:
    """The push with the largest residual, with a change in the quantity that the residual depends on."""
    base = diagnosis.base
    likelihood = base.likelihood
    rows = likelihood.rows(base.z, base.offsets)
    worth = [np.isfinite(o.push.tip).all() for o in likelihood.observations]
    if not any(worth):
        return None
    off = np.array([
        float(np.sqrt((likelihood.whiteners[b](row.pose[..., None], row.force[..., None]) ** 2).mean()))
        for b, row in enumerate(rows)
    ])  # fmt: skip
    worst = int(np.argmax(np.where(worth, off, -1.0)))
    observation = likelihood.observations[worst]
    repeated = _repeated(observation, dataset)
    if repeated is None:
        return None
    depends = (diagnosis.depends_on or "").split(":")[0]
    changed = _changed(repeated, depends, dataset, habits)
    if changed is None:
        asked, what = repeated, "exactly as it was, because a change would take it off the table"
        learned = "If the error stays the same, it is no accident."
    else:
        asked, what = changed
        learned = "If the error changes, it depends on what you changed; if not, it does not."
    told = asked.to_json() | {"separates": [depends or "unknown"], "separation": float(off[worst])}
    return told | {
        "sentence": f"Repeat push {observation.trial}, which the model predicts worst"
        f" ({off[worst]:.1f} times the expected error), {what}. {_how_to(told, dataset.grid)} {learned}"
    }


def _repeated(observation: Observation, dataset: PushDataset) -> Instruction | None:
    """A recorded push as a straight line from just before first touch to its end."""
    push, radius = observation.push, dataset.finger_radius
    rotation = turn(push.start_pose[2])
    local = (push.tip - push.start_pose[:2]) @ rotation
    gaps = shapely.distance(shapely.points(local), dataset.grid.polygon) - radius
    near = np.flatnonzero(gaps <= 1e-3)
    touch = int(near[0]) if len(near) else int(np.argmin(gaps))
    way = push.tip[-1] - push.tip[touch]
    length = float(np.hypot(*way))
    if length < 1e-3:
        return None
    boundary = dataset.grid.polygon.boundary
    nearest = boundary.interpolate(boundary.project(shapely.Point(local[touch])))
    speed = np.hypot(*np.diff(push.tip, axis=0).T) / push.h
    begin = push.tip[touch] - _APPROACH * way / length
    pace = float(np.median(speed[speed > 0.2 * speed.max()]))
    return Instruction(push.start_pose, np.array(nearest.coords[0]), begin, push.tip[-1], pace, length, 0.0)


def _changed(
    push: Instruction, depends: str, dataset: PushDataset, habits: Habits
) -> tuple[Instruction, str] | None:
    """The push with one thing changed, and the change in words; None if it would leave the table with every
    such change."""
    if "place" in depends:
        middle = 0.5 * (habits.low + habits.high)
        way = push.end - push.begin
        other = np.clip(2 * middle - push.pose[:2] - way, habits.low, habits.high) - push.pose[:2]
        moved = [_moved(push, share * other) for share in _SHARES]
        words = ["at another place, with everything else the same"] * len(moved)
        return _first_on_table(moved, words, dataset)
    if "direction" in depends or "object" in depends:
        angles = (90, -90, 180) if "direction" in depends else (180, 90, -90)
        turned = [_turned(push, np.radians(angle)) for angle in angles]
        words = [f"with object and finger turned by {angle} degrees" for angle in angles]
        return _first_on_table(turned, words, dataset)
    if "time" in depends:
        return replace(push, dwell=2.0), "with a stop of 2 s half-way"
    if "order" in depends:
        return push, "exactly as it was, but after all the others"
    fast = habits.speeds[2] if push.speed < 0.75 * habits.speeds[2] else habits.speeds[0]
    return replace(push, speed=fast), f"at {fast / push.speed:.1f} times its speed"


def _moved(push: Instruction, way: FloatArray) -> Instruction:
    """The push with object and finger shifted by (2,), world, m."""
    pose = push.pose + np.append(way, 0.0)
    return replace(push, pose=pose, begin=push.begin + way, end=push.end + way)


def _turned(push: Instruction, angle: float) -> Instruction:
    """The push with object and finger turned about the object's origin, rad."""
    rotation, origin = turn(angle), push.pose[:2]
    begin, end = (origin + rotation @ (place - origin) for place in (push.begin, push.end))
    return replace(push, pose=push.pose + np.array([0.0, 0.0, angle]), begin=begin, end=end)


def _first_on_table(
    pushes: Sequence[Instruction], words: Sequence[str], dataset: PushDataset
) -> tuple[Instruction, str] | None:
    """The first of the pushes that stays on the table, with its words."""
    fitting = (told for told in zip(pushes, words, strict=True) if _on_table(told[0], dataset))
    return next(fitting, None)


def _sentence(
    asked: dict[str, Any],
    grid: CellGrid,
    rivals: Sequence[Rival],
    predictions: Sequence[Predictions],
    why: str,
) -> str:
    parts = []
    for rival, predicted in zip(rivals, predictions, strict=True):
        x, y, angle = predicted.poses[0, -1] - asked["pose"]
        force = np.hypot(*predicted.forces[0].T)
        pressed = force[force > 0.2 * force.max()]
        text = f"{1e3 * np.hypot(x, y):.1f} mm, {np.degrees(angle):+.1f}°"
        parts.append(text + (f", {pressed.mean():.2g} N" if len(pressed) else "") + f" ({rival.name})")
    return (
        f"{_how_to(asked, grid)} This push {why}: by {asked['separation']:.1f} standard deviations of the"
        f" error. Predicted displacement, rotation and mean force: {'; '.join(parts)}."
    )


def _how_to(asked: dict[str, Any], grid: CellGrid) -> str:
    """The instruction in one sentence."""
    x, y, angle = asked["pose"]
    begin = (np.array(asked["tip_start"]) - [x, y]) @ turn(angle)
    inside = any(shapely.Polygon(hole).contains(shapely.Point(begin)) for hole in grid.holes)
    finger = "lower the finger into the opening first, then move it" if inside else "move the finger"
    stop = f", pause for {asked['dwell']:.1g} s half-way" if asked["dwell"] else ""
    return (
        f"Put the object at x = {1e3 * x:.0f} mm, y = {1e3 * y:.0f} mm, turned by {np.degrees(angle):.0f}°;"
        f" {finger} from ({1e3 * asked['tip_start'][0]:.0f}, {1e3 * asked['tip_start'][1]:.0f}) mm to"
        f" ({1e3 * asked['tip_end'][0]:.0f}, {1e3 * asked['tip_end'][1]:.0f}) mm,"
        f" {1e3 * asked['length']:.0f} mm of this after first touch, at {1e3 * asked['speed']:.0f} mm/s"
        f"{stop}, and stop abruptly."
    )
