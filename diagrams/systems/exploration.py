"""Algorithm 2 as a block that chooses the next push."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.execution.clearance import Obstacle
from slipmap.diagrams.systems.loop_messages import CHOOSING, ExplorationPlan, LoopStatus
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.perception.seen_object import SeenObject
from slipmap.models.settings import check_choice
from slipmap.planners.action_selection import Choice, choose_push
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.settings import STRATEGIES, PokeSettings
from slipmap.planners.table_push import TablePush

PERIOD = 0.05


class Exploration(PythonSystem):
    """Chooses a push when the loop asks for one.

    Inputs:
    - `belief`: `Belief | None`; `object_pose`: `ObservedPose`; `seen_object`: `SeenObject | None`.
    - `status`: `LoopStatus`; the mode `choosing` requests a plan with the status's number, `telling apart`
      one that best answers the question of `repair`, the `Repair` from a `Diagnosis`.
    Outputs:
    - `plan`: `ExplorationPlan | None`; it stays until the loop asks for another.

    The random draws for a push depend only on the seed and the push's number.

    Args:
        strategy: one of `slipmap.planners.settings.STRATEGIES`; pushes after the first `fit`, made to judge
            the belief, are random and never taps.
        fit: number of pushes chosen by the strategy.
        finger_radius: m.
        settings: constraints on the pushes to learn from.
        allowed: whether the arm can make a push, given the object's cells, heights and pose.
        seed: of every draw.
        worker: runs the computation; if None, this process does, and the simulation waits. It must be able to
            pickle `allowed`.
        past: pushes made earlier.
        table: its top, from which the object must not fall; unknown if None.

    Raises:
        ValueError: an unknown strategy.

    Example:
        >>> import slipmap
        >>> settings = slipmap.Scenario().pokes
        >>> block = slipmap.Exploration("random", 3, 0.008, settings, lambda obstacle, push: True, seed=0)
        >>> [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
        ['plan']
    """

    def __init__(
        self,
        strategy: str,
        fit: int,
        finger_radius: float,
        settings: PokeSettings,
        allowed: Callable[[Obstacle, TablePush], bool],
        seed: int,
        worker: Executor | None = None,
        past: Sequence[Choice] = (),
        table: Table | None = None,
    ) -> None:
        super().__init__()
        check_choice("Exploration: strategy", strategy, STRATEGIES)
        self._strategy = strategy
        self._fit = fit
        self._finger_radius = finger_radius
        self._settings = settings
        self._allowed = allowed
        self._table = table
        self._seed = seed
        self._worker = worker
        self.declare_inputs("belief", "object_pose", "seen_object", "status", "repair")
        self._plan = self.DeclareAbstractState(held(None))
        self._past = self.DeclareAbstractState(held(tuple(past)))
        self._job = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._choose)
        self.declare_output_of("plan", self._plan)

    def _choose(self, context: Context, state: State) -> EventStatus:
        job, number, past = read(context, self._job) or (None, 0, ())
        if job is None:
            status: LoopStatus = self.input(context, "status")
            plan: ExplorationPlan | None = read(context, self._plan)
            pose = self.input(context, "object_pose")
            asked = status.mode in CHOOSING and (plan is None or plan.number != status.number)
            if not asked or not pose.valid:
                return EventStatus.DidNothing()
            number, past = status.number, read(context, self._past)
            if status.attempt > 0:
                past = past[:-1]  # the arm refused it
            strategy = self._strategy if status.push < self._fit else "random"
            question = None
            if status.mode == "telling apart":
                question = self.input(context, "repair").question
            seen: SeenObject = self.input(context, "seen_object")
            belief: Belief | None = self.input(context, "belief")
            place = pose.pose if belief is None else belief.true_pose(pose.pose)
            job = begun(
                self._worker,
                _selected,
                seen.grid,
                pose.pose,
                self._finger_radius,
                strategy=strategy,
                belief=belief,
                past=past,
                settings=self._settings,
                tap=self._settings.is_tap(status.push) and status.push < self._fit,
                question=question,
                table=self._table,
                allowed=partial(self._allowed, Obstacle(seen.grid, seen.cell_heights, place)),
                rng=np.random.default_rng([self._seed, status.push, status.attempt]),
            )
        if not job.done():
            replace_held(state, self._job, (job, number, past))
            return EventStatus.Succeeded()
        choice, reason = job.result()
        replace_held(state, self._job, None)
        replace_held(state, self._plan, ExplorationPlan(number, choice, reason))
        if choice is not None:
            replace_held(state, self._past, (*past, choice))
        return EventStatus.Succeeded()


def _selected(*args: Any, **kwargs: Any) -> tuple[Choice | None, str]:
    """The choice of `choose_push`, or the reason why there is none."""
    try:
        return choose_push(*args, **kwargs), ""
    except NoReachablePush as error:
        return None, str(error)
