"""Algorithms 3 and 4 as a block: plans goals at the table's edge, pushes and the grasp from the belief."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.execution.clearance import Obstacle
from slipmap.diagrams.execution.requests import ActiveGrasp
from slipmap.diagrams.systems.loop_messages import LoopStatus, PregraspPlan
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.perception.seen_object import SeenObject
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.settings import check_choice
from slipmap.planners.goals import Goal, Graspable
from slipmap.planners.grasps import Grasp
from slipmap.planners.pregrasp import planning_belief
from slipmap.planners.push_decisions import Decision, Pursuit, decide, near_enough
from slipmap.planners.robust_push import PushEnds
from slipmap.planners.settings import METHODS, PregraspSettings
from slipmap.planners.table_push import TablePush

PERIOD = 0.05

_GRASPS = 12  # best grasps at a pose that are checked with the arm; others lie beside them
_SAME_PLACE = 0.01  # m; a grasp from the same side with its end nearer than this counts as the refused one

CanPush = Callable[[Obstacle, TablePush], bool]
CanGrasp = Callable[[ActiveGrasp], bool]
CanSee = Callable[[SeenObject, FloatArray], bool]


@dataclass(frozen=True, eq=False)
class _Planning:
    """The state of planning."""

    belief: Belief  # that was learned
    known: Belief  # what the method makes of it, and plans with
    thing: Graspable  # the object with its grasps
    goals: tuple[Goal, ...]  # acceptable goals
    pursuit: Pursuit = field(default_factory=Pursuit)  # results of the pushes so far
    last: Decision | None = None  # the decision behind the plan
    plan: PregraspPlan | None = None  # the present plan
    refused: tuple[Grasp, ...] = ()  # grasps that the arm refused

    def continued(self, status: LoopStatus) -> _Planning:
        """The state updated with the result of the last plan, when the loop asks for another."""
        if self.last is None or self.plan is None or self.last.way is None:
            return self
        if self.plan.push is not None:
            if status.attempt == 0:
                return replace(self, pursuit=self.pursuit.made(self.last.way), refused=())
            pursuit = self.pursuit.not_made(self.last.way, self.plan.push.push, status.reason)
            return replace(self, pursuit=pursuit)
        if self.plan.grasp is not None:
            return replace(self, refused=(*self.refused, self.plan.grasp.grasp))
        return self


@dataclass(frozen=True, eq=False)
class _Procedure:
    """The planning procedure, with the arguments of `GoalAndPushPlanner`."""

    settings: PregraspSettings
    table: Table
    method: str
    can_push: CanPush
    can_grasp: CanGrasp
    can_see: CanSee
    seed: int
    truth: Callable[[SeenObject], Maps] | None

    def next(
        self,
        planning: _Planning | None,
        status: LoopStatus,
        belief: Belief,
        pose: FloatArray,
        seen: SeenObject,
    ) -> _Planning:
        """Plan for a status, with the object at a pose (3,)."""
        rng = np.random.default_rng([self.seed, status.push, status.attempt])
        before = None if planning is None else planning.continued(status)
        if before is None or not belief.same_as(before.belief):
            before = self._begun(belief, seen, rng, before)
        return self._planned(before, status.number, pose, seen, rng)

    def _begun(
        self, belief: Belief, seen: SeenObject, rng: np.random.Generator, before: _Planning | None
    ) -> _Planning:
        """Planning with a belief: goals of before that are still goals and not given up, else new ones."""
        truth = self.truth(seen) if self.method == "true" and self.truth is not None else None
        known = planning_belief(self.method, belief, rng, truth)
        thing = Graspable.of_belief(known, seen.cell_heights, self.settings.goals)

        def can_serve(goal: Goal) -> bool:
            active = ActiveGrasp(0, goal.grasp, goal.pose, seen.grid, seen.cell_heights)
            return self.can_see(seen, goal.pose) and self.can_grasp(active)

        if before is None:
            return _Planning(belief, known, thing, tuple(thing.sample_goals(self.table, rng, can_serve)))
        again = thing.goals_at([goal.pose for goal in before.goals], self.table) if before.goals else []
        left_out = before.pursuit.left_out(self.settings.patience)
        kept = {
            old: goal
            for old, (one, goal) in enumerate(zip(before.goals, again, strict=True))
            if goal is not None and old not in left_out
            and (_same_place(one.grasp, goal.grasp) or can_serve(goal))
        }  # fmt: skip
        goals = tuple(kept.values()) or tuple(thing.sample_goals(self.table, rng, can_serve))
        pursuit = before.pursuit.to_other_goals({old: new for new, old in enumerate(kept)})
        return _Planning(belief, known, thing, goals, pursuit)

    def _planned(
        self, now: _Planning, number: int, pose: FloatArray, seen: SeenObject, rng: np.random.Generator
    ) -> _Planning:
        goals = self.settings.goals
        if not now.goals:
            reason = (
                f"at none of {goals.samples} poses at the edge does the object stay with a probability of"
                f" {1 - goals.epsilon:.0%}, in view of the camera and where the arm can grasp it"
            )
            return replace(now, plan=PregraspPlan(number, reason=reason))
        pose, known = now.known.true_pose(pose), now.known.in_world()
        obstacle = Obstacle(seen.grid, seen.cell_heights, pose)
        grasps: list[ActiveGrasp] = []

        def can_be_grasped(at: FloatArray) -> bool:
            grasps.extend(self._grasp_at(now, at, number, seen))
            return bool(grasps)

        decision = decide(
            known, pose, now.goals, now.pursuit, self.table, self.settings, rng,
            allowed=partial(self.can_push, obstacle), good=can_be_grasped,
        )  # fmt: skip
        goal = None if decision.way is None else now.goals[decision.way.goal]
        plan = PregraspPlan(number, goal, reason=decision.reason)
        if decision.reached:
            success, margin = self._prospects_of_grasp(known, pose)
            plan = PregraspPlan(number, goal, None, grasps[0], success, margin)
        elif decision.planned is not None and goal is not None:
            success, margin = self._prospects_of_push(decision.planned.ends, goal)
            plan = PregraspPlan(number, goal, decision.planned, None, success, margin)
        return replace(now, last=decision, plan=plan)

    def _grasp_at(self, now: _Planning, pose: FloatArray, number: int, seen: SeenObject) -> list[ActiveGrasp]:
        """The best grasp at a pose that the arm can make and has not refused; a list of one or none."""
        for grasp in now.thing.grasps_at(pose, self.table)[:_GRASPS]:
            active = ActiveGrasp(number, grasp, pose, seen.grid, seen.cell_heights)
            if not any(_same_place(grasp, other) for other in now.refused) and self.can_grasp(active):
                return [active]
        return []

    def _prospects_of_push(self, ends: PushEnds, goal: Goal) -> tuple[float, float]:
        """Probability of success and margin of a push towards a goal, see `PregraspPlan`."""
        there = np.array([near_enough(pose, goal.pose, self.settings.push) for pose in ends.poses])
        return _total(ends.probability, there & ~ends.falls), self._kept(ends.margins, ends.probability)

    def _prospects_of_grasp(self, known: Belief, pose: FloatArray) -> tuple[float, float]:
        """The same of the grasp of an object at a pose (3,), world."""
        margins = balance_margins(known.grid, known.centers_of_mass, pose[None], self.table)[0]
        return _total(known.probability, margins > 0), self._kept(margins, known.probability)

    def _kept(self, margins: FloatArray, probability: FloatArray) -> float:
        """The margin that is kept with the probability 1 - epsilon of the settings, m."""
        order = np.argsort(margins)
        sure = np.searchsorted(np.cumsum(probability[order]), self.settings.goals.epsilon, side="right")
        return float(margins[order[sure]])


def _total(probability: FloatArray, good: NDArray[np.bool_]) -> float:
    """The probability of what is good; a sum may exceed 1 by a rounding error."""
    return min(1.0, float(probability @ good))


class GoalAndPushPlanner(PythonSystem):
    """Plans a push or the grasp when the loop asks for one.

    Inputs:
    - `belief`: `Belief | None`; `object_pose`: `ObservedPose`; `seen_object`: `SeenObject | None`.
    - `status`: `LoopStatus`; the mode `planning` requests a plan with the status's number.
    Outputs:
    - `plan`: `PregraspPlan | None`; it stays until the loop asks for another.

    Goals are sampled for the first plan. When the belief changes, those stay that are goals by the new one,
    or all are sampled again if none is. Goals, predicted poses and the grasp's pose are true ones, which
    differ from `object_pose` where the belief has effects of the tracker. Without a worker, the simulation
    waits while the block computes. The random draws for a plan depend only on the seed and its number.

    Args:
        method: one of `slipmap.planners.settings.METHODS`.
        can_push: whether the arm can make a push, given the object's cells, heights and pose.
        can_grasp: whether it can approach for a grasp and lift.
        can_see: whether the camera sees the object at a pose (3,); goals need that, because the push that
            leads there may not be the last.
        seed: of every draw.
        truth: the true maps over the cells seen; only the method `true` uses it.
        worker: runs the computation; this process if None. It must be able to pickle the functions.

    Raises:
        ValueError: an unknown method, or a setting out of range.

    Example:
        >>> import slipmap
        >>> from slipmap.models.measurements import Table
        >>> from slipmap.planners.settings import PregraspSettings
        >>> table = Table("round", (0.0, 0.0), radius=0.5)
        >>> planner = slipmap.GoalAndPushPlanner(PregraspSettings(), table)
        >>> [planner.get_output_port(i).get_name() for i in range(planner.num_output_ports())]
        ['plan']
    """

    def __init__(
        self,
        settings: PregraspSettings,
        table: Table,
        *,
        method: str = "probabilistic",
        can_push: CanPush = lambda obstacle, push: True,
        can_grasp: CanGrasp = lambda grasp: True,
        can_see: CanSee = lambda seen, pose: True,
        seed: int = 0,
        truth: Callable[[SeenObject], Maps] | None = None,
        worker: Executor | None = None,
    ) -> None:
        super().__init__()
        settings.check()
        check_choice("GoalAndPushPlanner: method", method, METHODS)
        self._procedure = _Procedure(settings, table, method, can_push, can_grasp, can_see, seed, truth)
        self._worker = worker
        self.declare_inputs("belief", "object_pose", "seen_object", "status")
        self._planning = self.DeclareAbstractState(held(None))
        self._job = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._update)
        self.declare_output_of("plan", self._planning, lambda now: None if now is None else now.plan)

    def _update(self, context: Context, state: State) -> EventStatus:
        job = read(context, self._job)
        if job is None:
            status: LoopStatus = self.input(context, "status")
            planning: _Planning | None = read(context, self._planning)
            pose = self.input(context, "object_pose")
            plan = None if planning is None else planning.plan
            stands = plan is not None and plan.number == status.number
            if status.mode != "planning" or stands or not pose.valid:
                return EventStatus.DidNothing()
            seen: SeenObject = self.input(context, "seen_object")
            belief: Belief = self.input(context, "belief")
            job = begun(self._worker, self._procedure.next, planning, status, belief, pose.pose, seen)
        if not job.done():
            replace_held(state, self._job, job)
            return EventStatus.Succeeded()
        replace_held(state, self._job, None)
        replace_held(state, self._planning, job.result())
        return EventStatus.Succeeded()


def _same_place(one: Grasp, other: Grasp) -> bool:
    """Whether two grasps are at about the same place, from the same side."""
    return bool(np.hypot(*(one.tip - other.tip)) < _SAME_PLACE and one.approach == other.approach)
